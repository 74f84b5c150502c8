"""Frequency responses of a plate, between forces and points, and their files: CSV and HDF5."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from warp_plate.quantities.sound_levels import POWER_REFERENCE, PRESSURE_REFERENCE
from warp_plate.result import hdf5
from warp_plate.result.atomic_io import write_table
from warp_plate.scene.fields import SMALLEST

# Quantities of points per force, that of the terminals of coils, and sound: at points, and of the whole plate.
Quantity = Literal[
    "receptance", "mobility", "accelerance", "impedance", "sound_pressure", "sound_power", "radiation_efficiency"
]
IMPEDANCE, SOUND_PRESSURE, SOUND_POWER = "impedance", "sound_pressure", "sound_power"
OF_PLATE = (SOUND_POWER, "radiation_efficiency")
SOUND = (SOUND_PRESSURE, *OF_PLATE)
# Power of iω by which the displacement is multiplied.
DERIVATIVES: Mapping[str, int] = {name: power for power, name in enumerate(get_args(Quantity)[:3])}
UNITS: Mapping[str, str] = {
    "receptance": "m/N",
    "mobility": "(m/s)/N",
    "accelerance": "(m/s²)/N",
    "impedance": "Ω",
    "sound_pressure": "Pa/N",
    "sound_power": "W/N²",
    "radiation_efficiency": "1",
}
# References of levels, powers of magnitudes in them, and their units.
LEVELS: Mapping[str, tuple[float, int, str]] = {
    SOUND_PRESSURE: (math.sqrt(2) * PRESSURE_REFERENCE, 2, "dB re 20 µPa"),
    SOUND_POWER: (POWER_REFERENCE, 1, "dB re 1 pW"),
}
UNDAMPED = "The plate has undamped modes: their peaks have no height; frequencies beside them are shown."
FORMAT = hdf5.FileFormat("frequency response", 2)


@dataclass(frozen=True, eq=False)
class ResponseErrors:
    """Numerical errors of a :class:`FrequencyResponse`: of its frequencies, and of the values of its curves.

    The true curves, drawn over frequencies that are shifted by at most ``frequencies``, lie within the others of those
    computed. Near a sharp resonance the shift matters more.

    Attributes:
        frequencies: (frequencies,) relative shifts of the resonances up to the next one [1].
        responses: (inputs · points, frequencies) absolute errors of the complex responses [``unit``].
        localization_factor: (frequencies,) absolute errors of the localization factor [1].
        bound: (frequencies,) absolute errors of the bound [1].
        mean_square_velocity: (inputs, frequencies) absolute errors of the mean square velocity [(m/s)²/N²].
    """

    frequencies: np.ndarray
    responses: np.ndarray
    localization_factor: np.ndarray
    bound: np.ndarray
    mean_square_velocity: np.ndarray


@dataclass(frozen=True, eq=False)
class CoilResponse:
    """Steady motion of coils under the drive of the scene, all actuators at the same frequency; amplitudes of exp(iωt).

    Attributes:
        names: (coils,) names of the coils.
        voltage: (coils, frequencies) complex voltages at the terminals [V].
        current: (coils, frequencies) complex currents [A].
        stroke: (coils, frequencies) complex displacements of the patches relative to the magnets [m].
        electrical_power: (coils, frequencies) mean power into the terminals [W].
        mechanical_power: (coils, frequencies) mean power of the force Bl i on patch and magnet [W].
    """

    names: tuple[str, ...]
    voltage: np.ndarray
    current: np.ndarray
    stroke: np.ndarray
    electrical_power: np.ndarray
    mechanical_power: np.ndarray


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Steady responses of a plate to unit forces that vary as exp(iωt); or impedances of coils on it.

    Attributes:
        title: Title of the scene, or its name.
        quantity: Quantity at the points per force: displacement, velocity, acceleration or pressure; or voltage of a
            coil per current, the terminals of all others being open; or of the whole plate the sound power under 1 N,
            or the radiation efficiency, both real.
        inputs: (inputs,) names of the actuators, or "X,Y" of points, on which 1 N acts, evenly over a patch; of
            impedances, the coils in which 1 A flows.
        input_places: (inputs, 2) middles of the inputs [m].
        points: (points, 2) x, y of the outputs [m]; of impedances, the middles of the same coils; of pressures
            (points, 3) x, y, and z above the plate; none of quantities of the whole plate.
        frequencies: (frequencies,) [Hz], rising.
        responses: (inputs · points, frequencies) complex responses in ``unit``, the points of the first input first;
            of the whole plate, one for each input.
        localization_factor: (frequencies,) localization factor of the drive of the scene, all actuators at the same
            frequency; NaN where it moves nothing.
        bound: (frequencies,) largest localization factor that any drive of the actuators has.
        mean_square_velocity: (inputs, frequencies) square of the velocity under a force of amplitude 1 N, or a current
            of 1 A, averaged over time and the mass of the plate [``velocity_unit``].
        natural_frequencies: (modes,) natural frequencies of the undamped plate between the first and the last of
            ``frequencies`` [Hz]; with coils, the resonances of plate and coils with open terminals.
        loss_factors: (modes,) loss factors of these modes.
        errors: Numerical errors of the frequencies and of all curves.
        coils: Motion of the coils under the drive of the scene; None without coils.
    """

    title: str
    quantity: Quantity
    inputs: tuple[str, ...]
    input_places: np.ndarray
    points: np.ndarray
    frequencies: np.ndarray
    responses: np.ndarray
    localization_factor: np.ndarray
    bound: np.ndarray
    mean_square_velocity: np.ndarray
    natural_frequencies: np.ndarray
    loss_factors: np.ndarray
    errors: ResponseErrors
    coils: CoilResponse | None = None

    @property
    def unit(self) -> str:
        """Unit of the responses."""
        return UNITS[self.quantity]

    @property
    def velocity_unit(self) -> str:
        """Unit of the mean square velocity."""
        return "(m/s)²/A²" if self.quantity == IMPEDANCE else "(m/s)²/N²"

    @property
    def of_plate(self) -> bool:
        """True for quantities of the whole plate, which have no points and no phase."""
        return self.quantity in OF_PLATE

    @property
    def level_unit(self) -> str:
        """Unit of :meth:`level`, "" for quantities that have none."""
        return LEVELS[self.quantity][2] if self.quantity in LEVELS else ""

    def level(self, magnitudes: np.ndarray) -> np.ndarray:
        """Return the levels [``level_unit``] of magnitudes of pressures (root mean squares) or powers, under 1 N."""
        reference, power, _ = LEVELS[self.quantity]
        return np.asarray(10 * power * np.log10(np.maximum(magnitudes / reference, SMALLEST)))

    @property
    def pairs(self) -> list[tuple[str, tuple[float, ...]]]:
        """Input and point of each response, () for the whole plate."""
        points = [()] if self.of_plate else self.points.tolist()
        return [(name, tuple(point)) for name in self.inputs for point in points]

    @property
    def labels(self) -> list[str]:
        """Names of the pairs, such as "left → 0.1,0.05"; of impedances "left", or "left → right" for a mutual one."""
        if self.quantity == IMPEDANCE:
            return [one if one == other else f"{one} → {other}" for one in self.inputs for other in self.inputs]
        return [" → ".join([name, *[",".join(f"{x:g}" for x in point)] * bool(point)]) for name, point in self.pairs]

    @property
    def distinct(self) -> list[int]:
        """Indices of the pairs, of impedances between two coils only one of the two equal ones."""
        count, points = len(self.inputs), len(self.pairs) // len(self.inputs)
        reciprocal = self.quantity == IMPEDANCE
        return [row * points + column for row in range(count) for column in range(row if reciprocal else 0, points)]

    def __repr__(self) -> str:
        counts = f"{len(self.inputs)} inputs, {len(self.points)} points, {len(self.frequencies)} frequencies"
        return f"<FrequencyResponse {counts} from {self.frequencies[0]:g} to {self.frequencies[-1]:g} Hz>"

    def band(self, curve: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and the largest values that the true curve can have at each frequency; NaN at the ends of
        the range, beyond which a resonance may be shifted. Peaks between two frequencies are up to 1 % higher.

        Args:
            curve: Attribute with errors: "responses" (of which the magnitudes are taken), "localization_factor",
                "bound" or "mean_square_velocity".
        """
        x, shifts = self.frequencies, self.errors.frequencies * self.frequencies
        complex_values, errors = (np.atleast_2d(getattr(source, curve)) for source in (self, self.errors))
        values = np.abs(complex_values)
        at_ends = np.array([[np.interp(x + side * shifts, x, row) for row in complex_values] for side in (-1, 1)])
        # Between two frequencies, responses may be nearer to zero than at both.
        least = np.maximum(values - errors - np.abs(at_ends - complex_values).max(axis=0), 0)
        largest = values + errors
        ends = np.searchsorted(x, x - shifts), np.searchsorted(x, x + shifts, side="right")
        for bounds, extreme in ((least, np.minimum), (largest, np.maximum)):
            between = [_interpolate(x, np.nan_to_num(bounds), x + side * shifts) for side in (-1, 1)]
            inside = [extreme.reduce(bounds[:, low:high], axis=1) for low, high in zip(*ends, strict=True)]
            bounds[:] = extreme.reduce(np.stack([np.transpose(inside), *between]))
            bounds[:, (x - shifts < x[0]) | (x + shifts > x[-1])] = np.nan
        shape = getattr(self, curve).shape
        return least.reshape(shape), largest.reshape(shape)

    @property
    def undamped(self) -> bool:
        """True if a mode in the range has no damping, so that its response has no limit."""
        return bool(np.any(self.loss_factors <= 0))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        return (UNDAMPED,) * self.undamped


def _interpolate(x: np.ndarray, rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return rows (rows, n) over rising x (n,) at other places, by cubics without overshoot (F. N. Fritsch and
    J. Butland, SIAM J. Sci. Stat. Comput. 5, 1984, p. 300): those of SciPy, which takes longer to load."""
    steps = np.diff(x)
    slopes = np.diff(rows) / steps
    before, after, rising = slopes[:, :-1], slopes[:, 1:], slopes[:, :-1] * slopes[:, 1:] > 0
    first, second = 2 * steps[1:] + steps[:-1], steps[1:] + 2 * steps[:-1]
    weighted = first / np.where(rising, before, 1) + second / np.where(rising, after, 1)
    inner = np.where(rising, (first + second) / weighted, 0)
    tangents = np.column_stack([slopes[:, 0], inner, slopes[:, -1]])
    index = np.clip(np.searchsorted(x, at, side="right") - 1, 0, steps.size - 1)
    t, step = (at - x[index]) / steps[index], steps[index]
    rise = rows[:, index + 1] - rows[:, index]
    bent = (1 - t) * step * tangents[:, index] - t * step * tangents[:, index + 1] + (2 * t - 1) * rise
    return np.asarray(rows[:, index] + t * rise + t * (1 - t) * bent)


def write_csv(response: FrequencyResponse, path: Path) -> None:
    """Write a row for each frequency [Hz]: real and imaginary part of each response, and what goes with it."""
    heading = ["frequency [Hz]"]
    for label in response.labels:
        heading += [f"Re {label} [{response.unit}]", f"Im {label} [{response.unit}]"]
    heading += ["localization factor [1]", "bound [1]"]
    heading += [f"mean square velocity, {name} [{response.velocity_unit}]" for name in response.inputs]
    parts = np.stack([response.responses.real, response.responses.imag], axis=1).reshape(-1, len(response.frequencies))
    columns = [response.frequencies, *parts, response.localization_factor, response.bound]
    columns += [*response.mean_square_velocity]
    errors = response.errors
    heading += ["relative error of frequencies [1]", *(f"error {name} [{response.unit}]" for name in response.labels)]
    heading += ["error of localization factor [1]", "error of bound [1]"]
    heading += [f"error of mean square velocity, {name} [{response.velocity_unit}]" for name in response.inputs]
    columns += [errors.frequencies, *errors.responses, errors.localization_factor, errors.bound]
    columns += [*errors.mean_square_velocity]
    if response.coils is not None:
        for index, name in enumerate(response.coils.names):
            current, stroke = response.coils.current[index], response.coils.stroke[index]
            heading += [f"Re current, {name} [A]", f"Im current, {name} [A]", f"electrical power, {name} [W]"]
            heading += [f"Re stroke, {name} [m]", f"Im stroke, {name} [m]"]
            columns += [current.real, current.imag, response.coils.electrical_power[index], stroke.real, stroke.imag]
    write_table(path, heading, [np.column_stack(columns)])


def write_hdf5(response: FrequencyResponse, path: Path) -> None:
    """Write a file laid out as netCDF-4 lays out its own, with the dimensions frequency, pair, input and mode."""
    unit, quantity, names = response.unit.replace("²", "^2"), response.quantity, list(response.inputs)
    squared = response.velocity_unit.replace("²", "^2")
    places = np.array([point for _, point in response.pairs]).T  # none of the whole plate
    modes = np.arange(1, len(response.natural_frequencies) + 1)
    with FORMAT.create(path) as file:

        def write(values: Any, units: str, meaning: str, *axes: str, name: str = "") -> None:
            """Write a variable with the name, or else that of its meaning up to a comma."""
            hdf5.write_along(file, name or meaning.partition(",")[0].replace(" ", "_"), values, units, meaning, axes)

        file.attrs.update({"title": response.title, "quantity": quantity})
        write(response.frequencies, "Hz", "frequency")
        write(response.labels, "1", "input and point of a response", name="pair")
        write(names, "1", "actuator or point on which 1 N acts", name="input")
        write(modes, "1", "number of the mode in the range", name="mode")
        write([name for name, _ in response.pairs], "1", "input", "pair", name="pair_input")
        for axis, values in zip("xyz", places, strict=False):
            write(values, "m", f"{axis} of the point", "pair", name=f"pair_{axis}")
        write(response.responses.real, unit, f"real part of the {quantity}", "pair", "frequency", name="real")
        write(response.responses.imag, unit, f"imaginary part of the {quantity}", "pair", "frequency", name="imaginary")
        factor, meaning = response.localization_factor, "localization factor of the drive"
        write(factor, "1", meaning, "frequency", name="localization_factor")
        write(response.bound, "1", "bound on the localization factor", "frequency", name="bound")
        write(response.mean_square_velocity, squared, "mean square velocity", "input", "frequency")
        errors, pair = response.errors, ("pair", "frequency")
        write(errors.frequencies, "1", "relative error of frequencies", "frequency", name="frequency_error")
        write(errors.responses, unit, f"error of the complex {quantity}", *pair, name="response_error")
        meaning = "error of the localization factor"
        write(errors.localization_factor, "1", meaning, "frequency", name="localization_factor_error")
        write(errors.bound, "1", "error of the bound", "frequency", name="bound_error")
        meaning, name = "error of the mean square velocity", "mean_square_velocity_error"
        write(errors.mean_square_velocity, squared, meaning, "input", "frequency", name=name)
        write(response.natural_frequencies, "Hz", "natural frequency, undamped", "mode")
        write(response.loss_factors, "1", "loss factor", "mode")


# Writers of the formats, and the endings of their files.
WRITERS: Mapping[str, tuple[str, Callable[[FrequencyResponse, Path], None]]] = {
    "csv": (".csv", write_csv),
    "hdf5": (".h5", write_hdf5),
}
