"""Traces as CSV: a line of headings with units, then numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from warp_plate.result.atomic_io import atomic_paths
from warp_plate.result.model import Case, Result
from warp_plate.scene.errors import SceneError

# Number of rows that are composed at once.
BLOCK = 2**16


def write_traces(result: Result, cases: Mapping[str, Case], path: str | Path) -> list[Path]:
    """Write the time [s], and the displacement [m] of each case at each recorded point; return the path.

    Raises:
        SceneError: the result holds no traces, or the file cannot be written.
    """
    points = result.scene.record.points
    if not points or not result.trace_times.size:
        raise SceneError("holds no traces; add record.points = [[x, y], ...] (metres) to its scene and run it again")
    columns = [f"{name} u(x={x!r} y={y!r}) [m]" for name in cases for x, y in points]
    traces = np.concatenate([case.trace for case in cases.values()])
    blocks = (
        np.column_stack([result.trace_times[start : start + BLOCK], traces[:, start : start + BLOCK].T])
        for start in range(0, result.trace_times.size, BLOCK)
    )
    write_table(Path(path), ["time [s]", *columns], blocks)
    return [Path(path)]


def write_table(path: Path, heading: list[str], blocks: Iterable[np.ndarray]) -> None:
    """Write blocks of rows as comma-separated UTF-8 text, the first column with 15 digits and the others with 9.

    Raises:
        SceneError: the file cannot be written.
    """
    with atomic_paths(path) as (temporary,), temporary.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(heading)
        for block in blocks:
            np.savetxt(file, block, fmt=["%.15g", *["%.9g"] * (block.shape[1] - 1)], delimiter=",")
