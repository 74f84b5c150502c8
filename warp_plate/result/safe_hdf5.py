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
    """Compose a file in memory, seal it and write it atomically, for HDF5 does not reliably report a full disk.

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
    """Yield a file opened for reading, once its seal and its attribute ``format`` are verified.

    Raises:
        SceneError: there is no such file, it is damaged or not of this kind, or reading it fails.
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


def member(group: h5py.Group, name: str, kind: type = h5py.Group) -> Any:
    """Return the group, or other kind of object, at a path in a group.

    Raises:
        SceneError: it is missing, of another kind, or reached by a link, which could lead to another file.
    """
    path, found = full_path(group, name), group
    for part in name.split("/"):
        link = found.get(part, getlink=True) if isinstance(found, h5py.Group) else None
        if link is None:
            raise SceneError(f"{path} is missing")
        if not isinstance(link, h5py.HardLink):
            raise SceneError(f"{path} is a link, which this program does not follow")
        found = found[part]
    if not isinstance(found, kind):
        raise SceneError(f"{path} is not a {kind.__name__.lower()}")
    return found


def read_array(
    group: h5py.Group, name: str, shape: tuple[int | None, ...] | None = None, text: bool = False
) -> np.ndarray:
    """Return a dataset of real numbers, or of text.

    Args:
        group: The group.
        name: Path of the dataset in the group.
        shape: Required shape, with None for any length (default: any shape).
        text: True for text.

    Raises:
        SceneError: it is missing, not in the file itself, or of another kind or shape.
    """
    found, path = member(group, name, h5py.Dataset), full_path(group, name)
    if (h5py.check_string_dtype(found.dtype) is None) if text else (found.dtype.kind not in "fiu"):
        raise SceneError(f"{path} is not a dataset of {'text' if text else 'real numbers'}")
    if found.is_virtual or found.external:
        raise SceneError(f"{path} is kept in another file, which this program does not read")
    if math.prod(found.shape) * found.dtype.itemsize > found.file.id.get_filesize():
        raise SceneError(f"{path} has shape {found.shape}, more than the file holds")
    wanted = found.shape if shape is None else shape
    lengths_fit = all(a in (None, b) for a, b in zip(wanted, found.shape, strict=False))
    if len(wanted) != len(found.shape) or not lengths_fit:
        raise SceneError(f"{path} has shape {found.shape} instead of {wanted} (None: any length)")
    values: np.ndarray = (found.asstr() if text else found)[()]
    return values


def full_path(item: h5py.HLObject, name: str) -> str:
    """Return the path of a member or attribute from the root of the file."""
    return f"{item.name}/{name}".lstrip("/")
