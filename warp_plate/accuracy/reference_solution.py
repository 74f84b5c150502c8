"""Reference solutions with an error bar: Gram matrices of the kinetic energies, which hold for any drive.

"modal": modes of the plate without a grid, exact in time, with ever more functions.
"richardson": for other scenes, extrapolation from grids of this program, see :mod:`~warp_plate.accuracy.richardson`.

How far a reference is refined is decided by its nominal seconds, from the numbers of operations: the same scene has the
same reference on every machine.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from warp_plate.accuracy.configurations import refuse_many_modes
from warp_plate.accuracy.richardson import Extrapolation, extrapolate
from warp_plate.modal.coils_in_time import in_time
from warp_plate.modal.gram import Means, gram_matrices
from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.modal.motion import fields
from warp_plate.plate.signals import actuator_frequencies, highest_frequency
from warp_plate.plate.weights import REGIONS, localization_factor, node_positions
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.response import Response, count_unit_drives, measure_response
from warp_plate.solve.solver import PlateSolver

# Densities of the functions, see ``solve_modes``, and that of the functions that results by modes are compared with.
DENSITIES, FINER = (0.7, 1.0, 1.4), 1.4
# Nominal time per unknown and per square of a mode [s], as on two cores.
MODAL_SECONDS = 1e-9
# Error of results by modes: so many times their largest change between two densities with a ratio of 1.4, and this
# besides, since modes are left out, and loads jump between knots.
CHANGE_FACTOR, LEAST_ERROR = 3.0, 1e-4
# Least phase [rad] by which drive and mode differ at the end of the run: energies lose its square in digits.
NEAREST_RESONANCE = 1e-4

# A response and coarser ones → largest relative difference of what is observed.
Change = Callable[[Response, Sequence[Response]], float]


@dataclass(frozen=True)
class ReferenceSolution:
    """The accurate response of a scene, by one refinement of a method."""

    kind: Literal["modal", "richardson"]  # method
    response: Response  # Gram matrices of plate and target
    uncertainty: float  # largest relative error of the observed quantities; inf while unknown
    seconds: float  # nominal time of this refinement [s]
    next_seconds: float  # nominal time of the next one [s]
    plate: ModalPlate | None = None  # modes; None for Richardson's method
    density: float = 0.0  # density of their functions

    @cached_property
    def bound(self) -> float:
        """Largest localization factor of any drive."""
        return self.response.bound()

    @cached_property
    def drives(self) -> dict[str, np.ndarray]:
        """Phasors (actuators,) of "single", the best single actuator, and "best", which reaches the bound [N/m²]."""
        return {"single": best_single(self.response), "best": self.response.best_drive()}

    @cached_property
    def localization_factors(self) -> dict[str, float]:
        """Localization factors of these drives."""
        factors = self.response.localization_factors(np.array(list(self.drives.values())))
        return dict(zip(self.drives, factors.tolist(), strict=True))

    def displacement_error(self, times: np.ndarray, scene: Scene, computed: np.ndarray) -> float | None:
        """Return the relative error of (times, ny, nx) displacement under the drive "best"; None without modes."""
        if self.plate is None:
            return None
        return float(displacement_errors(self.plate, self.drives["best"][None], times, scene, computed[None])[0])


Refinement = TypeVar("Refinement", ReferenceSolution, Extrapolation)
Value = TypeVar("Value", float, np.ndarray)


def best_single(response: Response) -> np.ndarray:
    """Return the phasors (actuators,) of the best single actuator."""
    singles = np.eye(response.matrices.shape[1] // 2, dtype=complex)
    best: np.ndarray = singles[int(np.argmax(response.localization_factors(singles)))]
    return best


def usual_drives(response: Response) -> np.ndarray:
    """Return the best single actuator, the best drive and equal drive (3, actuators)."""
    best = response.best_drive()
    return np.array([best_single(response), best, np.ones(best.size)])


class MoreFunctions(NamedTuple):
    """The modes that are taken for a scene, and more functions that their results are compared with."""

    taken: ModalPlate  # modes that are taken
    finer: ModalPlate  # modes by FINER times as many functions along each side
    response: Response  # response by these


def find_reference_solution(
    scene: Scene,
    device: str,
    wanted: float | Callable[[Response], float] = 2 * LEAST_ERROR,
    seconds: float = 60.0,
    phasors: np.ndarray | None = None,
) -> ReferenceSolution:
    """Refine a reference, by modes where they can be, until its uncertainty is as wanted or its time is used up.

    ``wanted`` is an uncertainty, or a function of the response that returns one. It applies to the bound, the usual
    drives and ``phasors`` (drives, actuators). Times are nominal [s].
    """
    if not scene.linear:
        raise SceneError(f"{scene.nonlinear_table}: not linear in the drives; accuracy needs a linear scene")
    observed = np.empty((0, len(scene.actuators))) if phasors is None else phasors
    refinements = _refinements(scene, device, partial(largest_change, observed))
    return refine_until(refinements, lambda last: wanted(last.response) if callable(wanted) else wanted, seconds)


def refine_until(
    refinements: Iterator[Refinement], wanted: Callable[[Refinement], float], seconds: float
) -> Refinement:
    """Return the first refinement within the wanted uncertainty, or the last one within a nominal time [s]."""
    last = next(refinements)
    spent = last.seconds
    while last.uncertainty > wanted(last):
        if math.isfinite(last.uncertainty) and spent + last.next_seconds > seconds:
            break
        following = next(refinements, None)
        if following is None:
            break
        last = following
        spent += last.seconds
    return last


def solve_response(scene: Scene, density: float) -> tuple[ModalPlate, Response]:
    """Return modes by functions of a density, see :func:`solve_modes`, and Gram matrices of plate and target."""
    plate = in_time(solve_modes(scene, highest=density * highest_frequency(scene), density=density))
    frequencies, loss = actuator_frequencies(scene), np.diag(plate.damping)[:, None] / 2
    apart = np.hypot(2 * math.pi * (plate.frequencies[:, None] - frequencies), loss).min()
    if not scene.steady and apart * scene.window.end < NEAREST_RESONANCE:  # mode and drive would cancel
        raise SceneError(f"drive.frequency = {scene.drive.frequency:g}: the undamped plate is driven at resonance")
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    means = Means(plate, regions, None if scene.steady else scene.window)
    return plate, Response(gram_matrices(means, plate.actuator_forces()[None], frequencies[None])[0])


def seconds_of_modes(plate: ModalPlate) -> float:
    """Return the nominal time of a solution with a number of modes [s]."""
    return MODAL_SECONDS * len(plate.vectors) * len(plate.frequencies) ** 2


def largest_change(phasors: np.ndarray, response: Response, others: Sequence[Response]) -> float:
    """Return the largest relative difference from other responses, of the bound and of the localization factors and
    energies of the usual drives and of ``phasors`` (drives, actuators).

    That of a single drive may be small by chance.
    """
    drives = np.concatenate([usual_drives(response), phasors])

    def results(of: Response) -> np.ndarray:
        energy = of.energy(drives)[:, : len(REGIONS)]
        return np.concatenate([[of.bound()], localization_factor(energy), energy.ravel()])

    expected = results(response)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(max(np.nanmax(np.abs(results(other) / expected - 1), initial=0.0) for other in others))


def error_of(change: Value) -> Value:
    """Return the error of results by modes, for their change between two densities with a ratio of 1.4."""
    return CHANGE_FACTOR * change + LEAST_ERROR


def _refinements(scene: Scene, device: str, change: Change) -> Iterator[ReferenceSolution]:
    by_modes = _by_modes(scene, change)
    try:
        yield next(by_modes)
    except SceneError:
        if scene.modal_only_key is not None:
            raise
    else:
        yield from by_modes
        return
    yield from by_richardson(scene, device, change)


def _by_modes(scene: Scene, change: Change) -> Iterator[ReferenceSolution]:
    refuse_many_modes(scene)
    before: list[Response] = []
    for density, following in zip(DENSITIES, (*DENSITIES[1:], math.inf), strict=True):
        try:
            plate, response = solve_response(scene, density)
        except SceneError:
            if before:  # too many functions
                return
            raise
        uncertainty = error_of(change(response, before)) if before else math.inf
        before = [response]
        seconds = seconds_of_modes(plate)
        next_seconds = seconds * (following / density) ** 6  # unknowns and modes grow as the square
        yield ReferenceSolution("modal", response, uncertainty, seconds, next_seconds, plate=plate, density=density)


def by_richardson(scene: Scene, device: str, change: Change) -> Iterator[ReferenceSolution]:
    """Yield references by extrapolation from grids."""

    def differ(matrices: np.ndarray, others: Sequence[np.ndarray]) -> float:
        return change(Response(matrices), [Response(other) for other in others])

    for limit in extrapolate(
        scene,
        plates=count_unit_drives(len(scene.actuators)),
        measure=lambda gridded: measure_response(PlateSolver(gridded, device)).matrices,
        allowed=lambda matrices: np.linalg.eigvalsh(matrices[0]).min() > 0,  # energies are positive
        change=differ,
    ):
        response = Response(limit.values)
        yield ReferenceSolution("richardson", response, limit.uncertainty, limit.seconds, limit.next_seconds)


def displacement_errors(
    plate: ModalPlate, phasors: np.ndarray, times: Sequence[float] | np.ndarray, scene: Scene, computed: np.ndarray
) -> np.ndarray:
    """Return ‖u − u_ref‖ / ‖u_ref‖ (drives,) of (drives, times, ny, nx) displacement; NaN for plates at rest."""
    expected = fields(plate, phasors, np.asarray(times, dtype=float), *node_positions(scene))
    errors, sizes = (np.linalg.norm(u.reshape(len(u), -1), axis=1) for u in (computed - expected, expected))
    return np.asarray(errors / np.where(sizes > 0, sizes, math.nan))
