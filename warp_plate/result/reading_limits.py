"""Limits of what is read from a file, which may refer to the same data again and again.

Every object costs its bytes, but at least ``LEAST``; all together may cost ``TIMES`` as much as the file is long.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import h5py

from warp_plate.scene.errors import SceneError

# Fewest bytes of an object in a file, its headers included.
LEAST, TIMES = 100, 4
_left: ContextVar[float] = ContextVar("bytes left to read", default=float("inf"))


@contextmanager
def reading_limit(size: int) -> Iterator[None]:
    """Limit what is read in this block of a file of so many bytes."""
    token = _left.set(TIMES * size)
    try:
        yield
    finally:
        _left.reset(token)


def spend(name: str, size: int) -> None:
    """Count an object of so many bytes, or raise a SceneError if the file cannot hold so much."""
    _left.set(_left.get() - max(size, LEAST))
    if _left.get() < 0:
        raise SceneError(f"{name} and what was read before take {TIMES} times as much memory as the file")


def names_in(group: h5py.Group) -> list[str]:
    """Return the sorted names in a group, each of which costs its bytes: a file may hold them compressed."""
    names: list[str] = []

    def take(name: bytes) -> SceneError | None:
        names.append(name.decode(errors="surrogateescape"))
        try:
            spend(group.name, len(name))
        except SceneError as error:  # h5py ends at a returned value, but cannot pass errors on
            return error
        return None

    # In HDF5's other orders all names are read before the first.
    refusal, _ = group.id.links.iterate(take, order=h5py.h5.ITER_NATIVE)
    if refusal is not None:
        raise refusal
    return sorted(names)
