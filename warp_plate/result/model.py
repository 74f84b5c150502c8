"""Results and their files: one HDF5 file for each, readable by h5py, MATLAB's h5read and xarray; see docs/scene.md.

Beside the fields of the data classes (see ``warp_plate.result.hdf5``) a file holds derived values for other programs:
the positions of the nodes, the localization factors, and the crosstalk between several targets.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import h5py
import numpy as np

from warp_plate.plate.scene_overrides import scene_with
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.result import hdf5
from warp_plate.result.extras import import_xarray
from warp_plate.result.robust import RobustComparison
from warp_plate.result.targets import crosstalk
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Objective

if TYPE_CHECKING:
    import xarray

FORMAT = hdf5.FileFormat("result", 4)
BoundKind = Literal["", "attained", "attained within limits", "bound only"]
BOUND_DESCRIPTIONS: dict[BoundKind, str] = {
    "": "bound",
    "attained": "bound at this frequency, from these places",
    "attained within limits": "bound of the permitted drives",
    "bound only": "upper bound of the permitted drives, may be out of reach",
}


def _columns(**columns: hdf5.Dataset) -> hdf5.Datasets:
    return hdf5.Datasets(columns.__getitem__, tuple(columns))


HISTORY = _columns(
    evaluations=hdf5.Dataset("1", "drives tried so far, after each iteration", ("iteration",)),
    best=hdf5.Dataset("1", "largest localization factor so far, after each iteration", ("iteration",)),
    mean=hdf5.Dataset("1", "mean localization factor of the iteration, after each iteration", ("iteration",)),
)
SPECTRUM = _columns(
    frequency=hdf5.Dataset("Hz", "where the localization factors were taken", ("frequency",)),
    equal=hdf5.Dataset("1", "localization factor of all actuators alike", ("frequency",)),
    single=hdf5.Dataset("1", "localization factor of the best single actuator", ("frequency",)),
    best=hdf5.Dataset("1", "largest localization factor that the drives may reach", ("frequency",)),
    resonances=hdf5.Dataset("Hz", "natural frequencies of the plate", ("resonances",)),
)


def _phase_lag(phasors: np.ndarray) -> np.ndarray:
    return np.where(phasors == 0, 0.0, np.mod(-np.angle(phasors), 2 * np.pi))


class _Phasors(hdf5.Layout):
    """Complex amplitudes as the datasets ``magnitude`` and ``phase``, and to the bit as ``real`` and ``imaginary``."""

    magnitude = hdf5.Dataset("", "drive magnitude of each actuator", ("actuator",))  # its unit depends on the scene
    phase = hdf5.Dataset("rad", "drive phase lag of each actuator", ("actuator",))
    real = hdf5.Dataset("", "real part of the complex amplitude of each actuator", ("actuator",), bounded=True)
    imaginary = hdf5.Dataset(
        "", "imaginary part of the complex amplitude of each actuator", ("actuator",), bounded=True
    )

    def write(self, group: h5py.Group, name: str, value: np.ndarray) -> None:
        self.magnitude.write(group, "magnitude", np.abs(value))
        self.phase.write(group, "phase", _phase_lag(value))
        self.real.write(group, "real", np.real(value))
        self.imaginary.write(group, "imaginary", np.imag(value))

    def read(self, group: h5py.Group, name: str, sizes: hdf5.Sizes) -> np.ndarray:
        magnitude, phase = self.magnitude.read(group, "magnitude", sizes), self.phase.read(group, "phase", sizes)
        if "real" not in group:  # a file of an earlier version
            return np.asarray(magnitude * np.exp(-1j * phase))
        phasors = self.real.read(group, "real", sizes).astype(complex)
        phasors.imag = self.imaginary.read(group, "imaginary", sizes)
        return phasors


class _Energies(hdf5.Layout):
    """Energies by region as one dataset, with the names of the regions as JSON in its attribute ``regions``."""

    values = hdf5.Dataset("J", "kinetic energy averaged over the window, for each region")

    def write(self, group: h5py.Group, name: str, value: Mapping[str, float]) -> None:
        hdf5.write_along(group, "region", list(value), "1", "names of the regions")
        hdf5.write_along(
            group, name, np.array(list(value.values())), self.values.units, self.values.long_name, ["region"]
        )
        group[name].attrs["regions"] = json.dumps(list(value))

    def read(self, group: h5py.Group, name: str, sizes: hdf5.Sizes) -> dict[str, float]:
        regions = hdf5.Attribute(tuple[str, ...]).read(group, f"{name}/regions", sizes)
        if not {"plate", "target"} <= set(regions):
            raise SceneError(f"{group.name}/{name} has regions {regions}, without plate or target")
        return dict(zip(regions, hdf5.read_array(group, name, (len(regions),)).tolist(), strict=True))


def _objective(path: str) -> hdf5.Dataset:
    """Return the layout of an objective's value, by KIND, or by CASE/KIND of other cases."""
    case, _, name = path.rpartition("/")
    meaning = {"sum": "sum of the objectives with their weights", "bound": "upper bound of that sum"}
    of_case = f", of the drive {case}" if case else ""
    quantity = REGION_QUANTITIES.get(name.split()[0])
    return hdf5.Dataset("1" if quantity is None else quantity.unit, meaning.get(name, name) + of_case)


OBJECTIVES = hdf5.Datasets(_objective)


@dataclass(frozen=True)
class RegionMotion:
    """Motion of the (target, rest) of the plate; NaN for a rest that is empty.

    Attributes:
        velocity: Root of the mean square over the region's mass and the window [m/s].
        displacement: Largest magnitude over the whole run [m].
        acceleration: As the velocity [m/s²]; None for other motions than those of one tone in a linear plate.
        contrast: Energy per area in the target over that in the rest [dB].
    """

    velocity: tuple[float, float]
    displacement: tuple[float, float]
    acceleration: tuple[float, float] | None
    contrast: float


@dataclass(frozen=True, eq=False)
class Case:
    """A drive and the motion of the plate under it.

    Attributes:
        phasors: (actuators,) complex amplitudes Z [``Scene.drive_unit``] of the load Re(Z exp(iωt)).
        energy: Kinetic energy averaged over the window [J], by region: "plate", "target" and further ones.
        status: "ok", or the reason why the energies are NaN.
        motion: Motion of target and rest; None for cases that were read from a file, which does not hold it.

    Frequencies, centres and burst starts are None if they are the scene's.
    """

    phasors: Annotated[np.ndarray, _Phasors()]
    energy: Annotated[Mapping[str, float], _Energies()]
    displacement: Annotated[np.ndarray, hdf5.Dataset("m", "displacement (times, y, x)", ("times", "y", "x"))]
    trace: Annotated[
        np.ndarray, hdf5.Dataset("m", "displacement at the recorded points (points, steps)", ("point", None))
    ]
    status: Annotated[str, "energy/status"] = "ok"
    frequency: Annotated[np.ndarray | None, hdf5.Dataset("Hz", "frequency of each actuator", ("actuator",))] = None
    centre: Annotated[np.ndarray | None, hdf5.Dataset("m", "x, y of each actuator's middle", ("actuator", "axis"))] = (
        None
    )
    delay: Annotated[np.ndarray | None, hdf5.Dataset("s", "start of each actuator's burst", ("actuator",))] = None

    motion: Annotated[RegionMotion | None, hdf5.ELSEWHERE] = None

    @property
    def localization_factor(self) -> float:
        """Fraction of the plate's kinetic energy in the target, equation (5) of the source paper; NaN at rest."""
        return self.energy["target"] / self.energy["plate"] if self.energy["plate"] > 0 else float("nan")

    @property
    def magnitude(self) -> np.ndarray:
        """(actuators,) magnitudes, in the unit of ``phasors``."""
        return np.abs(self.phasors)

    @property
    def phase(self) -> np.ndarray:
        """(actuators,) phase lags φ [rad], 0 ≤ φ < 2π; 0 where the magnitude is 0."""
        return _phase_lag(self.phasors)

    @property
    def per_actuator(self) -> dict[str, np.ndarray]:
        """(actuators,) values that differ from the scene's, by table heading."""
        x, y = (None, None) if self.centre is None else self.centre.T
        columns = {"frequency (Hz)": self.frequency, "x (m)": x, "y (m)": y, "burst from (s)": self.delay}
        return {heading: values for heading, values in columns.items() if values is not None}


def case_scene(scene: Scene, case: Case) -> Scene:
    """Return the scene with a case's frequencies, positions and burst starts."""
    own = {"frequency": case.frequency, "centre": case.centre, "delay": case.delay}
    return scene_with(scene, **own) if case.per_actuator else scene


def only_actuator(case: Case, scene: Scene) -> str:
    """Return the name of the only actuator that a case drives; "" if it drives another number of them."""
    driven = [actuator.name for actuator, part in zip(scene.actuators, case.magnitude, strict=True) if part > 0]
    return driven[0] if len(driven) == 1 else ""


@dataclass(frozen=True, eq=False)
class TargetSearch:
    """A finished search for one target; see :class:`Result`.

    Attributes:
        position: (dimension,) best position; None if there is a single actuator or no position has finite energies.
    """

    position: Annotated[np.ndarray | None, hdf5.Dataset("1", "best position in the search space", ("position",))]
    single_actuator: Annotated[int, "single"]
    bound: float | None
    bound_kind: BoundKind
    evaluations: int
    history: Annotated[Mapping[str, np.ndarray], HISTORY]
    objective_values: Annotated[Mapping[str, float], OBJECTIVES, "objectives"]


@dataclass(frozen=True, eq=False)
class Result:
    """Outcome of ``localize`` or ``simulate``, with all that is needed to run it again.

    Attributes:
        scene: The scene, with the grid that was used.
        effects: Names of the effects in the compiled kernels.
        cases: Cases by name: "equal", "single", "best" ... of ``localize``, "drive" of ``simulate``.
        seconds: Wall time by stage [s]: "compile", "solve" and others.
        node_steps: nodes × steps × plates.
        bound: Upper bound of the localization factor over all drives; None if unknown.
        history: (iterations,) "evaluations", and "best" and "mean" localization factor or sum of the objectives.
        objective_values: Objectives of the best drive by kind, their weighted "sum" and its "bound"; may be empty.
        objective_values_by_case: The same of other cases at the scene's frequency and positions, without bounds.
        evaluator: "direct" (a simulated plate for each drive), "response" (Gram matrices) or "modal" (modes).
        accuracy: Estimated errors ("estimate"), and the choice of the grid ("asked", "expected", "reason").
        peak_displacement: Largest displacement over the run of the main case [m]; None if unknown.
        spectrum: Localization factors over the "frequency" [Hz], and the "resonances" [Hz]; may be empty.
        target_searches: Searches for several targets; ``bound`` and ``history`` are those of the first.
        robust: Comparison of a robust drive with the nominal one; None for other searches.
        lost_plates: Numbers of plates that counted as worst because their workers failed, by reason.
    """

    command: str
    source: str
    scene: Scene
    device: str
    seed: int
    effects: tuple[str, ...]
    times: Annotated[np.ndarray, hdf5.Dataset("s", "times of the displacements", ("times",))]
    trace_times: Annotated[np.ndarray, hdf5.Dataset("s", "times of the traces", ("trace_times",))]
    cases: Mapping[str, Case]
    seconds: Mapping[str, float]
    node_steps: int
    evaluations: int = 0
    bound: Annotated[
        float | None, hdf5.Dataset("1", "largest that any drive can reach"), "localization_factor/bound"
    ] = None
    bound_kind: BoundKind = ""
    history: Annotated[Mapping[str, np.ndarray], HISTORY] = field(default_factory=dict)
    objective_values: Annotated[Mapping[str, float], OBJECTIVES, "objectives"] = field(default_factory=dict)
    objective_values_by_case: Annotated[Mapping[str, Mapping[str, float]], OBJECTIVES, "objectives_of"] = field(
        default_factory=dict
    )
    evaluator: str = "direct"
    path: str = ""
    interrupted: bool = False
    versions: Mapping[str, str] = field(default_factory=dict)
    accuracy: Mapping[str, Any] = field(default_factory=dict)
    peak_displacement: Annotated[float | None, hdf5.Dataset("m", "largest displacement seen over the run")] = None
    spectrum: Annotated[Mapping[str, np.ndarray], SPECTRUM] = field(default_factory=dict)
    target_searches: Annotated[tuple[TargetSearch, ...], "searches"] = ()
    robust: RobustComparison | None = None
    lost_plates: Annotated[hdf5.Counts, "lost"] = field(default_factory=dict)

    def case_scene(self, case: Case) -> Scene:
        """Return :func:`case_scene` of the result's scene."""
        return case_scene(self.scene, case)

    def driven_scene(self, case: Case) -> Scene:
        """Return the scene with a case's drive too; raise a SceneError if a magnitude is too large."""
        return scene_with(self.case_scene(case), case.magnitude, case.phase)

    def __repr__(self) -> str:
        factors = (f"{name} {100 * case.localization_factor:.3g} %" for name, case in self.cases.items())
        return f"<Result {' '.join([self.command, self.source]).strip()}: {', '.join(factors)}>"

    @property
    def only_localization(self) -> bool:
        """True if the localization factor is the only objective."""
        return self.scene.search.objectives == (Objective(),)

    @property
    def by_modes(self) -> bool:
        """True if the result comes from the modes of the plate, without time steps."""
        return self.path.startswith("modal")

    @property
    def main_name(self) -> str:
        """Name of the best drive found, or of the drive that was simulated."""
        return "best" if "best" in self.cases else next(iter(self.cases))

    def select_cases(self, names: Sequence[str]) -> dict[str, Case]:
        """Return the cases of these names, or raise a SceneError that says which there are."""
        for name in names:
            if name not in self.cases:
                raise SceneError(f"case = {name!r}: must be one of {', '.join(self.cases)}")
        return {name: self.cases[name] for name in names}

    @property
    def main_case(self) -> Case:
        """The best drive found, or the drive that was simulated."""
        return self.cases[self.main_name]

    def to_xarray(self) -> xarray.Dataset:
        """Return drives, energies, displacements and traces of all cases as an ``xarray.Dataset``."""
        xarray = import_xarray()
        cases, (nx, ny), (width, height) = list(self.cases.values()), self.scene.grid.nodes, self.scene.plate.size

        def values(name: str) -> np.ndarray:
            return np.array([getattr(case, name) for case in cases])

        traces = values("trace")[..., : len(self.trace_times)]  # without points there are no times
        return xarray.Dataset(
            {
                "localization_factor": ("case", values("localization_factor"), {"units": "1"}),
                "energy": (("case", "region"), [list(case.energy.values()) for case in cases], {"units": "J"}),
                "magnitude": (("case", "actuator"), values("magnitude"), {"units": self.scene.drive_unit}),
                "phase": (("case", "actuator"), values("phase"), {"units": "rad"}),
                "displacement": (("case", "time", "y", "x"), values("displacement"), {"units": "m"}),
                "trace": (("case", "point", "trace_time"), traces, {"units": "m"}),
            },
            {
                "case": list(self.cases),
                "region": list(cases[0].energy),
                "actuator": [actuator.name for actuator in self.scene.actuators],
                "time": ("time", self.times, {"units": "s"}),
                "trace_time": ("trace_time", self.trace_times, {"units": "s"}),
                "x": ("x", np.linspace(0, width, nx), {"units": "m"}),
                "y": ("y", np.linspace(0, height, ny), {"units": "m"}),
            },
            {"title": self.scene.title, "command": self.command},
        )


def save_result(result: Result, path: str | Path) -> Path:
    """Write a result file atomically and return its path, or raise a SceneError."""
    scene, robust = result.scene, result.robust
    with FORMAT.create(path) as file:
        for axis, side, count in zip("xy", scene.plate.size, scene.grid.nodes, strict=True):
            hdf5.write_along(file, axis, np.linspace(0, side, count), "m", f"position of the nodes along {axis}")
        names = [actuator.name for actuator in scene.actuators]
        hdf5.write_along(file, "actuator", names, "1", "names of the actuators")
        hdf5.write_fields(file, result)
        for name, case in result.cases.items():
            for part in ("magnitude", "real", "imaginary"):
                file[f"cases/{name}/{part}"].attrs["units"] = scene.drive_unit.replace("²", "^2")
            share = hdf5.Dataset("1", "share of the plate's kinetic energy in the target")
            share.write(file, f"localization_factor/{name}", case.localization_factor)
            if case.trace.shape[-1] == len(result.trace_times):  # without points there are no times
                file[f"cases/{name}/trace"].dims[1].attach_scale(file["trace_times"])
        if robust is not None and not robust.localization:
            for name in ("bound", "searched", "nominal_plate", "fresh"):
                if name in file["robust"]:
                    file[f"robust/{name}"].attrs["units"] = "weighted"
        file.attrs["title"] = scene.title
        if result.bound is not None:
            file["localization_factor/bound"].attrs["about"] = BOUND_DESCRIPTIONS[result.bound_kind]
        if result.target_searches:
            names, meaning = (
                [t.name for t in scene.targets],
                "share of the plate's energy in each target, by each's drive",
            )
            hdf5.write_along(file, "target", names, "1", "names of the targets")
            hdf5.write_along(file, "best_for", names, "1", "targets that the drives are best for")
            hdf5.write_along(file, "crosstalk", crosstalk(result), "1", meaning, ["best_for", "target"])
            file["crosstalk"].attrs["targets"] = json.dumps(names)
    return Path(path)


def load_result(path: str | Path) -> Result:
    """Read a file that :func:`save_result` wrote, or raise a SceneError if it is missing, damaged or not a result."""
    with FORMAT.open(path) as file:
        result = hdf5.read_fields(Result, file)
        if not result.cases:
            raise SceneError("cases is missing or empty")
        for name, case in result.cases.items():
            if case.trace.size and case.trace.shape[1] != len(result.trace_times):
                raise SceneError(f"cases/{name}/trace has other steps than trace_times")
        return result
