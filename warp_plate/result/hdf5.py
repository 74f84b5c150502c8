"""HDF5 files with a checksum, and safe reading of their groups, attributes and datasets.

Files are written atomically. On reading, links, data in other files and datasets larger than their file are refused.
So is a file whose parts take far more memory than itself because they refer to the same data again and again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_plate.result.atomic_io import check_seal, make_seal, write_atomically
from warp_plate.scene.errors import SceneError

# Bytes of the longest text of an attribute, and of texts that are read at once.
MOST_TEXT, MOST_BLOCK = 2**24, 2**28
# Bytes that an object costs at least, and the cost of all objects read, relative to the size of the file.
LEAST, TIMES = 100, 4
_budget: ContextVar[float] = ContextVar("bytes that may still be read", default=math.inf)


@dataclass(frozen=True)
class FileFormat:
    """A kind of file, such as "result", with the version of its layout."""

    kind: str
    version: int

    @contextmanager
    def create(self, path: str | Path, previous: Path | None = None) -> Iterator[h5py.File]:
        """Yield a file that is written atomically at the end, or raise a SceneError; see :func:`atomic_path`."""
        # Composed in memory, because HDF5 does not reliably report a full disk.
        with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
            file.attrs["format"] = f"warp-plate {self.kind} {self.version}"
            yield file
            file.flush()
            content: bytes = file.id.get_file_image()
        write_atomically(content + make_seal(content), Path(path), previous)

    @contextmanager
    def open(self, path: str | Path) -> Iterator[h5py.File]:
        """Yield a file opened for reading; raise a SceneError if it is missing, damaged or of another kind."""
        path = Path(path)
        token = _budget.set(math.inf)
        try:
            check_seal(path)
            with h5py.File(path, "r") as file:
                _budget.set(TIMES * file.id.get_filesize())
                if read_attribute(file, "format") != (expected := f"warp-plate {self.kind} {self.version}"):
                    actual = f"this is {description}, " if (description := _description(file)) else ""
                    raise SceneError(
                        f"{path}: {actual}not a {self.kind} of warp-plate (no attribute format = {expected!r})"
                    )
                yield file
        except FileNotFoundError:
            raise SceneError(f"{path}: no such file") from None
        except SceneError as error:
            line = str(error)
            raise SceneError(line if line.startswith(str(path)) else f"{path}: damaged: {line}") from None
        except (OSError, LookupError, ValueError, RuntimeError, TypeError, ArithmeticError) as error:
            raise SceneError(f"{path}: damaged or not an HDF5 file of this program: {error}") from None
        finally:
            _budget.reset(token)


def describe_file(path: Path) -> str:
    """Return what a file of this program holds, such as "a result of simulate" or "a sweep"; "" for any other file."""
    try:
        check_seal(path)
        with h5py.File(path, "r") as file:
            return _description(file).rpartition(" (")[0]
    except (OSError, LookupError, ValueError, RuntimeError):
        return ""


def _description(file: h5py.File) -> str:
    program, _, kind = str(read_attribute(file, "format")).partition(" ")
    name, _, version = kind.rpartition(" ")
    if program != "warp-plate" or not name:
        return ""
    command = f" of {read_attribute(file, 'command')}" if name == "result" else ""
    return f"a {name}{command} (format {version})"


def write_array(group: h5py.Group, name: str, values: Any, unit: str, meaning: str) -> None:
    """Write a dataset with the attributes ``units`` and ``long_name``."""
    group[name] = np.asarray(values)
    group[name].attrs.update({"units": unit, "long_name": meaning})


def write_along(group: h5py.Group, name: str, values: Any, unit: str, meaning: str, axes: Iterable[str] = ()) -> None:
    """Write values along dimensions; without any, as a dimension itself."""
    if isinstance(values, list):  # of texts
        values = np.array(values, dtype=h5py.string_dtype())
    write_array(group, name, values, unit, meaning)
    if not axes:
        group[name].make_scale(name)
    for index, axis in enumerate(axes):
        group[name].dims[index].attach_scale(group[axis])


def full_path(item: h5py.HLObject, name: str) -> str:
    return f"{item.name}/{name}".lstrip("/")


def member(group: h5py.Group, name: str, kind: type = h5py.Group) -> Any:
    """Return the group, or other kind of object, at a path in a group; refuse links, which may lead to other files."""
    path, item = full_path(group, name), group
    for part in name.split("/"):
        link = item.get(part, getlink=True) if isinstance(item, h5py.Group) else None
        if link is None:
            raise SceneError(f"{path} is missing")
        if not isinstance(link, h5py.HardLink):
            raise SceneError(f"{path} is a link, which this program does not follow")
        item = item[part]
    if not isinstance(item, kind):
        raise SceneError(f"{path} is not a {kind.__name__.lower()}")
    return item


def names_in(group: h5py.Group) -> list[str]:
    """Return the sorted names in a group."""
    names = sorted(group)
    _spend(group.name, sum(max(len(name), LEAST) for name in names))
    return names


def read_attribute(item: h5py.HLObject, name: str) -> Any:
    """Return the single value of an attribute, or None if it is missing."""
    if name not in item.attrs:
        return None
    stored, path = item.attrs.get_id(name), full_path(item, name)
    if stored.shape != () or stored.dtype.itemsize > MOST_TEXT:
        raise SceneError(f"attribute {path} is more than a single value")
    value = item.attrs[name]
    _spend(path, len(value) if isinstance(value, str | bytes) else stored.dtype.itemsize)
    if isinstance(value, str | bytes) and len(value) > MOST_TEXT:
        raise SceneError(f"attribute {path} is longer than {MOST_TEXT} bytes")
    return value


def read_array(
    group: h5py.Group, name: str, shape: tuple[int | None, ...] | None = None, text: bool = False
) -> np.ndarray:
    """Return a dataset of real numbers, or of text, that is in the file itself.

    Its shape must be ``shape``, where None stands for any length (default: any shape).
    """
    dataset, path = member(group, name, h5py.Dataset), full_path(group, name)
    if (h5py.check_string_dtype(dataset.dtype) is None) if text else (dataset.dtype.kind not in "fiu"):
        raise SceneError(f"{path} is not a dataset of {'text' if text else 'real numbers'}")
    if dataset.chunks is not None:
        raise SceneError(f"{path} is in chunks, which this program does not write")
    if dataset.is_virtual or dataset.external:
        raise SceneError(f"{path} is kept in another file, which this program does not read")
    if math.prod(dataset.shape) * dataset.dtype.itemsize > dataset.file.id.get_filesize():
        raise SceneError(f"{path} has shape {dataset.shape}, more than the file holds")
    expected = dataset.shape if shape is None else shape
    if len(expected) != dataset.ndim or any(a not in (None, b) for a, b in zip(expected, dataset.shape, strict=True)):
        raise SceneError(f"{path} has shape {dataset.shape} instead of {expected} (None: any length)")
    if text:
        return np.array(_read_texts(dataset, path), dtype=object).reshape(dataset.shape)
    _spend(path, dataset.nbytes)
    return np.asarray(dataset[()])


def _read_texts(dataset: h5py.Dataset, path: str) -> list[str]:
    """Return the texts of a dataset, read in blocks that even in a file made for it do not fill the memory."""
    texts: list[str] = []
    columns, step = dataset.shape[-1], max(1, MOST_BLOCK // dataset.file.id.get_filesize())
    for row in np.ndindex(dataset.shape[:-1]):
        for start in range(0, columns, step):
            block = dataset.asstr()[row + (slice(start, start + step),)].tolist()
            _spend(path, sum(map(len, block)))
            texts += block
    return texts


def _spend(name: str, size: int) -> None:
    """Count an object of so many bytes, or raise a SceneError if the file cannot hold so much."""
    _budget.set(_budget.get() - max(size, LEAST))
    if _budget.get() < 0:
        raise SceneError(f"{name} and what was read before take {TIMES} times as much memory as the file")
