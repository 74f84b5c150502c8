"""HDF5 files of this program: written in one piece with a seal, and read without trust.

A file may have been made to do harm: HDF5 knows links to other files, data kept in other files, and filters that load
libraries. All of these are refused, whatever the seal says; so is what would take more memory than the file is long.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_plate.result.atomic_io import check_seal, make_seal, write_atomically
from warp_plate.scene.errors import SceneError


def save_hdf5(write: Callable[[h5py.File], None], path: Path, previous: Path | None = None) -> None:
    """Make the file in memory, seal it, and write it whole or not at all.

    (HDF5 cannot be relied on to report a full disk: what it still holds is written when it closes or ends.)

    Raises:
        SceneError: it cannot be written.
    """
    with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
        write(file)
        file.flush()
        content: bytes = file.id.get_file_image()
    write_atomically(content + make_seal(content), path, previous)


@contextmanager
def opened(path: Path, form: str, kind: str) -> Iterator[h5py.File]:
    """The file for reading, once its seal and its attribute ``format`` are right.

    form: what that attribute must say; kind: what such a file is, for people.

    Raises:
        SceneError: no such file, not of this kind, or damaged; also for what goes wrong while it is read.
    """
    try:
        check_seal(path)
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != form:
                raise SceneError(f"{path}: not a {kind} of warp-plate (no attribute format = {form!r})")
            yield file
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file") from None
    except SceneError as error:
        line = str(error)
        raise SceneError(line if line.startswith(str(path)) else f"{path}: damaged: {line}") from None
    except (OSError, LookupError, ValueError, RuntimeError, TypeError, ArithmeticError) as error:
        reason = " ".join(str(error).split())
        raise SceneError(f"{path}: damaged or not an HDF5 file of this program: {reason}") from None


def put(file: h5py.File, name: str, values: object, units: str, long_name: str) -> None:
    """Write a dataset with its unit and meaning."""
    file[name] = np.asarray(values)
    file[name].attrs.update({"units": units, "long_name": long_name})


def names_in(group: h5py.Group, name: str) -> list[str]:
    """What a group holds, by name; nothing where there is no such group."""
    if name not in group:
        return []
    found = _own(group, name)
    if not isinstance(found, h5py.Group):
        raise SceneError(f"{name} is no group")
    return list(found)


def numbers(group: h5py.Group, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """A dataset of real numbers; ``shape``: what it must have, None where any length is right.

    Raises:
        SceneError: missing, not in this file itself, or of another kind or shape.
    """
    found = _own(group, name)
    if not isinstance(found, h5py.Dataset) or found.dtype.kind not in "fiu":
        raise SceneError(f"{name} is no dataset of real numbers")
    _refuse_elsewhere(found, name)
    if math.prod(found.shape) * found.dtype.itemsize > found.file.id.get_filesize():
        raise SceneError(f"{name} has shape {found.shape}, more than the file holds")
    _refuse_shape(found, name, shape)
    values: np.ndarray = found[()]
    return values


def texts(group: h5py.Group, name: str, shape: tuple[int | None, ...], places: Iterable[tuple[int, ...]]) -> list[str]:
    """Those at some places of a dataset of texts of any length; ``shape``: see :func:`numbers`.

    Raises:
        SceneError: missing, not in this file itself, of another kind or shape, or longer than the file.
    """
    found = _own(group, name)
    if not isinstance(found, h5py.Dataset) or h5py.check_string_dtype(found.dtype) is None:
        raise SceneError(f"{name} is no dataset of texts")
    _refuse_elsewhere(found, name)
    _refuse_shape(found, name, shape)
    left, read = found.file.id.get_filesize(), []
    for place in places:  # one by one: many may point at the same long text
        read.append(found.asstr()[place])
        left -= 1 + len(read[-1])
        if left < 0:
            raise SceneError(f"{name} holds more than the file does")
    return read


def text(item: h5py.HLObject, name: str) -> str:
    """An attribute that is text.

    Raises:
        SceneError: missing or no text.
    """
    value = item.attrs.get(name)
    if not isinstance(value, str):
        raise SceneError(f"attribute {name} is {'missing' if value is None else 'no text'}")
    return value


def table(item: h5py.HLObject, name: str, kind: type = dict) -> Any:
    """An attribute that is JSON of an object, or of what ``kind`` says.

    Raises:
        SceneError, ValueError, RecursionError: it is none.
    """
    value = json.loads(text(item, name))
    if not isinstance(value, kind):
        raise SceneError(f"attribute {name} is no JSON of a {kind.__name__}")
    return value


def lost_of(file: h5py.File) -> dict[str, int]:
    """Plates without energies by what went wrong on their workers; files of before there were workers have none.

    Raises:
        SceneError, ValueError, TypeError, RecursionError: the attribute says something else.
    """
    return {str(why): int(plates) for why, plates in table(file, "lost").items()} if "lost" in file.attrs else {}


def count(item: h5py.HLObject, name: str) -> int:
    """An attribute that is a whole number, 0 or more.

    Raises:
        SceneError: it is none.
    """
    value = item.attrs.get(name)
    if not isinstance(value, (int, np.integer)) or value < 0:
        raise SceneError(f"attribute {name} is {'missing' if value is None else 'no whole number from 0 on'}")
    return int(value)


def _own(group: h5py.Group, name: str) -> h5py.HLObject:
    """A member, by a path that leads through plain links only: others may lead to another file."""
    for part in name.split("/"):
        link = group.get(part, getlink=True) if isinstance(group, h5py.Group) else None
        if link is None:
            raise SceneError(f"{name} is missing")
        if not isinstance(link, h5py.HardLink):
            raise SceneError(f"{name} is a link, which this program does not follow")
        group = group[part]
    return group


def _refuse_elsewhere(found: h5py.Dataset, name: str) -> None:
    if found.is_virtual or found.external or found.id.get_create_plist().get_nfilters():
        raise SceneError(f"{name} is kept in another file or by a filter, which this program does not read")


def _refuse_shape(found: h5py.Dataset, name: str, shape: tuple[int | None, ...]) -> None:
    right = len(found.shape) == len(shape) and all(
        wanted is None or wanted == length for wanted, length in zip(shape, found.shape, strict=True)
    )
    if not right:
        wanted_shape = ", ".join("any" if length is None else str(length) for length in shape)
        raise SceneError(f"{name} has shape {found.shape} instead of ({wanted_shape})")
