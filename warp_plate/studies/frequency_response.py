"""Frequency responses between actuators or points and points, with localization factor and mean square velocity.

Each frequency is computed separately, from the modal amplitudes q (:mod:`warp_plate.modal.poles`). With T and P the
kinetic matrices of the target and of the plate, the mean kinetic energies over a period are ω² qᴴTq/4 and ω² qᴴPq/4.
With q of a unit pressure on each actuator in the columns of Q, drives z have the localization factor
zᴴQᴴTQz / zᴴQᴴPQz, and the largest eigenvalue of that pair bounds it. Near a sharp resonance all columns of Q are nearly
parallel, so the matrices are formed with Q's left singular vectors.

Errors come from a second solution with fewer functions. Near a sharp resonance a shift of the peak by its width changes
all of the response. So shifts of frequencies and errors of values are told apart: the second solution is evaluated at
frequencies mapped so that its natural frequencies meet those of the first.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.modal.other_solutions import coarser_modes
from warp_plate.modal.poles import adaptive_frequencies, as_sparse, multiply_modes
from warp_plate.modal.spaces.space import Matrix
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.quantities.region_quantities import mean_square
from warp_plate.result.frequency_response import (
    DERIVATIVES,
    IMPEDANCE,
    SOUND,
    UNITS,
    CoilResponse,
    FrequencyResponse,
    Quantity,
    ResponseErrors,
)
from warp_plate.scene.errors import SceneError, check_type, numbers_of
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.scene.target import Target
from warp_plate.studies.listening import Observer, Point, in_baffle, listening_points, observe_sound, target_middles

# Modes that the default range reaches at least.
MODES_SHOWN = 6
# Number of amplitudes in memory: frequencies · modes · loads.
AMPLITUDES_AT_ONCE = 2**22
# Bytes of a response at a frequency, with its error.
RESPONSE_BYTES = 60.0
# Combinations of actuators with a smaller part of the largest amplitude cancel out.
RANK_TOLERANCE = 1e-12
# Functions along each side of the second solution, relative to the first. An error is FACTOR times the change between
# them (3.3 times it where they converge as the first power of the spacing, as where rigidity jumps), and besides these
# parts of a frequency and of a value. A change is the largest of AROUND neighbouring frequencies, and of motions of
# points BESIDE by so many intervals of the splines too: it may cross zero.
COARSER, FACTOR, LEAST_SHIFT, AROUND = 1 / 1.3, 4.0, 1e-6, 25
BESIDE = 0.25 * np.array([(0, 0), (1, 1), (-1, 1), (-1, -1), (1, -1), (2, 0), (0, 2), (-2, 0), (0, -2)])
# Of responses at points, and of means over regions.
LEAST_ERRORS = (2e-3, 5e-4, 5e-4, 5e-4)


def frf(
    scene: SceneSource,
    inputs: Sequence[str | Point] = (),
    points: Sequence[tuple[float, ...]] = (),
    frequency_range: tuple[float, float] | None = None,
    quantity: Quantity = "mobility",
    baffle: bool = True,
) -> FrequencyResponse:
    """Return the steady responses of points to unit forces, the impedances of coils, or the sound of unit forces.

    They are those at frequencies that resolve every resonance.

    Args:
        scene: Linear scene; its grid, window and waveforms are not used.
        inputs: Names of actuators, over which 1 N is spread evenly, and points (x, y) [m] at which 1 N acts (default:
            all actuators); of impedances, names of coils (default: all coils).
        points: Points (x, y) [m] that respond (default: ``record.points``, or the middles of the targets); of pressures
            (x, y, z), z above the plate (default: 1 m above the middles of the targets); none of impedances, of sound
            power and of radiation efficiency.
        frequency_range: Lowest and highest frequency [Hz] (default: from half the lowest natural frequency, or half the
            frequency of the drive if that is lower, to twice the latter, and at least to the sixth mode).
        quantity: Quantity that responds.
        baffle: As of :func:`warp_plate.studies.sound.sound`.

    Raises:
        SceneError: The scene is not linear, an actuator is unknown, a point is off the plate or too near to it, or the
            range is invalid.
    """
    scene = Scene.load(scene)
    check_type("inputs", inputs, Sequence, np.ndarray)
    check_type("points", points, Sequence, np.ndarray)
    if isinstance(points, str | bytes) or (isinstance(points, np.ndarray) and points.ndim == 0):
        raise SceneError(f"points: must be a list of points (x, y), not {points!r}")
    if quantity not in UNITS:
        raise SceneError(f"quantity = {quantity!r}: must be one of {', '.join(UNITS)}")
    if not baffle and quantity not in SOUND:
        raise SceneError(f"quantity = {quantity}: only sound is that of plates without a baffle: {', '.join(SOUND)}")
    if quantity == IMPEDANCE:
        inputs, points = _terminals(scene, inputs, points)
    inputs = inputs if len(inputs) else [actuator.name for actuator in scene.actuators]
    frequency_range = check_linear(scene, frequency_range)
    if quantity in SOUND:
        points, baffle = listening_points(scene, points, quantity), in_baffle(scene, baffle)
    elif quantity != IMPEDANCE:  # a coil may stand around a hole
        points = points if len(points) else scene.record.points or target_middles(scene)
        _check_on_plate(scene, "points", points)
    _check_on_plate(scene, "inputs", inputs)
    low, high = frequency_range or default_range(scene)
    plate = solve_modes(scene, high, key=f"frequency_range = {low:g}:{high:g}" if frequency_range is not None else None)
    places, forces = input_forces(plate, inputs)
    frequencies, (natural, lost) = adaptive_frequencies(*plate.resonances, low, high), resonances_of(plate)
    if plate.coils is not None:
        if low <= scene.drive.frequency <= high:
            frequencies = np.union1d(frequencies, [scene.drive.frequency])
        natural, widths = plate.coils.resonances(opened=True)
        lost = 2 * widths / natural
    terminals = inputs if quantity == IMPEDANCE else ()

    count, moving = len(inputs) * len(points), quantity not in (*SOUND, IMPEDANCE)
    places_observed = _with_places_beside(plate, points) if moving else points
    what = f"points: {count} responses at {frequencies.size} frequencies"
    refuse_beyond_memory(RESPONSE_BYTES * len(inputs) * len(places_observed) * frequencies.size, what)

    def observer(plate: ModalPlate, highest: float) -> Observer:
        if quantity in SOUND:
            return observe_sound(plate, highest, quantity, points, baffle)
        return _motion(plate, places_observed)

    responses, factor, bound, velocity = curves = _responses(
        plate, frequencies, forces, observer(plate, high), terminals
    )
    shifts, of_responses, *of_others = _errors(plate, frequencies, inputs, observer, curves, terminals)
    if moving:
        beside = (count, len(BESIDE), frequencies.size)
        responses, of_responses = responses.reshape(beside)[:, 0], of_responses.reshape(beside).max(axis=1)
    derivative = (2j * np.pi * frequencies) ** DERIVATIVES.get(quantity, 0)
    shown = (natural >= low) & (natural <= high)
    return FrequencyResponse(
        title=scene.title,
        quantity=quantity,
        inputs=tuple(name if isinstance(name, str) else f"{name[0]:g},{name[1]:g}" for name in inputs),
        input_places=places,
        points=np.array(points, dtype=float).reshape(len(points), -1) if len(points) else np.zeros((0, 2)),
        frequencies=frequencies,
        responses=derivative * responses,
        localization_factor=factor,
        bound=bound,
        mean_square_velocity=velocity,
        natural_frequencies=natural[shown],
        loss_factors=lost[shown],
        errors=ResponseErrors(shifts, np.abs(derivative) * of_responses, *of_others),
        coils=_coil_response(plate, frequencies),
    )


def _terminals(scene: Scene, inputs: Sequence[str | Point], points: Sequence[Any]) -> tuple[list[str], Sequence[Any]]:
    """Return the names of coils (default: all) and their middles [m]; SceneError: an input is none, or there are
    points."""
    middles = {scene.actuators[index].name: scene.actuators[index].middle for index in scene.coil_indices}
    if not middles:
        raise SceneError(f'quantity = "{IMPEDANCE}": no actuator is a coil; write kind = "coil" for one of them')
    if len(points):
        raise SceneError(f"points = {points[0]}: the {IMPEDANCE} is that of terminals of coils; leave out points")
    names = [str(name) for name in inputs] or list(middles)
    for name in names:
        if name not in middles:
            raise SceneError(f"inputs = {name}: is no coil; there are {', '.join(middles)}")
    return names, [middles[name] for name in names]


def _coil_response(plate: ModalPlate, frequencies: np.ndarray) -> CoilResponse | None:
    """Return the motion of the coils under the scene's drive; None without coils."""
    if plate.coils is None:
        return None
    phasors = scene_phasors(plate.scene)
    amplitudes = plate.respond_to_drive(frequencies, phasors)
    motion = plate.coils.motion(2 * np.pi * frequencies, amplitudes, phasors[:, None])
    keys = ("voltage", "current", "stroke", "electrical_power", "mechanical_power")
    return CoilResponse(plate.coils.names, *(getattr(motion, key)[:, :, 0].T for key in keys))


def _errors(
    plate: ModalPlate,
    frequencies: np.ndarray,
    inputs: Sequence[str | Point],
    observer: Callable[[ModalPlate, float], Observer],
    curves: Sequence[np.ndarray],
    terminals: Sequence[str | Point],
) -> list[np.ndarray]:
    """Return the attributes of :class:`ResponseErrors`, those of receptances first."""
    coarser = coarser_modes(plate, COARSER)
    count = min(plate.frequencies.size, coarser.frequencies.size)
    natural, mapped = plate.frequencies[:count], coarser.frequencies[:count]
    elastic = (natural > 0) & (mapped > 0)
    natural, mapped = np.append(0.0, natural[elastic]), np.append(0.0, mapped[elastic])
    shifts = FACTOR * np.maximum.accumulate(np.abs(mapped[1:] / natural[1:] - 1)) + LEAST_SHIFT
    next_mode = np.minimum(np.searchsorted(natural[1:], frequencies), shifts.size - 1)
    moved = np.interp(frequencies, natural, mapped)
    observed = observer(coarser, float(moved.max()))
    others = _responses(coarser, moved, input_forces(coarser, inputs)[1], observed, terminals)
    errors = [
        _largest_around(FACTOR * np.abs(other - curve) + least * np.abs(curve))
        for curve, other, least in zip(curves, others, LEAST_ERRORS, strict=True)
    ]
    return [shifts[next_mode], *errors]


def _largest_around(rows: np.ndarray) -> np.ndarray:
    """Return the largest of the AROUND values about each one along the last axis."""
    ends = [(0, 0)] * (rows.ndim - 1) + [(AROUND // 2, AROUND // 2)]
    around = np.lib.stride_tricks.sliding_window_view(np.pad(rows, ends, "edge"), AROUND, axis=-1)
    return np.asarray(np.fmax.reduce(around, axis=-1))


def respond_to_drive(scene: Scene, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (n,) mean square velocity [m²/s²] and localization factor under the scene's drive, and the bound."""
    check_linear(scene, None)
    plate = solve_modes(scene, frequencies.max(), key=f"highest frequency {frequencies.max():g}")
    forces = plate.actuator_forces() @ scene_phasors(scene)[:, None]
    _, factor, bound, velocity = _responses(plate, frequencies, forces, _motion(plate, np.zeros((0, 2))))
    if plate.coils is not None:  # whose forces depend on the frequency
        driven = plate.respond_to_drive(frequencies, scene_phasors(scene))
        velocity = _mean_square_velocity(plate, frequencies, driven, _plate_mass(plate)).T
    return velocity[0], factor, bound


def resonances_of(plate: ModalPlate) -> tuple[np.ndarray, np.ndarray]:
    """Return the natural frequencies [Hz] and loss factors of a plate, or those of its resonances in air."""
    if plate.air is None:
        return plate.frequencies, plate.loss_factors
    frequencies, widths = plate.air.resonances
    return frequencies, 2 * widths / np.where(frequencies > 0, frequencies, np.inf)


def default_range(scene: Scene) -> tuple[float, float]:
    """Return the lowest and the highest frequency [Hz] that are shown unless others are asked for."""
    drive = scene.drive.frequency
    natural = solve_modes(scene, drive, count=MODES_SHOWN).frequencies
    natural = natural[natural > 0][:MODES_SHOWN]
    return float(0.5 * min(natural[0], drive)), float(max(2 * drive, 1.05 * natural[-1]))


def _check_on_plate(scene: Scene, argument: str, places: Sequence[Any]) -> None:
    """Raise a SceneError, which names the argument, unless all places but names are points on the plate."""
    width, height = scene.plate.size
    for place in (place for place in places if not isinstance(place, str)):
        try:
            x, y = map(float, place)
        except (TypeError, ValueError, OverflowError):
            raise SceneError(f"{argument}: must be a list of points (x, y), not of {place!r}") from None
        if not (0 <= x <= width and 0 <= y <= height):
            raise SceneError(f"{argument} = {x:g},{y:g}: is off the plate of {width:g} × {height:g} m")
        if scene.outline is not None and not scene.outline.contains([(x, y)]).all():
            raise SceneError(
                f"{argument} = {x:g},{y:g}: is off the plate; name a point inside the outline, not in a hole"
            )


def check_linear(scene: Scene, frequency_range: Iterable[float] | None) -> tuple[float, float] | None:
    """Return the range [Hz], None if none is given; raise a SceneError unless it is valid and the scene is linear."""
    if scene.nonlinear_table is not None:
        raise SceneError(f"{scene.nonlinear_table}: frequency responses are those of a linear plate without it")
    if frequency_range is None:
        return None
    what = "two positive frequencies in hertz, the lower one first"
    low, high = numbers_of("frequency_range", frequency_range, 2, what)
    if not 0 < low < high < np.inf:
        raise SceneError(f"frequency_range = {low:g}:{high:g}: must be {what}")
    return low, high


def input_forces(plate: ModalPlate, inputs: Sequence[str | Point]) -> tuple[np.ndarray, np.ndarray]:
    """Return (inputs, 2) middles [m] and (modes, inputs) modal forces [1/√kg] of 1 N on actuators or at points."""
    patches = {actuator.name: actuator for actuator in plate.scene.actuators}
    places, columns = [], []
    if any(isinstance(name, str) and name in patches and patches[name].kind == "piezo" for name in inputs):
        raise SceneError("inputs: piezo patches take volts; name points x,y that a force of 1 N acts on")
    for name in inputs:
        if not isinstance(name, str):
            places.append(name)
            columns.append(plate.at_points([name])[:, 0])
            continue
        if name not in patches:
            raise SceneError(f"inputs = {name}: is neither a point nor an actuator; there are {', '.join(patches)}")
        places.append(patches[name].middle)
        columns.append(plate.region_forces([patches[name]])[:, 0] / patches[name].patch_area)
    return np.array(places, dtype=float), np.stack(columns, axis=1)


def _responses(
    plate: ModalPlate,
    frequencies: np.ndarray,
    forces: np.ndarray,
    observer: Observer,
    terminals: Sequence[str | Point] = (),
) -> tuple[np.ndarray, ...]:
    """Return what is observed (inputs · points, n) under forces (modes, inputs), and the last attributes of
    :class:`FrequencyResponse`, block by block; or impedances of the coils named ``terminals``."""
    scene, inputs = plate.scene, forces.shape[1]
    loads = np.column_stack([forces, plate.actuator_forces()])
    of_plate, of_target = _plate_mass(plate), _moved_by(plate, scene.target)
    drive, blocks = scene_phasors(scene), []
    for chosen in np.array_split(frequencies, -(-len(frequencies) * loads.size // AMPLITUDES_AT_ONCE)):
        amplitudes = plate.respond(chosen, loads)
        unit, driven = amplitudes[:, :, :inputs], amplitudes[:, :, inputs:]
        if plate.coils is not None:
            driven = driven * plate.coils.gains(2 * np.pi * chosen[:, None])[:, None, :]
        if terminals and plate.coils is not None:
            impedances, unit = plate.coils.impedance(2 * np.pi * chosen)
            named = [plate.coils.names.index(str(name)) for name in terminals]
            observed, unit = impedances[:, named][:, :, named].mT.reshape(len(chosen), -1), unit[:, :, named]
        else:
            observed = observer(chosen, unit)
        velocity = _mean_square_velocity(plate, chosen, unit, of_plate)
        blocks.append((observed, *_localization(driven, drive, of_target, of_plate), velocity))
    responses, factor, bound, velocity = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return responses.T, factor, bound, velocity.T


def _motion(plate: ModalPlate, points: Sequence[Any] | np.ndarray) -> Observer:
    """Return the observer of receptances of points (x, y) [m]."""
    shapes = plate.at_points(points)
    return lambda frequencies, amplitudes: (np.moveaxis(amplitudes, 1, 2) @ shapes).reshape(len(frequencies), -1)


def _with_places_beside(plate: ModalPlate, points: Sequence[Any] | np.ndarray) -> np.ndarray:
    """Return each point (x, y) [m] and the places ``BESIDE`` it on the plate, one below the other."""
    places = np.reshape(points, (-1, 1, 2)) + BESIDE * plate.space.interval_sizes
    return np.clip(places, 0, plate.scene.plate.size).reshape(-1, 2)


def _plate_mass(plate: ModalPlate) -> np.ndarray | None:
    """Return the kinetic matrix of the plate; None without masses on springs, where all energy is the plate's."""
    return plate.kinetic_matrix("plate") if plate.galerkin.masses else None


def _mean_square_velocity(
    plate: ModalPlate, frequencies: np.ndarray, amplitudes: np.ndarray, of_plate: np.ndarray | None
) -> np.ndarray:
    """Return the (n, loads) mean square velocity [m²/s²] of amplitudes (n, modes, loads) at frequencies (n,) [Hz]."""
    momentum = amplitudes if of_plate is None else multiply_modes(of_plate, amplitudes)
    squares = np.einsum("fmi,fmi->fi", amplitudes.conj(), momentum).real
    return mean_square((2 * np.pi * frequencies[:, None]) ** 2 * squares / 4, plate.space.plate_mass)


def _moved_by(plate: ModalPlate, target: Target) -> tuple[np.ndarray, np.ndarray | Matrix]:
    """Return the (unknowns, modes) rows of Φ that move a target, and their mass matrix [kg]."""
    matrix = plate.galerkin.region_matrix(target)
    matrix.eliminate_zeros()
    rows = np.flatnonzero(np.diff(matrix.indptr))
    return plate.vectors[rows], as_sparse(matrix[rows][:, rows].toarray())


def _localization(
    driven: np.ndarray,
    drive: np.ndarray,
    of_target: tuple[np.ndarray, np.ndarray | Matrix],
    of_plate: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (n,) localization factors of a drive and bounds of all, from amplitudes (n, modes, actuators) of units."""
    size = np.sqrt(np.einsum("fmi,fmi->fi", driven.conj(), driven).real)
    size = np.where(size > 0, size, 1)
    basis, values, drives = np.linalg.svd(driven / size[:, None], full_matrices=False)
    significant = values > RANK_TOLERANCE * values[:, :1]
    basis *= significant[:, None]
    amplitudes, mass = multiply_modes(of_target[0], basis), of_target[1]
    target = amplitudes.conj().mT @ multiply_modes(mass, amplitudes)
    plate = basis.conj().mT @ (basis if of_plate is None else multiply_modes(of_plate, basis))
    motion = values * (drives @ (size * drive)[:, :, None])[:, :, 0]
    of_drive = (np.einsum("fa,fab,fb->f", motion.conj(), matrix, motion).real for matrix in (target, plate))
    # Directions that cancel out have no energy in the target, and any in the plate.
    lower = np.linalg.cholesky(plate + np.eye(plate.shape[1]) * ~significant[:, None])
    half = np.linalg.solve(lower, target)
    ratio = np.linalg.solve(lower, np.moveaxis(half.conj(), 1, 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.divide(*of_drive)
    return factor, np.linalg.eigvalsh(ratio)[:, -1]
