"""Frequency responses that were measured, from CSV and universal files (dataset 58)."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warp_plate.plate.files import number_rows
from warp_plate.result.export.frequency_response import RESPONSE_FUNCTION, missing_uff
from warp_plate.scene.errors import SceneError

UNIVERSAL = (".uff", ".unv")
MOST_BYTES, MOST_FREQUENCIES = 2**27, 4000


@dataclass(frozen=True, eq=False)
class MeasuredResponses:
    """Frequency responses of a panel, in the order of ``[[measurement]]``.

    Attributes:
        source: File that they come from.
        frequencies: (n,) [Hz], rising, above 0.
        responses: (measurements, n) complex responses, for motion that turns as exp(iωt).
    """

    source: str
    frequencies: np.ndarray
    responses: np.ndarray


def read_responses(path: Path, count: int) -> MeasuredResponses:
    """Return ``count`` responses of a file; a line at 0 Hz is left out.

    A CSV file has the columns frequency [Hz], real and imaginary part of the first response, those of the second and so
    on; further columns are skipped, and names in the first line do not matter. A universal file (.uff, .unv) has a
    dataset 58 for each response, all at the same frequencies.

    Raises:
        SceneError: The file cannot be read, or holds no such responses.
    """
    try:
        if not path.is_file():
            raise SceneError(f"{path}: no such file")
        if path.stat().st_size > MOST_BYTES:
            raise SceneError(f"{path}: {path.stat().st_size} bytes; at most {MOST_BYTES} are read")
        columns = _universal(path) if path.suffix.lower() in UNIVERSAL else _csv(path.read_bytes())
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    frequencies, responses = columns[0].real, columns[1:]
    universal = path.suffix.lower() in UNIVERSAL
    if len(responses) < count or (universal and len(responses) > count):
        raise SceneError(f"{path}: has {len(responses)} responses; the scene has {count} tables [[measurement]]")
    moving = frequencies != 0
    frequencies, responses = frequencies[moving], responses[:count, moving]
    if not 2 <= len(frequencies) <= MOST_FREQUENCIES:
        raise SceneError(f"{path}: {len(frequencies)} frequencies; 2 to {MOST_FREQUENCIES} can be fitted")
    if not (frequencies[0] > 0 and np.all(np.diff(frequencies) > 0) and np.isfinite(frequencies[-1])):
        raise SceneError(f"{path}: frequencies must rise, from 0 hertz or above")
    for row, column in np.argwhere(~np.isfinite(responses) | (responses == 0))[:1].tolist():
        value, where = responses[row, column], f"response {row + 1} at {frequencies[column]:g} Hz"
        raise SceneError(f"{path}: {where} is {value:g}; must be a complex number other than 0")
    return MeasuredResponses(str(path), frequencies, responses)


def _csv(data: bytes) -> np.ndarray:
    """Return (1 + responses, n) frequencies and responses."""
    named = re.match(rb"(\xef\xbb\xbf)?[\"A-Za-z].*", data)
    table = np.array([row for _, row in number_rows(data[named.end() if named else 0 :])], dtype=float)
    if table.size == 0 or table.shape[1] < 3:
        raise ValueError("needs the columns frequency, real and imaginary part of each response")
    pairs = (table.shape[1] - 1) // 2
    return np.vstack([table[:, 0], table[:, 1 : 2 * pairs : 2].T + 1j * table[:, 2 : 2 * pairs + 1 : 2].T])


def _universal(path: Path) -> np.ndarray:
    """Return (1 + responses, n) frequencies and responses."""
    if (problem := missing_uff()) is not None:
        raise ValueError(problem)
    import pyuff

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pyuff leaves files for Python to close
            found = pyuff.UFF(str(path)).read_sets()
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(f"cannot be read as a universal file: {error}") from None
    sets = [item for item in (found if isinstance(found, list) else [found]) if item.get("type") == 58]
    sets = [item for item in sets if item["func_type"] == RESPONSE_FUNCTION]
    if not sets:
        raise ValueError("has no frequency response (dataset 58 of function type 4)")
    if any(not np.array_equal(item["x"], sets[0]["x"]) for item in sets):
        raise ValueError("its frequency responses are at different frequencies")
    return np.vstack([sets[0]["x"], *(item["data"] for item in sets)]).astype(complex)
