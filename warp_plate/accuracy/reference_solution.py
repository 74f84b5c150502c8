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
from functools import cached_property, partial
from typing import Literal

import numpy as np

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
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
from warp_plate.reference import forced
from warp_plate.reference.ritz import Modes, solve_modes
from warp_plate.reference.thin_plate import thin_plate
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.response import measure_response
from warp_plate.solve.solver import PlateSolver

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

# Gram matrices and those of coarser solutions → largest relative difference of what is observed.
Change = Callable[[np.ndarray, Sequence[np.ndarray]], float]


@dataclass(frozen=True)
class ReferenceSolution:
    """The accurate response of a scene, by one refinement of a method."""

    kind: Literal["ritz", "richardson"]  # method
    matrices: np.ndarray  # Gram matrices (2, 2M, 2M) of plate and target [J per (N/m²)²], see ``reference.forced``
    uncertainty: float  # largest relative error of the observed quantities; inf while unknown
    seconds: float  # time that this refinement takes [s]
    next_seconds: float  # estimated time that the next one takes [s]
    scenes: Sequence[Scene]  # the scene on the grids of Richardson's method; the scene alone for Ritz's
    device: str = "auto"  # device of Richardson's method
    modes: Modes | None = None  # modes of Ritz's method

    @cached_property
    def bound(self) -> float:
        """Largest localization factor of any drive."""
        return forced.bound(self.matrices)[0]

    @cached_property
    def drives(self) -> dict[str, np.ndarray]:
        """Phasors (actuators,) of "single", the best single actuator, and "best", which reaches the bound [N/m²]."""
        return {"single": best_single(self.matrices), "best": forced.bound(self.matrices)[1]}

    @cached_property
    def localization_factors(self) -> dict[str, float]:
        """Localization factors of these drives."""
        factors = forced.localization_factors(self.matrices, np.array(list(self.drives.values())))
        return dict(zip(self.drives, factors.tolist(), strict=True))

    @cached_property
    def frequencies(self) -> np.ndarray:
        """First natural frequencies [Hz]."""
        if self.modes is not None:
            return self.modes.angular_frequencies[:FREQUENCIES] / (2 * math.pi)
        coarse, fine = (natural_modes(scene, FREQUENCIES).frequencies for scene in self.scenes[-2:])
        extrapolated: np.ndarray = fine + _gain(self.scenes) * (fine - coarse)
        return extrapolated

    def displacement(self, phasors: np.ndarray, times: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the (times, points along y, points along x) displacement [m] under a drive (actuators,) [N/m²]."""
        scene = self.scenes[-1]
        if self.modes is None:
            from scipy.interpolate import RectBivariateSpline

            run = PlateSolver(scene, self.device).run(phasors[None], times.tolist())
            grid_x, grid_y = _grid_lines(scene)
            return np.array([RectBivariateSpline(grid_y, grid_x, frame)(y, x) for frame in run.displacement[0]])
        force = phasors @ self.modes.patch_forces([actuator.area for actuator in scene.actuators])
        motion = forced.motion_from_rest(self.modes, scene.drive.frequency, max(scene.window.end, times.max()))
        # Summing modes before evaluating them on the grid avoids an array of modes × nodes.
        coefficients = np.tensordot((force * motion.at(times)).real, self.modes.vectors, axes=1)
        displacement: np.ndarray = self.modes.along_y.values(y).T @ coefficients @ self.modes.along_x.values(x)
        return displacement

    def displacement_error(
        self, phasors: np.ndarray, times: Sequence[float] | np.ndarray, scene: Scene, computed: np.ndarray
    ) -> float:
        """Return ‖u − u_ref‖ / ‖u_ref‖ over the times and the nodes of the scene; NaN for a plate at rest."""
        expected = self.displacement(phasors, np.asarray(times, dtype=float), *_grid_lines(scene))
        size = float(np.linalg.norm(expected))
        return float(np.linalg.norm(computed - expected)) / size if size > 0 else math.nan


def best_single(matrices: np.ndarray) -> np.ndarray:
    """Return the phasors (actuators,) of the best single actuator."""
    singles = np.eye(matrices.shape[1] // 2, dtype=complex)
    best: np.ndarray = singles[int(np.argmax(forced.localization_factors(matrices, singles)))]
    return best


def find_reference_solution(
    scene: Scene,
    kind: str,
    device: str,
    wanted: float | Callable[[np.ndarray], float] = 1e-5,
    seconds: float = 60.0,
    phasors: np.ndarray | None = None,
    only: bool = False,
) -> ReferenceSolution:
    """Refine a reference solution until its uncertainty is below ``wanted``, or no time is left.

    Args:
        scene: A scene that is linear in its drives.
        kind: "auto", "ritz" or "richardson".
        device: Device of Richardson's method.
        wanted: An uncertainty, or a function of the Gram matrices that returns one.
        seconds: Time for all refinements [s].
        phasors: Drives (drives, actuators) that the uncertainty applies to, besides the bound, equal drive, the best
            single actuator and the best drive.
        only: True if the uncertainty applies to ``phasors`` alone.

    Raises:
        SceneError: kind = "ritz" and the scene has an edge, an effect or a target that Ritz's method does not support;
            the scene is not linear; or there is no such device.
    """
    if not scene.linear:
        raise SceneError(f"{scene.nonlinear_table}: not linear in the drives; accuracy needs a linear scene")
    observed = np.empty((0, len(scene.actuators))) if phasors is None else phasors
    refinements = _refinements(scene, kind, device, partial(_change, observed, only))
    started = time.perf_counter()
    last = next(refinements)
    spent = last.seconds
    while last.uncertainty > (wanted(last.matrices) if callable(wanted) else wanted):
        late = time.perf_counter() - started > PATIENCE * seconds + PATIENCE_SECONDS
        if math.isfinite(last.uncertainty) and (late or spent + last.next_seconds > seconds):
            break
        following = next(refinements, None)
        if following is None:
            break
        last = following
        spent += last.seconds
    return last


def _change(phasors: np.ndarray, only: bool, matrices: np.ndarray, others: Sequence[np.ndarray]) -> float:
    """Return the largest relative difference of the observed quantities from those of other matrices."""
    if not only:
        single = best_single(matrices)
        usual = np.array([single, forced.bound(matrices)[1], np.ones_like(single)])
        phasors = np.concatenate([usual, phasors])

    def values(of: np.ndarray) -> np.ndarray:
        return np.append(forced.localization_factors(of, phasors), [] if only else forced.bound(of)[0])

    current = values(matrices)
    return max(float(np.abs(values(other) / current - 1).max()) for other in others)


def _refinements(scene: Scene, kind: str, device: str, change: Change) -> Iterator[ReferenceSolution]:
    if kind != "richardson":
        try:
            yield from _by_ritz(scene, change)
            return
        except (SceneError, ValueError):  # an unsupported effect or target, or an undamped resonance
            if kind == "ritz":
                raise
    yield from _by_richardson(scene, device, change)


def _by_ritz(scene: Scene, change: Change) -> Iterator[ReferenceSolution]:
    plate = thin_plate(scene)
    scene.target.rectangle()  # refuse other targets before any work
    matrices: list[np.ndarray] = []
    times = [*RITZ_SECONDS.values(), math.inf]
    for count, seconds, following in zip(RITZ_SECONDS, times[:-1], times[1:], strict=True):
        functions = _functions(plate.size, count)
        modes = solve_modes(plate, functions)
        loss = plate.viscous / (2 * plate.surface_density)
        apart = np.hypot(modes.angular_frequencies - scene.drive_angular_frequency, loss).min()
        if apart * scene.window.end < NEAREST_RESONANCE:  # the large, opposite motions of mode and drive would cancel
            raise ValueError(f"drive.frequency = {scene.drive.frequency:g}: the undamped plate is driven at resonance")
        matrices.append(forced.transient_matrices(modes, scene))
        uncertainty = math.inf
        if len(matrices) > 2:
            # Successive errors may differ in sign, so one small change proves nothing.
            uncertainty = CHANGE_FACTOR * change(matrices[-1], matrices[-3:-1])
            needed = (FUNCTIONS_A_WAVE * side / bending_wavelength(scene) + 4 for side in plate.size)
            if any(given < least for given, least in zip(functions, needed, strict=True)):
                uncertainty = max(uncertainty, 1.0)  # an unresolved solution may be stationary at a wrong value
        yield ReferenceSolution("ritz", matrices[-1], uncertainty, seconds, following, [scene], modes=modes)


def _functions(size: tuple[float, float], count: int) -> tuple[int, int]:
    """Return functions of x and of y, count² in all, in proportion to the sides as far as rounding allows."""
    longer = min(MOST_FUNCTIONS, round(count * math.sqrt(max(size) / min(size))))
    shorter = max(FEWEST_FUNCTIONS, round(count**2 / longer))
    return (longer, shorter) if size[0] >= size[1] else (shorter, longer)


def _by_richardson(scene: Scene, device: str, change: Change) -> Iterator[ReferenceSolution]:
    matrices: list[np.ndarray] = []
    extrapolated: list[np.ndarray] = []
    scenes: list[Scene] = []
    # Time steps fall as h²; the drive limits the coarsest.
    order, end = highest_order(scene), scene.window.end
    grids = [nodes_for(scene.plate.size, side, order) for side in SIDES]
    limits = [stability_limit(scene, order, nodes) for nodes in grids]
    fraction = min(SAFETY, 1 / (STEPS_A_PERIOD * highest_frequency(scene)) / limits[0])
    for nodes, limit in zip(grids, limits, strict=True):
        started = time.perf_counter()
        time_step = end / math.ceil(end / (fraction * limit))
        configuration = Configuration(order, LOAD_OF[order], nodes, time_step, "float64")
        scenes.append(scene_with(scene, configuration))
        matrices.append(measure_response(PlateSolver(scenes[-1], device)).matrices)
        uncertainty = math.inf
        if len(matrices) > 1:
            extrapolated.append(matrices[-1] + _gain(scenes) * (matrices[-1] - matrices[-2]))
        if len(extrapolated) > 1:
            uncertainty = CHANGE_FACTOR * change(extrapolated[-1], extrapolated[-2:-1])
            uncertainty = max(uncertainty, GAIN_FACTOR * change(extrapolated[-1], matrices[-1:]))
        best = extrapolated[-1] if extrapolated else matrices[-1]
        took = time.perf_counter() - started
        # The next grid has twice the nodes and twice the steps.
        yield ReferenceSolution("richardson", best, uncertainty, took, 4 * took, tuple(scenes), device)


def _gain(scenes: Sequence[Scene]) -> float:
    """Return Richardson's factor on the change between the last two grids."""
    coarse, fine = (spacing_of(scene, scene.grid.nodes) for scene in scenes[-2:])
    return 1 / ((coarse / fine) ** scenes[-1].grid.order - 1)


def _grid_lines(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return (nx,) and (ny,) coordinates of the nodes [m]."""
    (width, height), (nx, ny) = scene.plate.size, scene.grid.nodes
    return np.linspace(0, width, nx), np.linspace(0, height, ny)
