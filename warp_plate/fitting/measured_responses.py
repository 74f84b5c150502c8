"""Frequency responses that were measured: from tables, arrays, universal files, and time signals.

With spectral densities S averaged over segments, x the force and y the motion (Bendat, Piersol, Random Data, ch. 6):

    H1 = S_xy / S_xx        noise in the motion averages out
    H2 = S_yy / S_yx        noise in the force averages out
    Hv = S_xy / |S_xy| · √(S_yy / S_xx)        noise in both, alike in relation to each
    γ² = |S_xy|² / (S_xx S_yy)        coherence: 1 without noise, leakage and nonlinearity
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.fitting.measured_modes import UNIVERSAL, check_file, universal_responses
from warp_plate.plate.files import read_numbers
from warp_plate.plate.waveforms import LOUDEST, MOST_SAMPLES, even_step, wav_channels
from warp_plate.result.hdf5 import HDF5, MAT, read_arrays
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, SMALLEST
from warp_plate.scene.fit import Fit, TimeSignals

RESPONSES_BYTES, MOST_FREQUENCIES = 2**27, 4000
MOST_COHERENCE = 1 + 1e-6  # of numbers that were rounded
# Names in MAT and HDF5 files.
ARRAYS = "frequency", "response", "real", "imaginary", "coherence"
# (1 + responses, n) frequencies and responses, and (responses, n) coherences.
Columns = tuple[np.ndarray, np.ndarray | None]


@dataclass(frozen=True, eq=False)
class MeasuredResponses:
    """Frequency responses of a panel, in the order of ``[[measurement]]``."""

    source: str  # files that they come from
    frequencies: np.ndarray  # (n,) [Hz], rising, above 0
    responses: np.ndarray  # (measurements, n) complex responses, for motion that varies as exp(iωt)
    # (measurements, n) coherence γ², NaN for responses without; None if there is none at all
    coherence: np.ndarray | None = None


def read_responses(paths: Path | Sequence[Path], count: int, fit: Fit | None = None) -> MeasuredResponses:
    """Return ``count`` responses of files with as many each, in the range of ``fit``; a line at 0 Hz is left out.

    A CSV file has the columns frequency [Hz], real and imaginary part of the first response, those of the second and so
    on; further columns are skipped, and names in the first line do not matter. A universal file (.uff, .unv) has a
    dataset 58 for each response, all at the same frequencies. MAT files (.mat) and HDF5 files (.h5, .hdf5, .nc) have
    the arrays ``frequency`` and ``response``, or ``real`` and ``imaginary``, and maybe ``coherence``. WAV files have
    time signals, and so have CSV files where there is ``fit.signals``.

    Raises:
        SceneError: A file cannot be read, or holds no such responses.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    if not paths or count % len(paths):
        raise SceneError(f"{len(paths)} files of data for {count} tables [[measurement]]; each file holds as many")
    parts = [_read(path, count // len(paths), fit.signals if fit else None) for path in paths]
    for path, (columns, _) in zip(paths, parts, strict=True):
        if not np.array_equal(columns[0], parts[0][0][0], equal_nan=True):
            raise SceneError(f"{path}: is at other frequencies than {paths[0]}")
    source = ", ".join(map(str, paths))
    frequencies, responses = parts[0][0][0].real, np.vstack([columns[1:] for columns, _ in parts])
    coherence = np.vstack([np.full(columns[1:].shape, np.nan) if of is None else of for columns, of in parts])
    low, high = fit.range if fit and fit.range else (-np.inf, np.inf)
    selected = (frequencies != 0) & ~((frequencies < low) | (frequencies > high))
    frequencies, responses, coherence = frequencies[selected], responses[:, selected], coherence[:, selected]
    _check(source, frequencies, responses)
    return MeasuredResponses(source, frequencies, responses, None if np.isnan(coherence).all() else coherence)


def _read(path: Path, count: int, signals: TimeSignals | None) -> Columns:
    """Return the first ``count`` responses of a file."""
    ending = path.suffix.lower()
    try:
        check_file(path, RESPONSES_BYTES)
        if ending in UNIVERSAL:
            columns, coherence = universal_responses(path)
        elif ending in (*MAT, *HDF5):
            columns, coherence = _arrays(path)
        elif ending == ".wav" or signals is not None:
            columns, coherence = estimate_responses(*read_signals(path), signals or TimeSignals())
        else:
            columns, coherence = _csv(path.read_bytes()), None
        if coherence is not None and not np.all(np.isnan(coherence) | (np.abs(coherence) <= MOST_COHERENCE)):
            raise ValueError("coherence must be from 0 to 1")
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    table = ending not in (*UNIVERSAL, *MAT, *HDF5, ".wav") and signals is None  # with columns that are skipped
    if len(columns) <= count or (not table and len(columns) > 1 + count):
        raise SceneError(
            f"{path}: has {len(columns) - 1} responses; the scene has {count} tables [[measurement]] for it"
        )
    return columns[: 1 + count], None if coherence is None else coherence[:count]


def _check(source: str, frequencies: np.ndarray, responses: np.ndarray) -> None:
    """Raise a SceneError unless the frequencies rise and all responses are numbers other than 0."""
    if not 2 <= len(frequencies) <= MOST_FREQUENCIES:
        most = f"2 to {MOST_FREQUENCIES} can be fitted"
        raise SceneError(f"{source}: {len(frequencies)} frequencies; {most}, and fit.range = [LOW, HIGH] chooses")
    if not (frequencies[0] > SMALLEST and np.all(np.diff(frequencies) > 0) and frequencies[-1] < LARGEST):
        raise SceneError(f"{source}: frequencies must rise, from 0 hertz or above, and stay below {LARGEST:g}")
    sizes = np.abs(responses)
    for row, column in np.argwhere(~((sizes > SMALLEST) & (sizes < LARGEST)))[:1].tolist():
        value, where = responses[row, column], f"response {row + 1} at {frequencies[column]:g} Hz"
        rule = f"must be a complex number other than 0, of a size from {SMALLEST:g} to {LARGEST:g}"
        raise SceneError(f"{source}: {where} is {value:g}; {rule}")


def _csv(data: bytes) -> np.ndarray:
    """Return (1 + responses, n) frequencies and responses."""
    named = re.match(rb"(\xef\xbb\xbf)?[\"A-Za-z].*", data)
    table = read_numbers(data[named.end() if named else 0 :])
    if table.size == 0 or table.shape[1] < 3:
        raise ValueError("needs the columns frequency, real and imaginary part of each response")
    pairs = (table.shape[1] - 1) // 2
    return np.vstack([table[:, 0], table[:, 1 : 2 * pairs : 2].T + 1j * table[:, 2 : 2 * pairs + 1 : 2].T])


def _arrays(path: Path) -> Columns:
    """Return the responses of a MAT or HDF5 file."""
    arrays = read_arrays(path, ARRAYS)
    if "frequency" not in arrays or not ("response" in arrays or {"real", "imaginary"} <= set(arrays)):
        raise ValueError(f"needs the arrays frequency, and response or real and imaginary; has {', '.join(arrays)}")
    if wrong := [name for name, values in arrays.items() if name != "response" and np.iscomplexobj(values)]:
        raise ValueError(f"{wrong[0]} is complex; only response may be")
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


def read_signals(path: Path) -> tuple[np.ndarray, float]:
    """Return (channels, samples) values and samples per second of a WAV file, or of a CSV file with times [s] first."""
    if path.suffix.lower() == ".wav":
        values, rate = wav_channels(path.read_bytes())
    else:
        table = read_numbers(path.read_bytes())
        if len(table) < 2 or table.shape[1] < 3:
            raise ValueError("needs the columns time, and a signal in each of at least two others")
        values, rate = table[:, 1:].T, 1 / even_step(table[:, 0])
    if values.size > MOST_SAMPLES:
        raise ValueError(f"{values.size} samples; at most {MOST_SAMPLES} are read")
    if len(values) < 2 or not np.abs(values).max(initial=0) <= LOUDEST or not rate > 0:
        raise ValueError(f"needs a channel with the force and one or more with a motion, numbers up to {LOUDEST:g}")
    return values, rate


def estimate_responses(values: np.ndarray, rate: float, table: TimeSignals) -> Columns:
    """Return responses estimated from signals (channels, samples); their coherence is None of a single segment."""
    from scipy.signal import csd, welch

    samples, length = values.shape[1], round(min(table.segment * rate, 1e18))
    if not 2 <= length <= samples:
        given = f"{samples / rate:g} s at {rate:g} samples a second"
        raise ValueError(f"holds {given}; fit.signals.segment = {table.segment:g} s must have 2 to {samples} samples")
    if table.force_channel > len(values):
        raise ValueError(f"has {len(values)} channels; fit.signals.force_channel = {table.force_channel}")
    overlap = length // 2 if table.window == "hann" else 0
    options = {"fs": rate, "window": table.window, "nperseg": length, "noverlap": overlap}
    force = values[table.force_channel - 1] / table.force_gain
    motion = np.delete(values, table.force_channel - 1, axis=0)
    frequencies, of_force = welch(force, **options)
    of_motion, crossed = welch(motion, **options)[1], csd(force, motion, **options)[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        responses = {
            "H1": crossed / of_force,
            "H2": of_motion / crossed.conj(),
            "Hv": crossed / np.abs(crossed) * np.sqrt(of_motion / of_force),
        }[table.estimator]
        coherence = np.abs(crossed) ** 2 / (of_force * of_motion)
    several = samples >= 2 * length - overlap
    return np.vstack([frequencies, responses]), np.minimum(coherence, 1.0) if several else None
