"""Designs cut into blocks, and a run put together from the blocks' answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_plate.cluster.pool import Task
from warp_plate.cluster.work import designs_in, run_block
from warp_plate.plate.designs import Batch, Designs

# About so much work is in a block: a tenth of a second of a core, and of a GPU what keeps it busy. It is the scene's
# size and the kind of device that say how many plates that is, never how many workers there are.
BLOCK_NODE_STEPS = {"cpu": 8e8, "cuda": 1.3e10}
# Whole groups of the CPU's lanes and of a GPU's warps.
FEWEST = 64
PARTS = ("drives", "frequency", "centre", "delay")


def plates_of_block(node_steps_per_plate: int, kind: str) -> int:
    """How many plates a block has: a power of two, at least FEWEST."""
    most = BLOCK_NODE_STEPS[kind] / node_steps_per_plate
    return max(FEWEST, 2 ** int(np.log2(max(most, 1))))


@dataclass(frozen=True)
class Blocks:
    """Tasks for so many plates of a batch each, made one by one; a worker knows the recipe by its digest."""

    batch: Batch
    plates: int
    digest: str

    def __len__(self) -> int:
        return -(-len(self.batch) // self.plates)

    def __iter__(self) -> Iterator[Task]:
        for first in range(0, len(self.batch), self.plates):
            place = slice(first, min(first + self.plates, len(self.batch)))
            yield _task(self.batch[place], place, {"digest": self.digest})


def halves(task: Task) -> list[Task]:
    """The task as two of half as many plates; nothing where it has but one."""
    place, count = task.place, task.place.stop - task.place.start
    if count < 2:
        return []
    designs, middle = designs_in(task.payload), count // 2
    others = {name: value for name, value in task.payload.items() if name not in PARTS}
    return [
        _task(designs[:middle], slice(place.start, place.start + middle), others),
        _task(designs[middle:], slice(place.start + middle, place.stop), others),
    ]


def put(value: Mapping[str, Any], place: slice, energy: np.ndarray, faults: dict[int, tuple[str, float]]) -> None:
    """Write what ``run_block`` gave into what all plates have, as in :class:`Run`."""
    energy[place] = value["energy"]
    for plate, word, caught in value["faults"]:
        faults[place.start + plate] = word, caught


def _task(designs: Designs, place: slice, others: Mapping[str, Any]) -> Task:
    own = {name: getattr(designs, name) for name in PARTS if getattr(designs, name) is not None}
    return Task(run_block, {**others, **own}, place)
