"""HDF5 files that are written in one piece with a seal, and read without trust in their content.

Links, data in other files and datasets larger than their file are refused, whatever the seal says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_plate.result.atomic_io import check_seal, make_seal, write_atomically
from warp_plate.scene.errors import SceneError


def save_hdf5(path: Path, file_format: str, write: Callable[[h5py.File], None], previous: Path | None = None) -> None:
    """Compose a file in memory, seal it and write it atomically.

    HDF5 does not reliably report a full disk, for it writes what it still holds when the file is closed.

    Args:
        path: The file.
        file_format: Value of the attribute ``format``.
        write: Writes all else.
        previous: New name of the file that is replaced (default: it is deleted).

    Raises:
        SceneError: the file cannot be written.
    """
    with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
        file.attrs["format"] = file_format
        write(file)
        file.flush()
        content: bytes = file.id.get_file_image()
    write_atomically(content + make_seal(content), path, previous)


@contextmanager
def open_hdf5(path: Path, file_format: str, kind: str) -> Iterator[h5py.File]:
    """Yield a file opened for reading, after a check of its seal and its attribute ``format``.

    Args:
        path: The file.
        file_format: Required value of the attribute ``format``.
        kind: Kind of file, for the error message.

    Raises:
        SceneError: there is no such file, or it is damaged or of another kind or format. Errors while the file is read
            become SceneErrors that name it, too.
    """
    try:
        check_seal(path)
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != file_format:
                raise SceneError(f"{path}: not a {kind} of warp-plate (no attribute format = {file_format!r})")
            yield file
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file") from None
    except SceneError as error:
        line = str(error)
        raise SceneError(line if line.startswith(str(path)) else f"{path}: damaged: {line}") from None
    except (OSError, LookupError, ValueError, RuntimeError, TypeError, ArithmeticError) as error:
        reason = " ".join(str(error).split())
        raise SceneError(f"{path}: damaged or not an HDF5 file of this program: {reason}") from None


def member(group: h5py.Group, name: str) -> h5py.HLObject:
    """Return a member of a group by its path.

    Raises:
        SceneError: it is missing, or reached by a link, which could lead to another file.
    """
    path = full_path(group, name)
    for part in name.split("/"):
        link = group.get(part, getlink=True) if isinstance(group, h5py.Group) else None
        if link is None:
            raise SceneError(f"{path} is missing")
        if not isinstance(link, h5py.HardLink):
            raise SceneError(f"{path} is a link, which this program does not follow")
        group = group[part]
    return group


def subgroup(group: h5py.Group, name: str) -> h5py.Group:
    """Return a group in a group by its path.

    Raises:
        SceneError: it is missing, reached by a link, or not a group.
    """
    found = member(group, name)
    if not isinstance(found, h5py.Group):
        raise SceneError(f"{full_path(group, name)} is not a group")
    return found


def member_names(group: h5py.Group, name: str) -> list[str]:
    """Return the names of the members of a group in a group; none if there is no such group.

    Raises:
        SceneError: it is a link, or not a group.
    """
    if name not in group:
        return []
    return list(subgroup(group, name))


def read_numbers(group: h5py.Group, name: str, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
    """Return a dataset of real numbers.

    Args:
        group: The group.
        name: Path of the dataset in the group.
        shape: Required shape, with None for any length (default: any shape).

    Raises:
        SceneError: it is missing, not in the file itself, or of another kind or shape.
    """
    found = dataset(group, name, shape)
    if found.dtype.kind not in "fiu":
        raise SceneError(f"{full_path(group, name)} is not a dataset of real numbers")
    values: np.ndarray = found[()]
    return values


def dataset(group: h5py.Group, name: str, shape: tuple[int | None, ...] | None = None) -> h5py.Dataset:
    """Return a dataset, unread; arguments and errors as for :func:`read_numbers`."""
    found, path = member(group, name), full_path(group, name)
    if not isinstance(found, h5py.Dataset):
        raise SceneError(f"{path} is not a dataset")
    if found.is_virtual or found.external:
        raise SceneError(f"{path} is kept in another file, which this program does not read")
    if math.prod(found.shape) * found.dtype.itemsize > found.file.id.get_filesize():
        raise SceneError(f"{path} has shape {found.shape}, more than the file holds")
    fits = shape is None or (
        len(shape) == len(found.shape) and all(a in (None, b) for a, b in zip(shape, found.shape, strict=True))
    )
    if not fits:
        wanted = ", ".join("any" if length is None else str(length) for length in shape or ())
        raise SceneError(f"{path} has shape {found.shape} instead of ({wanted})")
    return found


def read_attribute(item: h5py.HLObject, name: str) -> Any:
    """Return an attribute as a Python object.

    Raises:
        SceneError: it is missing.
    """
    value = item.attrs.get(name)
    if value is None:
        raise SceneError(f"attribute {full_path(item, name)} is missing")
    return value.item() if isinstance(value, np.generic) else value


def full_path(item: h5py.HLObject, name: str) -> str:
    """Return the path of a member or attribute from the root of the file."""
    return f"{item.name}/{name}".lstrip("/")
