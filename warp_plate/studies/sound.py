"""The sound of a linear plate under the scene's drive, over frequencies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_plate.modal.modes import solve_modes
from warp_plate.modal.poles import adaptive_frequencies
from warp_plate.modal.radiation import Air, Radiation, air_of, efficiencies
from warp_plate.modal.unbaffled import Unbaffled, radiation_of
from warp_plate.plate.designs import scene_phasors
from warp_plate.result.sound import Sound
from warp_plate.scene.errors import SceneError, check_type, numbers_of
from warp_plate.scene.fields import SMALLEST
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.studies.frequency_response import check_linear, default_range, resonances_of
from warp_plate.studies.listening import in_baffle, listening_points

# Directions of a plane, and the least level that is told apart from silence [dB].
ANGLES, LEAST_LEVEL = np.linspace(-90.0, 90.0, 181), -60.0


def sound(
    scene: SceneSource,
    points: Sequence[tuple[float, float, float]] = (),
    frequency_range: tuple[float, float] | None = None,
    air: Air | None = None,
    baffle: bool = True,
) -> Sound:
    """Return the steady sound of a plate under the drive of its scene, at frequencies that resolve every resonance.

    Args:
        scene: Linear scene; its grid, window and waveforms are not used, and all actuators have the same frequency.
        points: Points (x, y, z) [m] where the pressure is computed, z above the plate (default: 1 m above the middle of
            each target).
        frequency_range: Lowest and highest frequency [Hz] (default: as of ``frf``).
        air: The medium (default: that of ``[effects.air]``, or air at 20 °C).
        baffle: True for one side of a plate in a rigid baffle, False for both sides of a rectangle without one
            (also where ``[effects.air]`` says so).

    Raises:
        SceneError: The scene is not linear, a point is too near to the plate, the range is invalid, or the plate has
            too many modes, or without a baffle an outline.
    """
    scene = Scene.load(scene)
    check_type("points", points, Sequence, np.ndarray)
    if air is None:
        air = air_of(scene)
    check_type("air", air, Air)
    for key, value in vars(air).items():
        if not numbers_of(f"air.{key}", [value], 1, "a positive number")[0] > SMALLEST:
            raise SceneError(f"air.{key} = {value!r}: must be a positive number")
    baffle = in_baffle(scene, baffle)
    frequency_range = check_linear(scene, frequency_range)
    places = np.array(listening_points(scene, points))
    low, high = frequency_range or default_range(scene)
    drive = scene.drive.frequency
    if not low <= drive <= high:
        raise SceneError(f"frequency_range = {low:g}:{high:g}: must hold the drive's frequency of {drive:g} Hz")
    plate = solve_modes(scene, high, key=f"frequency_range = {low:g}:{high:g}" if frequency_range is not None else None)
    frequencies = np.union1d(adaptive_frequencies(*plate.resonances, low, high), [drive])
    amplitudes = plate.respond_to_drive(frequencies, scene_phasors(scene))
    radiation = radiation_of(plate, high, air, baffle)
    pressures = radiation.pressures(frequencies, amplitudes, places)[:, :, 0].T
    power = radiation.powers(frequencies, amplitudes)
    energies = [_squares(amplitudes[:, :, 0], plate.kinetic_matrix(region)) for region in (scene.target, "plate")]
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = energies[0] / energies[1]
    natural, lost = resonances_of(plate)
    shown = (natural >= low) & (natural <= high)
    at_drive = amplitudes[np.searchsorted(frequencies, drive), :, 0]
    return Sound(
        title=scene.title,
        frequencies=frequencies,
        power=power[:, 0],
        efficiency=efficiencies(plate, air, frequencies, amplitudes, power)[:, 0] / (1 if baffle else 2),
        localization_factor=factor,
        points=places,
        pressures=pressures,
        natural_frequencies=natural[shown],
        loss_factors=lost[shown],
        drive_frequency=drive,
        angles=ANGLES,
        directivity=_directivity(radiation, drive, at_drive),
        baffle=baffle,
    )


def _squares(amplitudes: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return (n,) qᴴ M q of amplitudes (n, modes) and a symmetric matrix."""
    return np.asarray(sum((part * (part @ matrix)).sum(axis=1) for part in (amplitudes.real, amplitudes.imag)))


def _directivity(radiation: Radiation | Unbaffled, frequency: float, amplitudes: np.ndarray) -> np.ndarray:
    """Return (2, angles) levels far away [dB] in the planes along x and along y, at most 0."""
    planes = [
        np.abs(radiation.far_sound(frequency, amplitudes, np.sin(np.radians(ANGLES)), np.full(ANGLES.shape, azimuth)))
        for azimuth in (0.0, np.pi / 2)
    ]
    largest = np.max(planes)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.maximum(np.nan_to_num(20 * np.log10(planes / largest), nan=LEAST_LEVEL), LEAST_LEVEL)
