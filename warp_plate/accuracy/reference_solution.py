"""Reference solutions with an error bar: Gram matrices of the kinetic energies, which hold for any drive.

"ritz": modes by Ritz's method, exact in time, with increasing numbers of functions until the result is stationary.
"richardson": for other scenes, extrapolation from three grids of this program, whose error falls as h⁴ (fourth order,
moments) or h² (second order, overlap). The time step falls as h², so its error falls as h⁴ too.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
    Order,
    bending_wavelength,
    highest_order,
    nodes_for,
    scene_with,
    spacing_of,
    stability_limit,
)
from warp_plate.plate.modes import natural_modes
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
# Times, points along x and points along y → (times, points along y, points along x) displacement [m].
Field = Callable[[Sequence[float] | np.ndarray, np.ndarray, np.ndarray], np.ndarray]

# Numbers of functions a side and the time that each takes on two quiet cores [s]. These times, not a clock, decide how
# far the reference is refined, so that a busy machine gives the same result.
RITZ_SECONDS = {10: 0.01, 12: 0.015, 14: 0.02, 16: 0.04, 20: 0.08, 24: 0.18, 32: 0.5, 40: 1.4, 48: 3.0}
# Functions along a side, and functions that a bending wave takes (a polynomial needs π a wave, and low modes, which
# carry most of the energy, need fewer).
FEWEST_FUNCTIONS, MOST_FUNCTIONS, FUNCTIONS_A_WAVE = 8, 60, 2.6
# On a very busy machine refinement ends when the work takes this many times longer, plus these seconds.
PATIENCE, PATIENCE_SECONDS = 2.0, 5.0
# Nodes along the sides of the grids of Richardson's method, and natural frequencies that are returned.
SIDES, FREQUENCIES = (19, 27, 37, 53, 75, 105, 149), 6
# Error of an extrapolated value: this many times the last change, and at least this fraction of what extrapolation
# added (measured against Ritz's method on the paper's scene: 1.2 times the change).
CHANGE_FACTOR, GAIN_FACTOR = 2.0, 0.2
# Least phase [rad] by which drive and mode differ at the end of the run: energies lose its square in digits.
NEAREST_RESONANCE = 1e-4


@dataclass(frozen=True)
class ReferenceSolution:
    """The accurate response of a scene."""

    kind: Kind  # method
    matrices: np.ndarray  # Gram matrices (2, 2M, 2M) of plate and target [J per (N/m²)²], see ``reference.forced``
    # Phasors (actuators,) of "single", the best single actuator, and "best", which reaches the bound [N/m²]
    drives: dict[str, np.ndarray]
    localization_factors: dict[str, float]  # localization factors of these drives
    bound: float  # largest localization factor of any drive
    uncertainty: float  # largest relative error of these three numbers
    frequencies: np.ndarray  # first natural frequencies [Hz]
    displacement: Field  # displacement under the best drive, see ``Field``
    stage: ReferenceStage  # last refinement


@dataclass(frozen=True)
class ReferenceStage:
    """A refinement of a reference solution."""

    kind: Kind  # method
    size: int  # functions or nodes of a side
    matrices: np.ndarray  # Gram matrices (2, 2M, 2M) of plate and target [J per (N/m²)²]
    uncertainty: float  # largest relative error of the observed quantities; inf while unknown
    seconds: float  # time that this refinement takes [s]
    next_seconds: float  # estimated time that the next one takes [s]
    modes: Modes | None = None  # modes of Ritz's method
    scenes: tuple[Scene, ...] = ()  # scenes on the grids of Richardson's method


@dataclass(frozen=True)
class Observed:
    """The quantities whose convergence is observed: localization factors of drives, and the bound."""

    # Drives (drives, actuators), without the bound; None: best single, best and equal drive, ``more``, and the bound
    only: np.ndarray | None = None
    more: np.ndarray | None = None  # further drives (drives, actuators)

    def change(self, matrices: np.ndarray, others: Sequence[np.ndarray]) -> float:
        """Return the largest relative difference of the quantities from those of other matrices."""
        if self.only is not None:
            phasors = self.only
        else:
            single = best_single(matrices)
            phasors = np.array([single, bound(matrices)[1], np.ones_like(single)])
            phasors = phasors if self.more is None else np.concatenate([phasors, self.more])

        def values(of: np.ndarray) -> np.ndarray:
            return np.append(localization_factors(of, phasors), [] if self.only is not None else bound(of)[0])

        current = values(matrices)
        return max(float(np.abs(values(other) / current - 1).max()) for other in others)


def best_single(matrices: np.ndarray) -> np.ndarray:
    """Return the phasors (actuators,) of the best single actuator."""
    singles = np.eye(matrices.shape[1] // 2, dtype=complex)
    best: np.ndarray = singles[int(np.argmax(localization_factors(matrices, singles)))]
    return best


def find_reference_solution(
    scene: Scene,
    kind: Literal["auto", "ritz", "richardson"] = "auto",
    device: str = "auto",
    wanted: float = 1e-5,
    seconds: float = 60.0,
    phasors: np.ndarray | None = None,
) -> ReferenceSolution:
    """Return a reference solution with an uncertainty below ``wanted``, or as small as ``seconds`` of work allow.

    The uncertainty is that of the bound and of equal drive, best single actuator, best drive and ``phasors``.

    Raises:
        SceneError: kind = "ritz" and the scene has an edge, an effect or a target that Ritz's method does not support,
            or there is no such device.
    """
    stage = refine_reference(scene, kind, device, wanted, seconds, Observed(more=phasors))
    largest, best = bound(stage.matrices)
    single = best_single(stage.matrices)
    factors = localization_factors(stage.matrices, np.array([single, best]))
    field = ritz_field(stage.modes, scene, best) if stage.modes else _grid_field(stage.scenes[-1], device, best)
    return ReferenceSolution(
        kind=stage.kind,
        matrices=stage.matrices,
        drives={"single": single, "best": best},
        localization_factors={"single": float(factors[0]), "best": float(factors[1])},
        bound=largest,
        uncertainty=stage.uncertainty,
        frequencies=_frequencies(stage),
        displacement=field,
        stage=stage,
    )


def refine_reference(
    scene: Scene,
    kind: str,
    device: str,
    wanted: float | Callable[[np.ndarray], float],
    seconds: float,
    observed: Observed,
) -> ReferenceStage:
    """Refine a reference solution until its uncertainty is below ``wanted``, or no time is left for the next stage.

    Args:
        scene: A scene that is linear in its drives.
        kind: "auto", "ritz" or "richardson".
        device: Device of Richardson's method.
        wanted: An uncertainty, or a function of the stage's matrices that returns one.
        seconds: Time for all stages [s].
        observed: Quantities that the uncertainty applies to.
    """
    if not scene.linear:
        raise SceneError(f"{scene.nonlinear_table}: not linear in the drives; accuracy needs a linear scene")
    stages = _stages(scene, kind, device, observed)
    started = time.perf_counter()
    last = next(stages)
    spent = last.seconds
    while last.uncertainty > (wanted(last.matrices) if callable(wanted) else wanted):
        late = time.perf_counter() - started > PATIENCE * seconds + PATIENCE_SECONDS
        if math.isfinite(last.uncertainty) and (late or spent + last.next_seconds > seconds):
            break
        following = next(stages, None)
        if following is None:
            break
        last = following
        spent += last.seconds
    return last


def _stages(scene: Scene, kind: str, device: str, observed: Observed) -> Iterator[ReferenceStage]:
    if kind != "richardson":
        try:
            yield from _ritz_stages(scene, observed)
            return
        except (SceneError, ValueError):  # an unsupported effect or target, or an undamped resonance
            if kind == "ritz":
                raise
    yield from _richardson_stages(scene, device, observed)


def _ritz_stages(scene: Scene, observed: Observed) -> Iterator[ReferenceStage]:
    plate = thin_plate(scene)
    scene.target.rectangle()  # refuse other targets before any work
    kept: list[np.ndarray] = []
    for count, seconds in RITZ_SECONDS.items():
        functions = _functions(plate.size, count)
        modes = solve_modes(plate, functions)
        _check_resonance(modes, scene)
        kept.append(transient_matrices(modes, scene))
        # Successive errors may differ in sign, so one small change proves nothing.
        change = CHANGE_FACTOR * observed.change(kept[-1], kept[-3:-1]) if len(kept) > 2 else math.inf
        if len(kept) > 2 and not _resolves(scene, functions):
            change = max(change, 1.0)  # an unresolved solution may be stationary at a wrong value
        following = min((later for size, later in RITZ_SECONDS.items() if size > count), default=math.inf)
        yield ReferenceStage("ritz", count, kept[-1], change, seconds, following, modes)


def _functions(size: tuple[float, float], count: int) -> tuple[int, int]:
    """Return functions of x and of y, count² in all, in proportion to the sides as far as rounding allows."""
    longer = min(MOST_FUNCTIONS, round(count * math.sqrt(max(size) / min(size))))
    shorter = max(FEWEST_FUNCTIONS, round(count**2 / longer))
    return (longer, shorter) if size[0] >= size[1] else (shorter, longer)


def _resolves(scene: Scene, functions: tuple[int, int]) -> bool:
    """Return whether the functions resolve the bending wave at the drive's frequency along both sides."""
    needed = (FUNCTIONS_A_WAVE * side / bending_wavelength(scene) + 4 for side in scene.plate.size)
    return all(count >= least for count, least in zip(functions, needed, strict=True))


def _check_resonance(modes: Modes, scene: Scene) -> None:
    """Raise ValueError if a mode is so close to the drive that their large, opposite motions cancel."""
    plate = modes.plate
    loss = plate.viscous / (2 * plate.surface_density)
    apart = np.hypot(modes.angular_frequencies - scene.drive_angular_frequency, loss).min()
    if apart * scene.window.end < NEAREST_RESONANCE:
        raise ValueError(f"drive.frequency = {scene.drive.frequency:g}: the undamped plate is driven at its resonance")


def _richardson_stages(scene: Scene, device: str, observed: Observed) -> Iterator[ReferenceStage]:
    order = highest_order(scene)
    matrices: list[np.ndarray] = []
    extrapolated: list[np.ndarray] = []
    scenes: list[Scene] = []
    for configuration in _nested_configurations(scene, order):
        started = time.perf_counter()
        scenes.append(scene_with(scene, configuration))
        matrices.append(measure_response(PlateSolver(scenes[-1], device)).matrices)
        change = math.inf
        if len(matrices) > 1:
            extrapolated.append(matrices[-1] + _gain(scenes) * (matrices[-1] - matrices[-2]))
        if len(extrapolated) > 1:
            change = CHANGE_FACTOR * observed.change(extrapolated[-1], extrapolated[-2:-1])
            change = max(change, GAIN_FACTOR * observed.change(extrapolated[-1], matrices[-1:]))
        best = extrapolated[-1] if extrapolated else matrices[-1]
        took = time.perf_counter() - started
        # The next grid has twice the nodes and twice the steps.
        yield ReferenceStage("richardson", configuration.nodes[0], best, change, took, 4 * took, scenes=tuple(scenes))


def _nested_configurations(scene: Scene, order: Order) -> list[Configuration]:
    """Return configurations with time steps that fall as h², the coarsest allowed by the drive."""
    nodes = [nodes_for(scene.plate.size, side, order) for side in SIDES]
    limits = [stability_limit(scene, order, grid) for grid in nodes]
    fraction = min(SAFETY, 1 / (STEPS_A_PERIOD * highest_frequency(scene)) / limits[0])
    end = scene.window.end
    return [
        Configuration(order, LOAD_OF[order], grid, end / math.ceil(end / (fraction * limit)), "float64")
        for grid, limit in zip(nodes, limits, strict=True)
    ]


def _gain(scenes: Sequence[Scene]) -> float:
    """Return Richardson's factor on the change between the last two grids."""
    coarse, fine = (spacing_of(scene, scene.grid.nodes) for scene in scenes[-2:])
    return 1 / ((coarse / fine) ** scenes[-1].grid.order - 1)


def _frequencies(stage: ReferenceStage) -> np.ndarray:
    if stage.modes is not None:
        return stage.modes.angular_frequencies[:FREQUENCIES] / (2 * math.pi)
    coarse, fine = (natural_modes(scene, FREQUENCIES).frequencies for scene in stage.scenes[-2:])
    extrapolated: np.ndarray = fine + _gain(stage.scenes) * (fine - coarse)
    return extrapolated


def ritz_field(modes: Modes, scene: Scene, phasors: np.ndarray) -> Field:
    """Return the displacement under a drive (actuators,) as a function, by Ritz's method."""

    def field(times: Sequence[float] | np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        instants = np.asarray(times, dtype=float)
        force = phasors @ modes.patch_forces([actuator.area for actuator in scene.actuators])
        motion = motion_from_rest(modes, scene.drive.frequency, max(scene.window.end, instants.max()))
        # Summing modes before evaluating them on the grid avoids an array of modes × nodes.
        coefficients = np.tensordot((force * motion.at(instants)).real, modes.vectors, axes=1)
        displacement: np.ndarray = modes.along_y.values(y).T @ coefficients @ modes.along_x.values(x)
        return displacement

    return field


def _grid_field(scene: Scene, device: str, phasors: np.ndarray) -> Field:
    def field(times: Sequence[float] | np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        from scipy.interpolate import RectBivariateSpline

        run = PlateSolver(scene, device).run(phasors[None], list(times))
        (width, height), (nx, ny) = scene.plate.size, scene.grid.nodes
        grid_x, grid_y = np.linspace(0, width, nx), np.linspace(0, height, ny)
        return np.array([RectBivariateSpline(grid_y, grid_x, frame)(y, x) for frame in run.displacement[0]])

    return field
