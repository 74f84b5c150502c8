"""A drive and the motion of the plate under it, amplitudes of drives as the scene gives them, and names of cases.

With several targets, the case "best" is the best drive for the first, "best NAME" that for another. The energies of all
cases have a region "target NAME" for each target, beside "plate" and the case's own "target".
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import h5py
import numpy as np

from warp_plate.plate.designs import scene_with
from warp_plate.quantities.region_quantities import decibels
from warp_plate.result.hdf5 import read_array, write_along
from warp_plate.result.layouts import ELSEWHERE, Attribute, Dataset, Layout, Sizes
from warp_plate.scene.errors import SceneError, number_text
from warp_plate.scene.model import Scene
from warp_plate.scene.specification import STANDARD_GRAVITY
from warp_plate.scene.target import NamedTarget


def _phase_lag(phasors: np.ndarray) -> np.ndarray:
    return np.where(phasors == 0, 0.0, np.mod(-np.angle(phasors), 2 * np.pi))


class _Phasors(Layout):
    """Complex amplitudes as ``real`` and ``imaginary``; for other programs also as ``magnitude`` and ``phase``."""

    magnitude = Dataset("", "drive magnitude of each actuator", ("actuator",))  # its unit depends on the scene
    phase = Dataset("rad", "drive phase lag of each actuator", ("actuator",))
    real = Dataset("", "real part of the complex amplitude of each actuator", ("actuator",), bounded=True)
    imaginary = Dataset("", "imaginary part of the complex amplitude of each actuator", ("actuator",), bounded=True)

    def write(self, group: h5py.Group, name: str, value: np.ndarray) -> None:
        self.magnitude.write(group, "magnitude", np.abs(value))
        self.phase.write(group, "phase", _phase_lag(value))
        self.real.write(group, "real", np.real(value))
        self.imaginary.write(group, "imaginary", np.imag(value))

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> np.ndarray:
        phasors = self.real.read(group, "real", sizes).astype(complex)
        phasors.imag = self.imaginary.read(group, "imaginary", sizes)
        return phasors


class _Energies(Layout):
    """Energies by region as one dataset, with the names of the regions as JSON in its attribute ``regions``."""

    values = Dataset("J", "kinetic energy averaged over the window, for each region")

    def write(self, group: h5py.Group, name: str, value: Mapping[str, float]) -> None:
        write_along(group, "region", list(value), "1", "names of the regions")
        write_along(group, name, np.array(list(value.values())), self.values.units, self.values.long_name, ["region"])
        group[name].attrs["regions"] = json.dumps(list(value))

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, float]:
        regions = Attribute(tuple[str, ...]).read(group, f"{name}/regions", sizes)
        if not {"plate", "target"} <= set(regions):
            raise SceneError(f"{group.name}/{name} has regions {regions}, without plate or target")
        return dict(zip(regions, read_array(group, name, (len(regions),)).tolist(), strict=True))


class UnknownNameError(SceneError, KeyError):
    """A name that a result does not have."""

    __str__ = SceneError.__str__


T = TypeVar("T")


class Named(dict[str, T]):
    """Values by name; the error of an unknown name calls it ``noun`` and lists the names that there are."""

    # ``dataclasses.asdict`` makes a copy from its items alone.
    def __init__(self, values: Mapping[str, T] | Iterable[tuple[str, T]], noun: str = "name") -> None:
        super().__init__(values)
        self.noun = noun

    def __missing__(self, name: str) -> T:
        raise UnknownNameError(f"{self.noun} = {name!r}: must be one of {', '.join(self)}")


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
    displacement: Annotated[np.ndarray, Dataset("m", "displacement (times, y, x)", ("times", "y", "x"))]
    trace: Annotated[np.ndarray, Dataset("m", "displacement at the recorded points (points, steps)", ("point", None))]
    status: Annotated[str, "energy/status"] = "ok"
    frequency: Annotated[np.ndarray | None, Dataset("Hz", "frequency of each actuator", ("actuator",))] = None
    centre: Annotated[np.ndarray | None, Dataset("m", "x, y of each actuator's middle", ("actuator", "axis"))] = None
    delay: Annotated[np.ndarray | None, Dataset("s", "start of each actuator's burst", ("actuator",))] = None

    motion: Annotated[RegionMotion | None, ELSEWHERE] = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "energy", Named(self.energy, "region"))

    def __repr__(self) -> str:
        return f"<Case {len(self.phasors)} actuators, localization factor {self.localization_factor:.4g}>"

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
    return scene_with(scene, frequency=case.frequency, centre=case.centre, delay=case.delay)


def only_actuator(case: Case, scene: Scene) -> str:
    """Return the name of the only actuator that a case drives; "" if it drives another number of them."""
    driven = [actuator.name for actuator, part in zip(scene.actuators, case.magnitude, strict=True) if part > 0]
    return driven[0] if len(driven) == 1 else ""


def amplitudes_as_given(scene: Scene, magnitudes: Iterable[float]) -> list[tuple[str, float, str]]:
    """Return key in the scene file, value and unit of each actuator's amplitude, a magnitude or the patch's force.

    Args:
        magnitudes: (actuators,) magnitudes [``Scene.drive_unit``].
    """
    return [
        (
            actuator.amplitude_key,
            float(value) * actuator.amplitude_area,
            actuator.amplitude_unit or scene.drive_unit,
        )
        for actuator, value in zip(scene.actuators, magnitudes, strict=True)
    ]


def amplitude_column(scene: Scene, magnitudes: Iterable[float], digits: str) -> tuple[str, list[str]]:
    """Return heading and cells of a table's column; ``digits`` is the format of magnitudes.

    Where some actuators have magnitudes and others forces, the units are in the cells.
    """
    amplitudes = amplitudes_as_given(scene, magnitudes)
    texts = [format(value, digits if key == "magnitude" else ".4g") for key, value, _ in amplitudes]
    kinds = dict.fromkeys((key, unit) for key, _, unit in amplitudes)
    if len(kinds) > 1:
        return " or ".join(key for key, _ in kinds), [
            f"{text} {row[2]}" for text, row in zip(texts, amplitudes, strict=True)
        ]
    return " ".join(f"{key} ({unit})" for key, unit in kinds), texts


def motion_table(cases: Mapping[str, Case], scene: Scene) -> tuple[list[str], list[list[str]]]:
    """Return headings and rows, by case labels, of the cases whose motion is known."""
    moving = {label: (case, case.motion) for label, case in cases.items() if case.motion is not None}
    tones = any(motion.acceleration is not None for _, motion in moving.values())
    searched = any(case.frequency is not None for case in cases.values())
    amplitude, rows = "", []
    for label, (case, motion) in moving.items():
        frequencies = sorted({scene.drive.frequency} if case.frequency is None else set(case.frequency.tolist()))
        amplitude, amplitudes = amplitude_column(scene, case.magnitude, ".3g")
        cells = [", ".join(f"{value:.6g}" for value in frequencies)] * searched
        cells += [amplitudes[int(case.magnitude.argmax())], number_text(case.localization_factor, ".4f")]
        cells += [number_text(motion.contrast, ".1f"), _pair(motion.velocity, 1e3)]
        cells.append(_pair(motion.displacement, 1e6))
        if tones:
            cells.append("none" if motion.acceleration is None else _pair(motion.acceleration, 1 / STANDARD_GRAVITY))
        rows.append([label, *cells])
    if len({tuple(row[1:]) for row in rows}) == 1 < len(rows):
        rows = [["all", *rows[0][1:]]]
    headings = ["drive", *["frequency Hz"] * searched, f"largest {amplitude}", "share", "contrast dB"]
    return [*headings, "velocity mm/s rms", "displacement µm peak", *["acceleration g rms"] * tones], rows


def _pair(values: tuple[float, float], factor: float) -> str:
    return " / ".join(number_text(factor * value, ".3g") for value in values)


def aligned(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as lines of text, headings broken in two, the first column left-aligned."""
    broken = [heading.partition(" ") for heading in headings]
    lines = [[first if second else "" for first, _, second in broken], [second or first for first, _, second in broken]]
    columns = list(zip(*lines, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    texts = [[f"{cell:{'>' if at else '<'}{widths[at]}}" for at, cell in enumerate(row)] for row in (*lines, *rows)]
    return "\n".join("  ".join(row).rstrip() for row in texts)


def target_cases(targets: Sequence[NamedTarget]) -> dict[str, str]:
    """Return the name of the case with the best drive by target name; empty if a scene has a single target."""
    return {target.name: f"best {target.name}" if index else "best" for index, target in enumerate(targets)}


def relative_to_own(shares: np.ndarray) -> np.ndarray:
    """Return (drives, targets) fractions relative to each drive's own target [dB]; −∞ where nothing moves."""
    return decibels(shares, np.diag(shares)[:, None])
