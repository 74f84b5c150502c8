"""The cases of ``bench.py``: devices, precisions, grids and numbers of plates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, get_args

import warp as wp

from warp_plate.solve.devices import cpu_threads, find_device

# Plates: the paper's, whose differences are of second order; fourth order; free edges under tension; stretching.
Kind = Literal["plain", "order4", "free", "stretching"]
PAPER_NODES = 27
PLATES = (1, 20, 256, 1024, 8192, 65536)
NODES = (17, 27, 53, 105, 161, 257, 513, 1025)
# Sizes of the other kinds, and of one plate that the whole device works on.
OTHER_NODES, LARGE_NODES = (27, 105, 257), (513, 1025)
QUICK_PLATES = (1, 20, 256)
QUICK_NODES = (53, 257)
# Plates of the paper's size that keep a CPU thread, or the largest GPUs, busy; for other sizes, as many nodes.
FILLING_A_THREAD, FILLING_A_GPU = 128, 65536


@dataclass(frozen=True)
class BenchCase:
    """A case to measure: a number of plates of ``nodes`` × ``nodes`` of one kind."""

    device: str
    precision: str
    nodes: int
    plates: int
    path: str = "auto"
    kind: Kind = "plain"

    def __str__(self) -> str:
        return f"{self.device}, {self.precision}, {self.plates} × {self.nodes}², {self.kind}"


def all_devices() -> list[str]:
    """Return the names of the CPU and of every CUDA device."""
    find_device("cpu")
    return [device.alias for device in wp.get_devices()]


def filling_plates(device: str, nodes: int) -> int:
    """Return a number of plates of ``nodes`` × ``nodes`` that keeps all cores or multiprocessors busy."""
    unit, many = (1, FILLING_A_GPU) if find_device(device).is_cuda else (cpu_threads(), FILLING_A_THREAD)
    return unit * max(1, round(many * (PAPER_NODES - 2) ** 2 / (nodes - 2) ** 2))


def make_cases(
    devices: Sequence[str],
    precisions: Sequence[str],
    plates: Sequence[int] | None = None,
    nodes: Sequence[int] | None = None,
    path: str = "auto",
    quick: bool = False,
    kind: Kind | None = None,
) -> list[BenchCase]:
    """Return the cases of every device and precision.

    Without ``plates`` and ``nodes``: numbers of plates at the paper's size, then sizes that fill the device, one large
    plate, and sizes of the other kinds, unless one kind is named. With ``plates`` alone: these, at the paper's size.
    With ``nodes`` alone: these, filling the device. With both: all pairs.

    Raises:
        SceneError: there is no such device.
    """
    cases = []
    for device in devices:
        if plates:
            sizes = list(product(nodes or (PAPER_NODES,), plates))
        else:
            few = () if nodes else QUICK_PLATES if quick else PLATES
            filled = nodes or (QUICK_NODES if quick else NODES)
            sizes = [(PAPER_NODES, count) for count in few] + [(size, filling_plates(device, size)) for size in filled]
        named = kind or "plain"
        cases += [BenchCase(device, precision, *size, path, named) for precision, size in product(precisions, sizes)]
        if not (plates or nodes or quick or kind):
            more: list[tuple[int, int, Kind]] = [(size, 1, "plain") for size in LARGE_NODES]
            others = product(get_args(Kind)[1:], OTHER_NODES)
            more += [(size, filling_plates(device, size), other) for other, size in others]
            cases += [
                BenchCase(device, precision, size, count, path, other)
                for precision, (size, count, other) in product(precisions, more)
            ]
    return list(dict.fromkeys(cases))
