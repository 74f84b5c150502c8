"""Designs cut into blocks, and a run put together from the blocks' answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.cluster.pool import Task
from warp_plate.cluster.work import run_block
from warp_plate.plate.designs import Batch, Shorthand

# About so much work is in a block: a tenth of a second of a core, and of a GPU what keeps it busy. It is the scene's
# size and the kind of device that say how many plates that is, never how many workers there are.
BLOCK_NODE_STEPS = {"cpu": 8e8, "cuda": 6.6e9}
# Whole groups of the CPU's lanes and of a GPU's warps.
FEWEST = 64
# Of a task's payload what has a row for each plate.
PARTS = ("drives", "frequency", "centre", "delay", "numbers")


def plates_of_block(node_steps_per_plate: int, kind: str) -> int:
    """How many plates a block has: a power of two, at least FEWEST."""
    most = BLOCK_NODE_STEPS[kind] / node_steps_per_plate
    return max(FEWEST, 2 ** int(np.log2(max(most, 1))))


@dataclass(frozen=True)
class Blocks:
    """Tasks for so many plates of a batch each, made one by one; a worker knows the recipe by its digest.

    short: whether the worker can make the designs of the batch's numbers.
    """

    batch: Batch
    plates: int
    digest: str
    short: bool = False

    def __len__(self) -> int:
        return -(-len(self.batch) // self.plates)

    def __iter__(self) -> Iterator[Task]:
        for first in range(0, len(self.batch), self.plates):
            place = slice(first, min(first + self.plates, len(self.batch)))
            yield Task(run_block, {"digest": self.digest, **self._parts(place)}, place)

    def _parts(self, place: slice) -> dict[str, Any]:
        if self.short and isinstance(self.batch, Shorthand):
            return {"numbers": self.batch.numbers(place), "maker": self.batch.maker}
        designs = self.batch[place]
        return {name: values for name, values in vars(designs).items() if values is not None}


def halves(task: Task) -> list[Task]:
    """The task as two of half as many plates, which may go where it did; nothing where it has but one."""
    first, stop = task.place.start, task.place.stop
    middle = (first + stop) // 2
    if middle == first:
        return []

    def part(place: slice) -> Task:
        rows = slice(place.start - first, place.stop - first)
        payload = {name: value[rows] if name in PARTS else value for name, value in task.payload.items()}
        return replace(task, payload=payload, place=place, attempts=0)

    return [part(slice(first, middle)), part(slice(middle, stop))]


def put(value: Mapping[str, Any], place: slice, energy: np.ndarray, faults: dict[int, tuple[str, float]]) -> None:
    """Write what ``run_block`` gave into what all plates have, as in :class:`Run`."""
    energy[place] = value["energy"]
    for plate, word, caught in value["faults"]:
        faults[place.start + plate] = word, caught
