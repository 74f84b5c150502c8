"""Universal files: frequency responses with coherence (dataset 58), modes (55) and the places of nodes (15)."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.result.export.frequency_response import RESPONSE_FUNCTION, missing_uff

UNIVERSAL = (".uff", ".unv")
# Codes of dataset 58: a coherence. Of dataset 55: normal modes, and complex modes of displacement and of velocity.
COHERENCE, NORMAL, COMPLEX = 6, 2, (3, 7)


def universal_responses(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Return (1 + responses, n) frequencies and responses of the datasets 58, and their (responses, n) coherences.

    Raises:
        ValueError: The file cannot be read, or holds no responses at common frequencies.
    """
    functions = [item for item in _sets(path) if item.get("type") == 58]
    sets = [item for item in functions if item.get("func_type") == RESPONSE_FUNCTION]
    coherence = [item["data"] for item in functions if item.get("func_type") == COHERENCE]
    if not sets:
        raise ValueError("has no frequency response (dataset 58 of function type 4)")
    if any(not np.array_equal(item["x"], sets[0]["x"]) for item in functions):
        raise ValueError("its frequency responses are at different frequencies")
    columns = np.vstack([sets[0]["x"], *(item["data"] for item in sets)]).astype(complex)
    return columns, np.array(coherence, dtype=float) if len(coherence) == len(sets) else None


def universal_modes(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Return frequencies [Hz], damping ratios (NaN for none), (n, points) shapes along z and (points, 2) x, y [m].

    Shapes and points are None if the places of the nodes (dataset 15) are missing.

    Raises:
        ValueError: The file cannot be read, or holds no modes at common nodes.
    """
    sets = _sets(path)
    modes = [item for item in sets if item.get("type") == 55 and item.get("analysis_type") in (NORMAL, *COMPLEX)]
    if not modes:
        raise ValueError("has no mode (dataset 55 of analysis type 2, 3 or 7)")
    rows = [_frequency_and_damping(item) for item in modes]
    frequencies, damping = np.array(rows, dtype=float).T
    numbers = modes[0]["node_nums"]
    if any(not np.array_equal(item["node_nums"], numbers) for item in modes):
        raise ValueError("its modes (dataset 55) are at different nodes")
    places = {
        int(number): (float(x), float(y))
        for item in sets
        if item.get("type") == 15
        for number, x, y in zip(item["node_nums"], item["x"], item["y"], strict=True)
    }
    if not places:
        return frequencies, damping, None, None
    if missing := [int(number) for number in numbers if int(number) not in places]:
        raise ValueError(f"node {missing[0]} of a mode has no place (dataset 15)")
    if any("r3" not in item for item in modes):
        raise ValueError("a mode has no motion across the plate (r3 of dataset 55)")
    shapes = np.array([item["r3"] for item in modes])
    return frequencies, damping, shapes, np.array([places[int(number)] for number in numbers])


def _frequency_and_damping(item: dict[str, Any]) -> tuple[float, float]:
    if item["analysis_type"] == NORMAL:
        return item["freq"], item["modal_damp_vis"] or math.nan
    size = abs(item["eig"])
    return size / (2 * math.pi), -item["eig"].real / size if size else math.nan


def _sets(path: Path) -> list[dict[str, Any]]:
    """Return the datasets of a universal file."""
    if (problem := missing_uff()) is not None:
        raise ValueError(problem)
    import pyuff

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pyuff leaves files for Python to close
            found = pyuff.UFF(str(path)).read_sets()
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(f"cannot be read as a universal file: {error}") from None
    return found if isinstance(found, list) else [found]
