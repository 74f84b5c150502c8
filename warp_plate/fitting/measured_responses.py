"""Frequency responses that were measured: from text tables, arrays, universal files, and time signals.

With spectral densities S averaged over segments, x the force and y the motion (Bendat, Piersol, Random Data, ch. 6):

    H1 = S_xy / S_xx        noise in the motion averages out
    H2 = S_yy / S_yx        noise in the force averages out
    Hv = S_xy / |S_xy| · √(S_yy / S_xx)        noise in both, alike in relation to each
    γ² = |S_xy|² / (S_xx S_yy)        coherence: 1 without noise, leakage and nonlinearity
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.fitting.hits import hit_spectra, is_clipped
from warp_plate.fitting.measured_modes import check_file
from warp_plate.fitting.measured_tables import (
    FORCE_UNITS,
    TIME_UNITS,
    Units,
    motion_unit,
    read_number_table,
    read_response_table,
)
from warp_plate.fitting.measured_universal import UNIVERSAL, read_universal, universal_responses
from warp_plate.plate.waveforms import LOUDEST, MOST_SAMPLES, even_step, wav_channels
from warp_plate.result.frequency_response import DERIVATIVES
from warp_plate.result.hdf5 import HDF5, MAT, read_arrays
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, SMALLEST
from warp_plate.scene.fit import Fit, Measurement, TimeSignals

RESPONSES_BYTES, MOST_FREQUENCIES = 2**27, 4000
MOST_COHERENCE = 1 + 1e-6  # of numbers that were rounded
# Names in MAT and HDF5 files.
ARRAYS = "frequency", "response", "real", "imaginary", "coherence"
OF_RESPONSES = "frequency", "imaginary", "phase", "coherence"  # kinds of columns that time signals do not have
# (1 + responses, n) frequencies and responses, (responses, n) coherences, and units that the file names.
Columns = tuple[np.ndarray, np.ndarray | None, Units]


@dataclass(frozen=True, eq=False)
class MeasuredResponses:
    """Frequency responses of a panel, in the order of ``[[measurement]]``."""

    source: str  # files that they come from
    frequencies: np.ndarray  # (n,) [Hz], rising, above 0
    responses: np.ndarray  # (measurements, n) complex responses, for motion that varies as exp(iωt)
    # (measurements, n) coherence γ², NaN for responses without; None if there is none at all
    coherence: np.ndarray | None = None
    remarks: tuple[str, ...] = ()  # what was converted
    decay: float = 0.0  # [1/s] responses are those at s = iω + decay, by an exponential window
    clipped: tuple[str, ...] = ()  # channels of time signals that an overload cut off


@np.errstate(all="ignore")  # of numbers that are refused in the end
def read_responses(
    paths: Path | Sequence[Path], count: int, fit: Fit | None = None, rows: Sequence[Measurement] | None = None
) -> MeasuredResponses:
    """Return ``count`` responses of files with as many each, in the range of ``fit``; a line at 0 Hz is left out.

    A text table has the columns frequency, real and imaginary part of the first response, those of the second and so
    on, or columns that its headings name so, or as magnitude and phase. A universal file (.uff, .unv, .ufb) has a
    dataset 58 for each response. MAT files (.mat) and HDF5 files (.h5, .hdf5, .nc) have the arrays ``frequency`` and
    ``response``, or ``real`` and ``imaginary``, and maybe ``coherence``. WAV files have time signals, and so have text
    tables where there is ``fit.signals``. Units that a file names are converted to hertz and SI units, and, with the
    tables ``[[measurement]]`` as ``rows``, to their quantities; datasets between nodes with places are chosen by their
    points.

    Raises:
        SceneError: A file cannot be read, or holds no such responses.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    if not paths or count % len(paths):
        raise SceneError(f"{len(paths)} files of data for {count} tables [[measurement]]; each file holds as many")
    each = count // len(paths)
    parts = [
        _read(path, each, fit, rows and rows[index * each : (index + 1) * each]) for index, path in enumerate(paths)
    ]
    for path, (columns, *_) in zip(paths, parts, strict=True):
        if not np.array_equal(columns[0], parts[0][0][0], equal_nan=True):
            raise SceneError(f"{path}: is at other frequencies than {paths[0]}")
    source = ", ".join(map(str, paths))
    frequencies, responses = parts[0][0][0].real, np.vstack([columns[1:] for columns, *_ in parts])
    coherence = np.vstack([np.full(columns[1:].shape, np.nan) if of is None else of for columns, of, *_ in parts])
    selected = _selected(frequencies, fit)
    frequencies, responses, coherence = frequencies[selected], responses[:, selected], coherence[:, selected]
    units = [unit for _, _, units, _ in parts for unit in units]
    window = fit and (fit.signals.exponential if fit.signals else fit.exponential)
    decay = 1 / window if window else 0.0
    responses, remarks = _in_quantities(frequencies - 0.5j * decay / np.pi, responses, units, rows)
    _check(source, frequencies, responses)
    known = None if np.isnan(coherence).all() else coherence
    clipped = tuple(f"{path.name}, {name}" for path, (*_, names) in zip(paths, parts, strict=True) for name in names)
    return MeasuredResponses(source, frequencies, responses, known, remarks, decay, clipped)


def _selected(frequencies: np.ndarray, fit: Fit | None) -> np.ndarray:
    """Return (n,) whether frequencies are not 0 and within the range of ``fit``."""
    low, high = fit.range if fit and fit.range else (-np.inf, np.inf)
    return (frequencies != 0) & ~((frequencies < low) | (frequencies > high))


def _in_quantities(
    frequencies: np.ndarray, responses: np.ndarray, units: Units, rows: Sequence[Measurement] | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return responses in SI units and in the quantities of the rows, and lines that say which were converted."""
    responses, remarks = responses.copy(), []
    for index, unit in enumerate(units):
        order, factor = unit or (None, 1.0)
        wanted = order if rows is None else DERIVATIVES[rows[index].quantity]
        if order is not None and wanted is not None and order != wanted:
            with np.errstate(divide="ignore", invalid="ignore"):
                responses[index] *= (2j * np.pi * frequencies) ** (wanted - order)
            names = [name for power in (order, wanted) for name, of in DERIVATIVES.items() if of == power]
            remarks.append(f"measurement[{index}]: the file has its {names[0]}, which is converted to {names[1]}")
        responses[index] *= factor
    return responses, tuple(remarks)


def _read(
    path: Path, count: int, fit: Fit | None, rows: Sequence[Measurement] | None
) -> tuple[np.ndarray, np.ndarray | None, Units, list[str]]:
    """Return the first ``count`` responses of a file, see ``Columns``, and the channels that are clipped."""
    ending, signals, clipped = path.suffix.lower(), fit.signals if fit else None, []
    try:
        check_file(path, RESPONSES_BYTES)
        if ending in UNIVERSAL:
            columns, coherence, units = universal_responses(read_universal(path), count, rows, fit)
        elif ending in (*MAT, *HDF5):
            columns, coherence, units = *_arrays(path), []
        elif ending == ".wav" or signals is not None:
            values, rate, named = read_signals(path, signals)
            columns, coherence, units = estimate_responses(values, rate, fit, named)
            if not (signals and signals.hits):  # of which those that are clipped are left out
                clipped = [f"channel {number}" for number, row in enumerate(values, 1) if is_clipped(row)]
        else:
            columns, coherence, units = read_response_table(path.read_bytes())
        if coherence is not None and (np.abs(coherence - 0.5) > MOST_COHERENCE - 0.5).any():
            raise ValueError("coherence must be from 0 to 1")
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    table = ending not in (*UNIVERSAL, *MAT, *HDF5, ".wav") and signals is None  # with columns that are skipped
    if len(columns) <= count or (not table and len(columns) > 1 + count):
        raise SceneError(
            f"{path}: has {len(columns) - 1} responses; the scene has {count} tables [[measurement]] for it"
        )
    units = units[:count] or [None] * count
    return columns[: 1 + count], None if coherence is None else coherence[:count], units, clipped


def _check_count(source: str, count: int) -> None:
    if not 2 <= count <= MOST_FREQUENCIES:
        most = f"2 to {MOST_FREQUENCIES} can be fitted"
        raise SceneError(f"{source}: {count} frequencies; {most}, and fit.range = [LOW, HIGH] chooses")


def _check(source: str, frequencies: np.ndarray, responses: np.ndarray) -> None:
    """Raise a SceneError unless the frequencies rise and all responses are numbers other than 0."""
    _check_count(source, len(frequencies))
    if not (frequencies[0] > SMALLEST and np.all(np.diff(frequencies) > 0) and frequencies[-1] < LARGEST):
        raise SceneError(f"{source}: frequencies must rise, from 0 hertz or above, and stay below {LARGEST:g}")
    sizes = np.abs(responses)
    for row, column in np.argwhere(~((sizes > SMALLEST) & (sizes < LARGEST)))[:1].tolist():
        value, where = responses[row, column], f"response {row + 1} at {frequencies[column]:g} Hz"
        rule = f"must be a complex number other than 0, of a size from {SMALLEST:g} to {LARGEST:g}"
        raise SceneError(f"{source}: {where} is {value:g}; {rule}")


def _arrays(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the responses of a MAT or HDF5 file."""
    arrays = read_arrays(path, ARRAYS)
    if "frequency" not in arrays or not ("response" in arrays or {"real", "imaginary"} <= set(arrays)):
        raise ValueError(f"needs the arrays frequency, and response or real and imaginary; has {', '.join(arrays)}")
    frequencies = arrays["frequency"].ravel()
    shaped = {name: _along(name, values, len(frequencies)) for name, values in arrays.items() if name != "frequency"}
    if len({values.shape for values in shaped.values()}) > 1:
        raise ValueError(f"the arrays {', '.join(shaped)} have different numbers of responses")
    responses = shaped["response"] if "response" in shaped else shaped["real"] + 1j * shaped["imaginary"]
    return np.vstack([frequencies, responses]), shaped.get("coherence")


def _along(name: str, values: np.ndarray, count: int) -> np.ndarray:
    """Return (responses, count) values, the axis of whose length is moved to the end."""
    axes = [axis for axis, length in enumerate(values.shape) if length == count]
    if len(axes) != 1:
        raise ValueError(
            f"{name} has shape {values.shape}; one axis, and no other, must be as long as frequency, {count}"
        )
    return np.moveaxis(values, axes[0], -1).reshape(values.size // max(count, 1), count)


def read_signals(path: Path, signals: TimeSignals | None = None) -> tuple[np.ndarray, float, tuple[str, ...]]:
    """Return (channels, samples) values, samples per second and units of the channels of a WAV file or a text table.

    A table has the times in its first column, unless ``signals`` has their rate.
    """
    stated = signals.rate if signals else None
    if path.suffix.lower() == ".wav":
        if stated is not None:
            raise ValueError("a WAV file states its rate; delete fit.signals.rate")
        values, rate = wav_channels(path.read_bytes())
        units: tuple[str, ...] = ()
    else:
        table = read_number_table(path.read_bytes())
        of, names = table.values, table.headings
        if len(of) < 2 or of.shape[1] < (3 if stated is None else 2):
            raise ValueError("needs the columns time, and a signal in each of at least two others")
        for name in names:
            if name.kind in OF_RESPONSES and (name.unit.lower() not in FORCE_UNITS or name.kind != "frequency"):
                rule = "has a column of responses; delete [fit.signals], which is for signals in time"
                raise ValueError(f"column {name.text[:60]!r}: {rule}")
        if stated is not None and names and names[0].kind == "time":
            raise ValueError("has a column of times; delete fit.signals.rate")
        first = 1 if stated is None else 0
        second = names[0].factor("time", TIME_UNITS) if names and first else 1.0
        values, rate = of[:, first:].T, stated or 1 / (second * even_step(of[:, 0]))
        units = tuple(name.unit for name in names[first:])
    if values.size > MOST_SAMPLES:
        raise ValueError(f"{values.size} samples; at most {MOST_SAMPLES} are read")
    if len(values) < 2 or not np.abs(values).max(initial=0) <= LOUDEST or not rate > 0:
        raise ValueError(f"needs a channel with the force and one or more with a motion, numbers up to {LOUDEST:g}")
    return values, rate, units


def estimate_responses(values: np.ndarray, rate: float, fit: Fit | None = None, named: Sequence[str] = ()) -> Columns:
    """Return responses estimated from signals (channels, samples) in the units ``named``; their coherence is None of a
    single segment."""
    from scipy.signal import csd, welch

    table = fit.signals if fit and fit.signals else TimeSignals()
    samples, length = values.shape[1], round(min(table.segment * rate, 1e18))
    if not 2 <= length <= samples:
        given = f"{samples / rate:g} s at {rate:g} samples a second"
        raise ValueError(f"holds {given}; fit.signals.segment = {table.segment:g} s must have 2 to {samples} samples")
    if table.force_channel > len(values):
        raise ValueError(f"has {len(values)} channels; fit.signals.force_channel = {table.force_channel}")
    selected = _selected(np.fft.rfftfreq(length, 1 / rate), fit)
    _check_count(f"fit.signals.segment = {table.segment:g} s", int(selected.sum()))
    overlap = length // 2 if table.window == "hann" else 0
    several = samples >= 2 * length - overlap
    options = {"fs": rate, "window": table.window, "nperseg": length, "noverlap": overlap}
    force = values[table.force_channel - 1] / table.force_gain
    motion = np.delete(values, table.force_channel - 1, axis=0)
    if table.hits:
        frequencies, of_force, of_motion, crossed, count = hit_spectra(force, motion, rate, table)
        several = count > 1
    else:
        frequencies, of_force = welch(force, **options)
        of_motion, crossed = welch(motion, **options)[1], csd(force, motion, **options)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        responses = {
            "H1": crossed / of_force,
            "H2": of_motion / crossed.conj(),
            "Hv": crossed / np.abs(crossed) * np.sqrt(of_motion / of_force),
        }[table.estimator]
        coherence = np.abs(crossed) ** 2 / (of_force * of_motion)
    motions = list(map(motion_unit, named)) if named else [None] * len(values)
    per = FORCE_UNITS.get(named[table.force_channel - 1].lower(), 1.0) if named else 1.0
    del motions[table.force_channel - 1]
    units: Units = [None if unit is None else (unit[0], unit[1] / per) for unit in motions]
    return np.vstack([frequencies, responses]), np.minimum(coherence, 1.0) if several else None, units
