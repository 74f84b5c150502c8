"""Results and their files: one HDF5 file for each, readable by h5py, MATLAB's h5read and xarray; see docs/scene.md.

Beside the fields of the data classes (see :mod:`warp_plate.result.layouts`), a file holds derived values for other
programs: the positions of the nodes, the localization factors, and the crosstalk between several targets.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from warp_plate.plate.designs import scene_with
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.result.case import Case, Named, aligned, case_scene, motion_table, target_cases
from warp_plate.result.hdf5 import FileFormat, write_along
from warp_plate.result.layouts import Counts, Dataset, Datasets, read_fields, write_fields
from warp_plate.scene.errors import SceneError, check_type, printable
from warp_plate.scene.model import Scene
from warp_plate.scene.search import COIL_UNITS, Objective

FORMAT = FileFormat("result", 4)
# Fraction of all scenarios that counts as the worst ones.
TAIL = 0.05
DRIVES = ("robust", "nominal")
_ROWS = "of the robust and of the nominal drive"
BoundKind = Literal["", "attained", "attained within limits", "bound only"]
BOUND_DESCRIPTIONS: dict[BoundKind, str] = {
    "": "bound",
    "attained": "bound at this frequency, from these places",
    "attained within limits": "bound of the permitted drives",
    "bound only": "upper bound of the permitted drives, may be out of reach",
}
HISTORY = Datasets.of(
    evaluations=Dataset("1", "drives tried so far, after each iteration", ("iteration",)),
    best=Dataset("1", "largest localization factor so far, after each iteration", ("iteration",)),
    mean=Dataset("1", "mean localization factor of the iteration, after each iteration", ("iteration",)),
)
SPECTRUM = Datasets.of(
    frequency=Dataset("Hz", "where the localization factors were taken", ("frequency",)),
    equal=Dataset("1", "localization factor of all actuators alike", ("frequency",)),
    single=Dataset("1", "localization factor of the best single actuator", ("frequency",)),
    best=Dataset("1", "largest localization factor that the drives may reach", ("frequency",)),
    resonances=Dataset("Hz", "natural frequencies of the plate", ("resonances",)),
)


def _objective(path: str) -> Dataset:
    """Return the layout of an objective's value, by KIND, or by CASE/KIND of other cases."""
    case, _, name = path.rpartition("/")
    meaning = {"sum": "sum of the objectives with their weights", "bound": "upper bound of that sum"}
    of_case = f", of the drive {case}" if case else ""
    kind = name.split()[0]
    unit = REGION_QUANTITIES[kind].unit if kind in REGION_QUANTITIES else COIL_UNITS.get(kind, "1")
    return Dataset(unit, meaning.get(name, name) + of_case)


OBJECTIVES = Datasets(_objective)


@dataclass(frozen=True, eq=False)
class TargetSearch:
    """A finished search for one target; see :class:`Result`.

    Attributes:
        position: (dimension,) best position; None if there is a single actuator or no position has finite energies.
    """

    position: Annotated[np.ndarray | None, Dataset("1", "best position in the search space", ("position",))]
    single_actuator: Annotated[int, "single"]
    bound: float | None
    bound_kind: BoundKind
    evaluations: int
    history: Annotated[Mapping[str, np.ndarray], HISTORY]
    objective_values: Annotated[Mapping[str, float], OBJECTIVES, "objectives"]


@dataclass(frozen=True, eq=False)
class RobustComparison:
    """Values of the robust drive and of the nominal drive, in this order (``DRIVES``).

    Larger values are better. They are localization factors or, if other objectives were given, weighted sums of the
    objectives; not finite where a plate failed.

    Attributes:
        measure: Measure over the scenarios that the robust search maximized.
        scenarios: Number of scenarios of the search.
        localization: True if the values are localization factors.
        validation: (2, validation scenarios) values in scenarios that the search did not use.
    """

    measure: str
    scenarios: int
    localization: bool
    bound: Annotated[float | None, Dataset("1", "upper bound of the measure")]
    searched: Annotated[np.ndarray, Dataset("1", f"measure {_ROWS} over the scenarios of the search", ("drive",))]
    nominal_plate: Annotated[np.ndarray, Dataset("1", f"value {_ROWS} without scatter", ("drive",))]
    validation: Annotated[
        np.ndarray, Dataset("1", f"value {_ROWS} in each fresh scenario", ("drive", "scenario")), "fresh"
    ]

    @property
    def failed(self) -> np.ndarray:
        """(2,) numbers of validation scenarios in which the plate failed."""
        return np.sum(~np.isfinite(self.validation), axis=1)

    def rows(self) -> Mapping[str, np.ndarray]:
        """Return the (2,) statistics to tabulate, by name; a plate that failed counts as −∞."""
        values = np.where(np.isfinite(self.validation), self.validation, -np.inf)
        return {
            "mean": values.mean(axis=1),
            "worst_5_percent": mean_of_worst(values),
            "worst": values.min(axis=1),
            "nominal_plate": self.nominal_plate,
            "searched": self.searched,
        }


def mean_of_worst(values: np.ndarray) -> np.ndarray:
    """Return the (rows,) means of the smallest 5 % of each row's values, at least of one value."""
    count = max(1, int(np.ceil(TAIL * values.shape[1] - 1e-9)))
    return np.asarray(np.sort(values, axis=1)[:, :count].mean(axis=1))


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
        warnings: Lines that the command prints after "!".
    """

    command: str
    source: str
    scene: Scene
    device: str
    seed: int
    effects: tuple[str, ...]
    times: Annotated[np.ndarray, Dataset("s", "times of the displacements", ("times",))]
    trace_times: Annotated[np.ndarray, Dataset("s", "times of the traces", ("trace_times",))]
    cases: Mapping[str, Case]
    seconds: Mapping[str, float]
    node_steps: int
    evaluations: int = 0
    bound: Annotated[float | None, Dataset("1", "largest that any drive can reach"), "localization_factor/bound"] = None
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
    peak_displacement: Annotated[float | None, Dataset("m", "largest displacement seen over the run")] = None
    spectrum: Annotated[Mapping[str, np.ndarray], SPECTRUM] = field(default_factory=dict)
    target_searches: Annotated[tuple[TargetSearch, ...], "searches"] = ()
    robust: RobustComparison | None = None
    lost_plates: Annotated[Counts, "lost"] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "cases", Named(self.cases, "case"))

    def case_scene(self, case: Case) -> Scene:
        """Return the scene with a case's frequencies, positions and burst starts."""
        return case_scene(self.scene, case) if case.per_actuator else self.scene

    def driven_scene(self, case: Case) -> Scene:
        """Return the scene with a case's drive too; raise a SceneError if a magnitude is too large."""
        return scene_with(self.case_scene(case), case.magnitude, case.phase)

    def __repr__(self) -> str:
        factors = (f"{name} {100 * case.localization_factor:.3g} %" for name, case in self.cases.items())
        return f"<Result {' '.join([self.command, self.source]).strip()}: {', '.join(factors)}>"

    def __str__(self) -> str:
        cases = {name.replace("_", " "): case for name, case in self.cases.items()}
        headings, rows = motion_table(cases, self.scene)
        lines = [f"{self.command} {self.scene.title or self.source}".strip(), ""]
        if rows:
            lines += ["In the target / outside:", ""]
        else:  # read from a file
            headings = ["drive", "share"]
            rows = [[name, f"{case.localization_factor:.4f}"] for name, case in cases.items()]
        headings[headings.index("share")] = "localization factor"
        lines += [aligned(headings, rows), ""]
        if self.bound is not None:
            lines.append(f"{self.bound_description}: {self.bound:.4f}")
        estimate = self.accuracy.get("estimate", {})
        lines += [part["line"] for part in (estimate, estimate.get("bound", {})) if "line" in part]
        return printable("\n".join([*lines, *(f"! {line}" for line in self.warnings)]).strip())

    @property
    def only_localization(self) -> bool:
        """True if the localization factor is the only objective."""
        return self.scene.search.objectives == (Objective(),)

    @property
    def scope(self) -> str:
        """Numerics within which values without an error bar hold, for people."""
        return "by these modes" if self.by_modes else "on this grid"

    @property
    def bound_description(self) -> str:
        """Kind of the bound, with its scope if its error is not known, for people."""
        text = BOUND_DESCRIPTIONS["" if self.bound is None else self.bound_kind]
        known = self.bound is None or "bound" in self.accuracy.get("estimate", {})
        return text if known else f"{text}, {self.scope}"

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
        return {name: self.cases[name] for name in names}

    @property
    def main_case(self) -> Case:
        """The best drive found, or the drive that was simulated."""
        return self.cases[self.main_name]


def best_drive_scenes(result: Result) -> dict[str, Scene]:
    """Return the scene that ``simulate`` runs as each best drive, by case; aimed at the drive's own target.

    A SceneError is raised if a magnitude is larger than a scene may have.
    """
    scene = result.scene
    names = enumerate(target_cases(scene.targets).values())
    aimed = {name: scene.aimed_at(index) for index, name in names} or {"best": scene}
    return {
        name: replace(result, scene=aimed[name]).driven_scene(result.cases[name])
        for name in aimed
        if name in result.cases
    }


def crosstalk(result: Result) -> np.ndarray:
    """Return the (drives, targets) fractions of the plate's energy in each target; NaN for drives not reached."""
    regions, rows = result.scene.target_regions, []
    for name in target_cases(result.scene.targets).values():
        energy = result.cases[name].energy if name in result.cases else {}
        plate = energy.get("plate", 0.0)
        rows.append([energy.get(region, math.nan) / plate if plate > 0 else math.nan for region in regions])
    return np.array(rows).reshape(len(rows), len(regions))


def save_result(result: Result, path: str | Path) -> Path:
    """Write a result file atomically and return its path, or raise a SceneError."""
    check_type("result", result, Result)
    scene, robust = result.scene, result.robust
    with FORMAT.create(path) as file:
        for axis, side, count in zip("xy", scene.plate.size, scene.grid.nodes, strict=True):
            write_along(file, axis, np.linspace(0, side, count), "m", f"position of the nodes along {axis}")
        names = [actuator.name for actuator in scene.actuators]
        write_along(file, "actuator", names, "1", "names of the actuators")
        write_fields(file, result)
        for name, case in result.cases.items():
            for part in ("magnitude", "real", "imaginary"):
                file[f"cases/{name}/{part}"].attrs["units"] = scene.drive_unit.replace("²", "^2")
            share = Dataset("1", "share of the plate's kinetic energy in the target")
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
            names = [target.name for target in scene.targets]
            meaning = "share of the plate's energy in each target, by each's drive"
            write_along(file, "target", names, "1", "names of the targets")
            write_along(file, "best_for", names, "1", "targets that the drives are best for")
            write_along(file, "crosstalk", crosstalk(result), "1", meaning, ["best_for", "target"])
            file["crosstalk"].attrs["targets"] = json.dumps(names)
    return Path(path)


def load_result(path: str | Path) -> Result:
    """Read a file that :func:`save_result` wrote, or raise a SceneError if it is missing, damaged or not a result."""
    with FORMAT.open(path) as file:
        result = read_fields(Result, file)
        if not result.cases:
            raise SceneError("cases is missing or empty")
        for name, case in result.cases.items():
            if case.trace.size and case.trace.shape[1] != len(result.trace_times):
                raise SceneError(f"cases/{name}/trace has other steps than trace_times")
        return result
