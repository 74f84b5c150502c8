"""Plain data on a pipe: tables, lists, texts, numbers, bytes and arrays, and nothing that could be run.

A frame is the length of its head (8 bytes), the head as JSON, and one after the other the contents of its arrays and
bytes, of which the head holds the kinds and lengths.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import IO, Any

import numpy as np

LENGTH = 8
# The one key of the table that stands for an array or for bytes.
MARK = "\0"
# One after the other they are a frame; of an array it is the array's own memory.
Parts = list[bytes | memoryview]


def encode(message: Mapping[str, Any]) -> Parts:
    """The parts of a frame."""
    contents: Parts = []

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(entry) for key, entry in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(entry) for entry in value]
        if isinstance(value, bytes):
            contents.append(value)
            return {MARK: ["", [len(value)]]}
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise TypeError("an array of objects is no plain data")
            contents.append(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
            return {MARK: [value.dtype.str, list(value.shape)]}
        return value.item() if isinstance(value, np.generic) else value

    head = json.dumps(plain(message)).encode()
    return [len(head).to_bytes(LENGTH, "little"), head, *contents]


def send(message: Mapping[str, Any], stream: IO[bytes]) -> None:
    """Write a frame."""
    stream.writelines(encode(message))
    stream.flush()


def receive(stream: IO[bytes]) -> dict[str, Any] | None:
    """The next message; None where the other end is closed, be it within a frame."""
    head = _exactly(stream, LENGTH)
    text = None if head is None else _exactly(stream, int.from_bytes(head, "little"))
    if text is None:
        return None
    cut = False

    def whole(table: dict[str, Any]) -> Any:
        nonlocal cut
        if MARK not in table:
            return table
        kind, shape = table[MARK]
        size = int(np.prod(shape, dtype=int)) * (np.dtype(kind).itemsize if kind else 1)
        content = _exactly(stream, size)
        if content is None:
            cut = True
            return None
        return np.frombuffer(content, kind).reshape(shape) if kind else bytes(content)

    # Tables end, and are given to the hook, in the order in which their contents were put.
    message = json.loads(text, object_hook=whole)
    return None if cut else message


def _exactly(stream: IO[bytes], count: int) -> bytearray | None:
    room = bytearray(count)
    view, done = memoryview(room), 0
    while done < count:
        more = stream.readinto(view[done:])  # type: ignore[attr-defined]
        if not more:
            return None
        done += more
    return room
