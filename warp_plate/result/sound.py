"""Sound radiated by a plate under a drive, and its files: CSV and HDF5."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.quantities.sound_levels import POWER_REFERENCE, PRESSURE_REFERENCE, a_weighting
from warp_plate.result import hdf5
from warp_plate.result.atomic_io import write_table
from warp_plate.result.frequency_response import UNDAMPED

FORMAT = hdf5.FileFormat("sound", 1)


@dataclass(frozen=True, eq=False)
class Sound:
    """Steady sound of a plate, whose actuators all drive it at the same frequency.

    Attributes:
        title: Title of the scene, or its name.
        frequencies: (frequencies,) [Hz], rising; that of the scene's drive is among them.
        power: (frequencies,) mean radiated sound power [W].
        efficiency: (frequencies,) radiation efficiency: the power over that of a piston of the plate's area and mean
            square velocity in a wide tube; NaN where nothing moves.
        localization_factor: (frequencies,) localization factor of the drive.
        points: (points, 3) x, y, and z above the plate [m].
        pressures: (points, frequencies) complex pressures [Pa].
        natural_frequencies: (modes,) natural frequencies between the first and the last of ``frequencies`` [Hz].
        loss_factors: (modes,) loss factors of these modes.
        drive_frequency: Frequency of the scene's drive [Hz].
        angles: (angles,) angles from the normal of the plate [°], −90 to 90.
        directivity: (2, angles) level far away at the frequency of the drive [dB], relative to the largest of both, in
            the planes through the normal along x and along y.
        baffle: True for one side of a plate in a rigid baffle, False for both sides of one without.
    """

    title: str
    frequencies: np.ndarray
    power: np.ndarray
    efficiency: np.ndarray
    localization_factor: np.ndarray
    points: np.ndarray
    pressures: np.ndarray
    natural_frequencies: np.ndarray
    loss_factors: np.ndarray
    drive_frequency: float
    angles: np.ndarray
    directivity: np.ndarray
    baffle: bool = True

    def __repr__(self) -> str:
        ends = f"{self.frequencies[0]:g} to {self.frequencies[-1]:g} Hz"
        return f"<Sound {len(self.frequencies)} frequencies from {ends}, {len(self.points)} points>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        return (UNDAMPED,) * bool(np.any(self.loss_factors <= 0))

    @property
    def at_drive(self) -> int:
        """Index of the frequency of the drive."""
        return int(np.abs(self.frequencies - self.drive_frequency).argmin())

    @property
    def power_level(self) -> np.ndarray:
        """(frequencies,) sound power level [dB re 1 pW]."""
        return _decibels(self.power / POWER_REFERENCE)

    @property
    def weighting(self) -> np.ndarray:
        """(frequencies,) A-weighting [dB], to be added to levels."""
        return a_weighting(self.frequencies)

    @property
    def pressure_levels(self) -> np.ndarray:
        """(points, frequencies) sound pressure levels [dB re 20 µPa]."""
        return _decibels(np.abs(self.pressures) ** 2 / 2 / PRESSURE_REFERENCE**2)

    @property
    def labels(self) -> list[str]:
        """Names of the points, such as "0.1,0.1,1"."""
        return [f"{x:g},{y:g},{z:g}" for x, y, z in self.points.tolist()]


def _decibels(ratio: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(ratio))


def write_csv(sound: Sound, path: Path) -> None:
    """Write a row for each frequency [Hz]: power, its level, efficiency, localization factor, pressures by point."""
    heading = ["frequency [Hz]", "sound power [W]", "sound power level [dB re 1 pW]", "A-weighting [dB]"]
    heading += ["radiation efficiency [1]", "localization factor [1]"]
    columns = [sound.frequencies, sound.power, sound.power_level, sound.weighting]
    columns += [sound.efficiency, sound.localization_factor]
    for label, pressure, level in zip(sound.labels, sound.pressures, sound.pressure_levels, strict=True):
        heading += [f"Re p {label} [Pa]", f"Im p {label} [Pa]", f"level {label} [dB re 20 uPa]"]
        columns += [pressure.real, pressure.imag, level]
    write_table(path, heading, [np.column_stack(columns)])


def write_hdf5(sound: Sound, path: Path) -> None:
    """Write a file laid out as netCDF-4 lays out its own, with the dimensions frequency, point, angle and plane."""
    with FORMAT.create(path) as file:

        def write(values: Any, units: str, meaning: str, *axes: str, name: str = "") -> None:
            hdf5.write_along(file, name or meaning.replace(" ", "_"), values, units, meaning, axes)

        file.attrs.update({"title": sound.title, "drive_frequency": sound.drive_frequency})
        write(sound.frequencies, "Hz", "frequency")
        write(sound.labels, "1", "place of a pressure", name="point")
        write(sound.angles, "degree", "angle from the normal", name="angle")
        write(["x", "y"], "1", "plane of the directivity", name="plane")
        write(sound.power, "W", "sound power", "frequency")
        write(sound.efficiency, "1", "radiation efficiency", "frequency")
        write(sound.localization_factor, "1", "localization factor", "frequency")
        write(sound.pressures.real, "Pa", "real part of the pressure", "point", "frequency", name="real")
        write(sound.pressures.imag, "Pa", "imaginary part of the pressure", "point", "frequency", name="imaginary")
        write(sound.directivity, "dB", "directivity", "plane", "angle")


# Writers of the formats, and the endings of their files.
WRITERS: Mapping[str, tuple[str, Callable[[Sound, Path], None]]] = {
    "csv": (".csv", write_csv),
    "hdf5": (".h5", write_hdf5),
}
