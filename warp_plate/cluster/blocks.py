"""Designs cut into blocks, and a run put together from the blocks' answers."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.cluster.pool import Task
from warp_plate.cluster.tasks import run_block
from warp_plate.plate.designs import Batch, Shorthand

# About so much work is in a block: a tenth of a second of a core, and of a GPU what keeps it busy. It is the scene's
# size and the kind of device that say how many plates that is, never how many workers there are. (An H200 runs 2112
# plates of the paper's scene side by side, and 8448 in four goes: so few plates more would take a fifth one.)
BLOCK_NODE_STEPS = {"cpu": 8e8, "cuda": 6.6e9}
# The first and the last blocks of a batch have so many times fewer, a power of two: until they are made, sent and made
# ready all GPUs wait, and for what is left to do after them everybody.
SMALLER_ENDS = {"cpu": 1, "cuda": 4}
# A block's plates are a multiple: whole groups of the CPU's lanes and of a GPU's warps.
FEWEST = 64
# Of a task's payload what has a row for each plate.
PARTS = ("drives", "frequency", "centre", "delay", "numbers")


def plates_of_block(node_steps_per_plate: int, kind: str) -> tuple[int, int]:
    """How many plates a block has at most and, but for one with what is left over, at least."""
    most = BLOCK_NODE_STEPS[kind] / node_steps_per_plate
    ends = SMALLER_ENDS[kind]
    while ends * FEWEST > most and ends > 1:
        ends //= 2
    least = FEWEST * max(1, int(most / (ends * FEWEST)))
    return ends * least, least


def cut(plates: int, most: int, least: int) -> list[slice]:
    """Blocks of ``least`` plates that double to ``most`` and back, and in the middle what is left over by ``least``.

    None has more than half of the plates before it, so that a worker has the next one before it is done with one; nor
    more than a quarter of those after it, so that all workers are done at about the same time. ``most`` is ``least``
    times a power of two.
    """
    sizes: list[int] = []
    first, whole = 0, plates - plates % least
    while first < whole:
        size = most
        while size > least and (2 * size > first or 4 * size > whole - first - size):
            size //= 2
        sizes.append(size)
        first += size
    if whole < plates:
        sizes.insert(len(sizes) // 2, plates - whole)
    return [slice(*ends) for ends in itertools.pairwise(itertools.accumulate(sizes, initial=0))]


@dataclass(frozen=True)
class Blocks:
    """Tasks for some plates of a batch each, made one by one; a worker knows the recipe by its digest.

    short: whether the worker can make the designs of the batch's numbers.
    """

    batch: Batch
    places: Sequence[slice]
    digest: str
    short: bool = False

    def __len__(self) -> int:
        return len(self.places)

    def __iter__(self) -> Iterator[Task]:
        largest = max((place.stop - place.start for place in self.places), default=0)
        for place in self.places:
            payload = {"digest": self.digest, **self._parts(place)}
            yield Task(run_block, payload, place, (place.stop - place.start) / largest)

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
        return replace(task, payload=payload, place=place, size=task.size / 2, attempts=0)

    return [part(slice(first, middle)), part(slice(middle, stop))]


def put(value: Mapping[str, Any], place: slice, energy: np.ndarray, faults: dict[int, tuple[str, float]]) -> None:
    """Write what ``run_block`` gave into what all plates have, as in :class:`Run`."""
    energy[place] = value["energy"]
    for plate, word, caught in value["faults"]:
        faults[place.start + plate] = word, caught
