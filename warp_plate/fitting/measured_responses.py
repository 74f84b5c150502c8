"""Frequency responses that were measured: from tables, arrays, universal files, and time signals."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.fitting.signals import estimate_responses, read_signals
from warp_plate.fitting.universal import UNIVERSAL, universal_responses
from warp_plate.plate.files import number_rows
from warp_plate.result.arrays import HDF5, MAT, read_arrays
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, SMALLEST
from warp_plate.scene.fit import Fit, TimeSignals

MOST_BYTES, MOST_FREQUENCIES = 2**27, 4000
# Names in MAT and HDF5 files.
MOST_COHERENCE = 1 + 1e-6  # of numbers that were rounded
ARRAYS = "frequency", "response", "real", "imaginary", "coherence"
# (1 + responses, n) frequencies and responses, and (responses, n) coherences.
Columns = tuple[np.ndarray, np.ndarray | None]


@dataclass(frozen=True, eq=False)
class MeasuredResponses:
    """Frequency responses of a panel, in the order of ``[[measurement]]``.

    Attributes:
        source: Files that they come from.
        frequencies: (n,) [Hz], rising, above 0.
        responses: (measurements, n) complex responses, for motion that turns as exp(iωt).
        coherence: (measurements, n) coherence γ², NaN for responses without; None if there is none at all.
    """

    source: str
    frequencies: np.ndarray
    responses: np.ndarray
    coherence: np.ndarray | None = None


def read_responses(paths: Path | Sequence[Path], count: int, fit: Fit | None = None) -> MeasuredResponses:
    """Return ``count`` responses of a file, or of several files with as many each; a line at 0 Hz is left out.

    A CSV file has the columns frequency [Hz], real and imaginary part of the first response, those of the second and so
    on; further columns are skipped, and names in the first line do not matter. A universal file (.uff, .unv) has a
    dataset 58 for each response, all at the same frequencies. MAT files (.mat) and HDF5 files (.h5, .hdf5, .nc) have
    the arrays ``frequency`` and ``response``, or ``real`` and ``imaginary``, and maybe ``coherence``. WAV files have
    time signals, and so have CSV files where there is ``fit.signals``.

    Args:
        paths: Files.
        count: Number of responses.
        fit: Range of frequencies that count, and how signals are read (default: all frequencies).

    Raises:
        SceneError: A file cannot be read, or holds no such responses.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    if not paths or count % len(paths):
        raise SceneError(f"{len(paths)} files of data for {count} tables [[measurement]]; each file holds as many")
    parts = [_read(path, count // len(paths), fit.signals if fit else None) for path in paths]
    for path, (columns, _) in zip(paths, parts, strict=True):
        if not np.array_equal(columns[0], parts[0][0][0]):
            raise SceneError(f"{path}: is at other frequencies than {paths[0]}")
    source = ", ".join(map(str, paths))
    frequencies, responses = parts[0][0][0].real, np.vstack([columns[1:] for columns, _ in parts])
    coherence = np.vstack([np.full(of[1:].shape, np.nan) if known is None else known for of, known in parts])
    low, high = fit.range if fit and fit.range else (-np.inf, np.inf)
    kept = (frequencies != 0) & ~((frequencies < low) | (frequencies > high))
    frequencies, responses, coherence = frequencies[kept], responses[:, kept], coherence[:, kept]
    _check(source, frequencies, responses)
    return MeasuredResponses(source, frequencies, responses, None if np.isnan(coherence).all() else coherence)


def _read(path: Path, count: int, signals: TimeSignals | None) -> Columns:
    """Return the first ``count`` responses of a file."""
    ending = path.suffix.lower()
    try:
        if not path.is_file():
            raise SceneError(f"{path}: no such file")
        if path.stat().st_size > MOST_BYTES:
            raise SceneError(f"{path}: {path.stat().st_size} bytes; at most {MOST_BYTES} are read")
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
        each = f"the scene has {count} tables [[measurement]] for it"
        raise SceneError(f"{path}: has {len(columns) - 1} responses; {each}")
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
    table = np.array([row for _, row in number_rows(data[named.end() if named else 0 :])], dtype=float)
    if table.size == 0 or table.shape[1] < 3:
        raise ValueError("needs the columns frequency, real and imaginary part of each response")
    pairs = (table.shape[1] - 1) // 2
    return np.vstack([table[:, 0], table[:, 1 : 2 * pairs : 2].T + 1j * table[:, 2 : 2 * pairs + 1 : 2].T])


def _arrays(path: Path) -> Columns:
    """Return the responses of a MAT or HDF5 file."""
    found = read_arrays(path, ARRAYS)
    if "frequency" not in found or not ("response" in found or {"real", "imaginary"} <= set(found)):
        raise ValueError(f"needs the arrays frequency, and response or real and imaginary; has {', '.join(found)}")
    if turned := [name for name, values in found.items() if name != "response" and np.iscomplexobj(values)]:
        raise ValueError(f"{turned[0]} is complex; only response may be")
    frequencies = found["frequency"].ravel()
    shaped = {name: _along(name, values, len(frequencies)) for name, values in found.items() if name != "frequency"}
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
