"""The right answer of a scene, with its error bar: Gram matrices that hold for any drive.

"ritz": from the modes of ``reference.ritz``, exact in time, with more functions until the answer stands still.
"richardson": where no such reference exists, from three grids of the program's own, the error of which falls as h⁴
(fourth order, moments) or h² (second order, overlap); the time step falls as h², so that its error falls as h⁴ too.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import RectBivariateSpline

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
    Order,
    bending_wave,
    highest_order,
    nodes_for,
    scene_with,
    spacing_of,
    stability_limit,
)
from warp_plate.accuracy.natural_frequencies import natural_frequencies
from warp_plate.plate.scheme import SAFETY, STEPS_A_PERIOD
from warp_plate.plate.signals import highest_frequency
from warp_plate.reference.forced import bound, localization_factors, motion_from_rest, transient_matrices
from warp_plate.reference.ritz import Modes, solve_modes
from warp_plate.reference.thin_plate import thin_plate
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.response import measure_response
from warp_plate.solve.solver import PlateSolver

Kind = Literal["ritz", "richardson"]
# Times, points of x and points of y → (times, points of y, points of x) displacement [m].
Field = Callable[[Sequence[float] | np.ndarray, np.ndarray, np.ndarray], np.ndarray]

# Numbers of functions a side, and the seconds that each takes on two quiet cores: what may be done within a time is
# decided by these, so that the same call gives the same answer on a busy machine.
RITZ_SECONDS = {10: 0.01, 12: 0.015, 14: 0.02, 16: 0.04, 20: 0.08, 24: 0.18, 32: 0.5, 40: 1.4, 48: 3.0}
# Functions of one direction, and how many of them a bending wave takes (a polynomial needs π a wave at least, and less
# counts for the low modes that carry most of the energy).
FEWEST_FUNCTIONS, MOST_FUNCTIONS, FUNCTIONS_A_WAVE = 8, 60, 2.6
# On a machine so busy that the work takes so many times longer, and so many seconds more, it ends where it is.
PATIENCE, PATIENCE_SECONDS = 2.0, 5.0
SIDES = (19, 27, 37, 53, 75, 105, 149)
FREQUENCIES = 6
# The error of an extrapolated value: so many times the last change, and at least this part of what it added (measured
# on the paper's scene against Ritz's method: 1.2 times the change).
DOUBT_OF_CHANGE, DOUBT_OF_GAIN = 2.0, 0.2
# Radians by which drive and mode must part within the run: energies lose the square of it in digits.
NEAREST_RESONANCE = 1e-4
# How plates are stepped.
PATH = "auto"


@dataclass(frozen=True)
class ReferenceSolution:
    """What the plate of a scene does.

    kind; matrices: (2, 2M, 2M) of plate and target [J per (N/m²)²], see ``reference.forced``; drives: "single" (the
    best single actuator) and "best" (one that reaches the bound), each (actuators,) phasors [N/m²];
    localization_factors: of these; bound: on the localization factor of any drive; uncertainty: relative, the largest
    of these three numbers; frequencies: the first natural ones [Hz]; field: displacement under the best drive; stage:
    what all of this comes from.
    """

    kind: Kind
    matrices: np.ndarray
    drives: dict[str, np.ndarray]
    localization_factors: dict[str, float]
    bound: float
    uncertainty: float
    frequencies: np.ndarray
    field: Field
    stage: ReferenceStage

    def displacement(self, times: Sequence[float] | np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(times, points of y, points of x) displacement [m] under the best drive."""
        return self.field(times, x, y)


@dataclass(frozen=True)
class ReferenceStage:
    """One step of a growing reference.

    size: functions or nodes of a side; uncertainty: largest relative change of the probes, inf while unknown; seconds:
    that it took, and that the next one takes, about.
    """

    kind: Kind
    size: int
    matrices: np.ndarray
    uncertainty: float
    seconds: float
    next_seconds: float
    modes: Modes | None = None
    scenes: tuple[Scene, ...] = ()


def find_reference_solution(
    scene: Scene,
    kind: Literal["auto", "ritz", "richardson"] = "auto",
    device: str = "auto",
    wanted: float = 1e-5,
    seconds: float = 60.0,
    drives: np.ndarray | None = None,
) -> ReferenceSolution:
    """The right answer, its uncertainty below ``wanted`` or as small as ``seconds`` of work make it.

    The uncertainty is that of the bound and of equal drive, best single actuator, best drive and ``drives``.

    Raises:
        SceneError: kind = "ritz" and the scene has an edge, an effect or a target that the reference does not know;
            no such device.
    """
    stage = grow(scene, kind, device, wanted, seconds, more=drives)
    largest, best = bound(stage.matrices)
    singles = np.eye(len(scene.actuators), dtype=complex)
    single = singles[int(np.argmax(localization_factors(stage.matrices, singles)))]
    factors = localization_factors(stage.matrices, np.array([single, best]))
    return ReferenceSolution(
        kind=stage.kind,
        matrices=stage.matrices,
        drives={"single": single, "best": best},
        localization_factors={"single": float(factors[0]), "best": float(factors[1])},
        bound=largest,
        uncertainty=stage.uncertainty,
        frequencies=_frequencies(stage),
        field=ritz_field(stage.modes, scene, best) if stage.modes else _grid_field(stage.scenes[-1], device, best),
        stage=stage,
    )


def grow(
    scene: Scene,
    kind: str = "auto",
    device: str = "auto",
    wanted: float | Callable[[np.ndarray], float] = 1e-5,
    seconds: float = 60.0,
    drives: np.ndarray | None = None,
    more: np.ndarray | None = None,
) -> ReferenceStage:
    """The last stage of the reference: uncertainty below ``wanted``, or no time left for the next.

    wanted: a number, or a function of the stage's matrices; drives: (drives, actuators) whose localization factors are
    to stand still; left out: equal drive, the best single actuator, the best drive, and ``more``; with the bound.
    """
    if not scene.linear:
        raise SceneError(f"{scene.nonlinear_table}: not linear in the drives; accuracy needs a linear scene")
    stages = _stages(scene, kind, device, Probes(drives, more))
    started = time.perf_counter()
    last = next(stages)
    spent = last.seconds
    while last.uncertainty > (wanted(last.matrices) if callable(wanted) else wanted):
        if math.isfinite(last.uncertainty) and spent + last.next_seconds > seconds:
            break
        if math.isfinite(last.uncertainty) and time.perf_counter() - started > PATIENCE * seconds + PATIENCE_SECONDS:
            break
        following = next(stages, None)
        if following is None:
            break
        last = following
        spent += last.seconds
    return last


@dataclass(frozen=True)
class Probes:
    """The drives whose localization factors are watched: these alone, or the usual ones and more."""

    alone: np.ndarray | None = None
    more: np.ndarray | None = None

    def change(self, matrices: np.ndarray, others: Sequence[np.ndarray]) -> float:
        """Largest relative difference of what is watched between these matrices and the others."""
        if self.alone is not None:
            watched = self.alone
        else:
            singles = np.eye(matrices.shape[1] // 2, dtype=complex)
            single = singles[int(np.argmax(localization_factors(matrices, singles)))]
            usual = np.array([single, bound(matrices)[1], np.ones_like(single)])
            watched = usual if self.more is None else np.concatenate([usual, self.more])

        def values(one: np.ndarray) -> np.ndarray:
            return np.append(localization_factors(one, watched), [] if self.alone is not None else bound(one)[0])

        now = values(matrices)
        return max(float(np.abs(values(other) / now - 1).max()) for other in others)


def _stages(scene: Scene, kind: str, device: str, probes: Probes) -> Iterator[ReferenceStage]:
    if kind != "richardson":
        try:
            yield from _ritz_stages(scene, probes)
            return
        except (SceneError, ValueError):  # an effect or a target that it does not know, or an undamped resonance
            if kind == "ritz":
                raise
    yield from _richardson_stages(scene, device, probes)


def _ritz_stages(scene: Scene, probes: Probes) -> Iterator[ReferenceStage]:
    plate = thin_plate(scene)
    scene.target.rectangle()  # before any work
    kept: list[np.ndarray] = []
    for count, seconds in RITZ_SECONDS.items():
        functions = _functions(plate.size, count)
        modes = solve_modes(plate, functions)
        _check_resonance(modes, scene)
        kept.append(transient_matrices(modes, scene))
        # Errors of successive numbers of functions may differ in sign: one small change is no proof.
        change = DOUBT_OF_CHANGE * probes.change(kept[-1], kept[-3:-1]) if len(kept) > 2 else math.inf
        if len(kept) > 2 and not _resolves(scene, functions):
            change = max(change, 1.0)  # what is not resolved may stand still at a wrong value
        following = min((later for size, later in RITZ_SECONDS.items() if size > count), default=math.inf)
        yield ReferenceStage("ritz", count, kept[-1], change, seconds, following, modes)


def _functions(size: tuple[float, float], count: int) -> tuple[int, int]:
    """Functions of x and of y: count² in all, in proportion to the sides as far as rounding lets them grow."""
    longer = min(MOST_FUNCTIONS, round(count * math.sqrt(max(size) / min(size))))
    shorter = max(FEWEST_FUNCTIONS, round(count**2 / longer))
    return (longer, shorter) if size[0] >= size[1] else (shorter, longer)


def _resolves(scene: Scene, functions: tuple[int, int]) -> bool:
    """Whether so many functions can follow the bending wave at the drive's frequency along both sides."""
    needed = (FUNCTIONS_A_WAVE * side / bending_wave(scene) + 4 for side in scene.plate.size)
    return all(count >= least for count, least in zip(functions, needed, strict=True))


def _check_resonance(modes: Modes, scene: Scene) -> None:
    """Raise ValueError where a mode and the drive are so near that their motions, large and opposite, cancel out."""
    plate = modes.plate
    loss = plate.viscous / (2 * plate.surface_density)
    apart = np.hypot(modes.angular_frequencies - scene.drive_angular_frequency, loss).min()
    if apart * scene.window.end < NEAREST_RESONANCE:
        raise ValueError(f"drive.frequency = {scene.drive.frequency:g}: the undamped plate is driven at its resonance")


def _richardson_stages(scene: Scene, device: str, probes: Probes) -> Iterator[ReferenceStage]:
    order = highest_order(scene)
    configurations = _falling_steps(scene, order)
    matrices: list[np.ndarray] = []
    extrapolated: list[np.ndarray] = []
    scenes: list[Scene] = []
    for configuration in configurations:
        started = time.perf_counter()
        scenes.append(scene_with(scene, configuration))
        matrices.append(measure_response(PlateSolver(scenes[-1], device, PATH)).matrices)
        change = math.inf
        if len(matrices) > 1:
            spacings = [spacing_of(scene, one.grid.nodes) for one in scenes[-2:]]
            gain = 1 / ((spacings[0] / spacings[1]) ** order - 1)
            extrapolated.append(matrices[-1] + gain * (matrices[-1] - matrices[-2]))
        if len(extrapolated) > 1:
            change = DOUBT_OF_CHANGE * probes.change(extrapolated[-1], extrapolated[-2:-1])
            change = max(change, DOUBT_OF_GAIN * probes.change(extrapolated[-1], matrices[-1:]))
        best = extrapolated[-1] if extrapolated else matrices[-1]
        took = time.perf_counter() - started
        # Each grid has twice the nodes of the one before, and twice the steps.
        yield ReferenceStage("richardson", configuration.nodes[0], best, change, took, 4 * took, scenes=tuple(scenes))


def _falling_steps(scene: Scene, order: Order) -> list[Configuration]:
    """Grids with time steps that fall as h² throughout; the drive allows the coarsest one's."""
    nodes = [nodes_for(scene.plate.size, side, order) for side in SIDES]
    limits = [stability_limit(scene, order, one) for one in nodes]
    part = min(SAFETY, 1 / (STEPS_A_PERIOD * highest_frequency(scene)) / limits[0])
    end = scene.window.end
    return [
        Configuration(order, LOAD_OF[order], one, end / math.ceil(end / (part * limit)), "float64")
        for one, limit in zip(nodes, limits, strict=True)
    ]


def _frequencies(stage: ReferenceStage) -> np.ndarray:
    if stage.modes is not None:
        return stage.modes.angular_frequencies[:FREQUENCIES] / (2 * math.pi)
    coarse, fine = (natural_frequencies(scene, FREQUENCIES) for scene in stage.scenes[-2:])
    spacings = [spacing_of(scene, scene.grid.nodes) for scene in stage.scenes[-2:]]
    gain = 1 / ((spacings[0] / spacings[1]) ** stage.scenes[-1].grid.order - 1)
    found: np.ndarray = fine + gain * (fine - coarse)
    return found


def ritz_field(modes: Modes, scene: Scene, drive: np.ndarray) -> Field:
    """The displacement under a drive (actuators,) by Ritz's method."""

    def field(times: Sequence[float] | np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        when = np.asarray(times, dtype=float)
        force = drive @ modes.patch_forces([actuator.area for actuator in scene.actuators])
        motion = motion_from_rest(modes, scene.drive.frequency, max(scene.window.end, when.max()))
        # Shapes are summed before they are drawn on the grid: modes × nodes would fill the memory.
        shares = np.tensordot((force * motion.at(when)).real, modes.vectors, axes=1)
        drawn: np.ndarray = modes.along_y.values(y).T @ shares @ modes.along_x.values(x)
        return drawn

    return field


def _grid_field(scene: Scene, device: str, drive: np.ndarray) -> Field:
    def field(times: Sequence[float] | np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        run = PlateSolver(scene, device, PATH).run(drive[None], list(times))
        width, height = scene.plate.size
        own_x, own_y = np.linspace(0, width, scene.grid.nodes[0]), np.linspace(0, height, scene.grid.nodes[1])
        return np.array([RectBivariateSpline(own_y, own_x, frame)(y, x) for frame in run.displacement[0]])

    return field

