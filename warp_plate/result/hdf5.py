"""HDF5 files with a checksum, safe reading of their groups, attributes and datasets, and arrays of other programs.

Files are written atomically. On reading, links, data in other files and datasets larger than their file are refused.
"""

import math
import secrets
import textwrap
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np

from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.result.atomic_io import check_seal, make_seal, write_atomically
from warp_plate.scene.errors import SceneError, check_type

# Endings of files of other programs: MAT files of MATLAB, and HDF5 files such as those of xarray.
MAT, HDF5 = (".mat",), (".h5", ".hdf5", ".nc")
UNPACKED_BYTES = 2**28  # of the arrays of such a file, which may be compressed
BYTES_A_NUMBER = 48.0  # of memory that reading and checking a number of such a file takes, of whatever type it is
COMPRESSED = 15  # type of a compressed variable in a MAT file
NUMBERS_OF_MAT = "double", "single", "int", "uint", "logical"  # first letters of classes


@contextmanager
def create_hdf5(path: Path, end: Callable[[bytes], bytes] = lambda content: b"") -> Iterator[h5py.File]:
    """Yield an HDF5 file that is written atomically at the end, followed by a function of its content.

    It is composed in memory, because HDF5 does not reliably report a full disk, and may crash on it. There it has a
    name of its own, since HDF5 creates no file that is open, as by a thread that saves at the same time.

    Raises:
        SceneError: it cannot be written; see :func:`atomic_path`.
    """
    with h5py.File(secrets.token_hex(), "w", driver="core", backing_store=False) as file:
        yield file
        file.flush()
        content: bytes = file.id.get_file_image()
    write_atomically(content + end(content), path)


@dataclass(frozen=True)
class FileFormat:
    """A kind of file, such as "result", with the version of its layout."""

    kind: str
    version: int

    @contextmanager
    def create(self, path: str | Path) -> Iterator[h5py.File]:
        """Yield a file that is written atomically at the end, or raise a SceneError; see :func:`atomic_path`."""
        check_type("path", path, str, Path)
        with create_hdf5(Path(path), make_seal) as file:
            file.attrs["format"] = f"warp-plate {self.kind} {self.version}"
            yield file

    @contextmanager
    def open(self, path: str | Path) -> Iterator[h5py.File]:
        """Yield a file opened for reading; raise a SceneError if it is missing, damaged or of another kind."""
        check_type("path", path, str, Path)
        path = Path(path)
        try:
            check_seal(path)
            with h5py.File(path, "r") as file:
                if read_attribute(file, "format") != (expected := f"warp-plate {self.kind} {self.version}"):
                    actual = f"this is {description}, " if (description := _description(file)) else ""
                    raise SceneError(
                        f"{path}: {actual}not a {self.kind} of warp-plate (no attribute format = {expected!r})"
                    )
                yield file
        except SceneError as error:
            line = str(error)
            raise SceneError(line if line.startswith(str(path)) else f"{path}: damaged: {line}") from None
        except (OSError, LookupError, ValueError, RuntimeError, TypeError, ArithmeticError) as error:
            raise SceneError(f"{path}: damaged or not an HDF5 file of this program: {error}") from None


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


def read_attribute(item: h5py.HLObject, name: str) -> Any:
    """Return the single value of an attribute, or None if it is missing."""
    if name not in item.attrs:
        return None
    if item.attrs.get_id(name).shape != ():
        raise SceneError(f"attribute {full_path(item, name)} is more than a single value")
    return item.attrs[name]


def read_array(
    group: h5py.Group, name: str, shape: tuple[int | None, ...] | None = None, text: bool = False
) -> np.ndarray:
    """Return a dataset of real numbers, or of text, that is in the file itself.

    Its shape must be ``shape``, where None stands for any length (default: any shape).
    """
    dataset, path = member(group, name, h5py.Dataset), full_path(group, name)
    if (h5py.check_string_dtype(dataset.dtype) is None) if text else (dataset.dtype.kind not in "fiu"):
        raise SceneError(f"{path} is not a dataset of {'text' if text else 'real numbers'}")
    if dataset.dtype.kind == "f" and dataset.dtype.itemsize not in (4, 8):
        raise SceneError(f"{path} has numbers of {8 * dataset.dtype.itemsize} bits, which this program does not write")
    if dataset.chunks is not None:
        raise SceneError(f"{path} is in chunks, which this program does not write")
    if dataset.is_virtual or dataset.external:
        raise SceneError(f"{path} is kept in another file, which this program does not read")
    if math.prod(dataset.shape) * dataset.dtype.itemsize > dataset.file.id.get_filesize():
        raise SceneError(f"{path} has shape {dataset.shape}, more than the file holds")
    expected = dataset.shape if shape is None else shape
    if len(expected) != dataset.ndim or any(a not in (None, b) for a, b in zip(expected, dataset.shape, strict=True)):
        raise SceneError(f"{path} has shape {dataset.shape} instead of {expected} (None: any length)")
    return np.asarray(dataset.asstr()[()] if text else dataset[()])


@np.errstate(invalid="ignore")  # of signalling NaN, which are NaN once converted
def read_arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the arrays with these names that a MAT or HDF5 file has, float64, but complex128 of ``response``.

    Args:
        path: File that ends in .mat, .h5, .hdf5 or .nc.
        names: Variables, or datasets at the top of the file.

    Raises:
        ValueError: The file is damaged or none of that kind, has none of the names, or an array is too large or not
            made of numbers, which are complex only in ``response``.
    """
    kind, read = ("MAT", _mat) if path.suffix.lower() in MAT else ("HDF5", _hdf5)
    try:
        arrays = read(path, names)
    except SceneError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(f"cannot be read as a {kind} file: {error}") from None
    if not arrays:
        raise ValueError(str(_none_of(names, [])))
    for name, values in arrays.items():
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiuc":  # MAT files may hold sparse ones
            raise ValueError(f"{name} is not an array of numbers")
        if name != "response" and values.dtype.kind == "c":
            raise ValueError(f"{name} is complex; only response may be")
        if name == "response" and values.dtype.kind != "c":
            raise ValueError("response is real; write complex numbers, which have the phase too")
    return {name: values.astype(complex if values.dtype.kind == "c" else float) for name, values in arrays.items()}


def _mat(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    from scipy.io import loadmat, whosmat

    if h5py.is_hdf5(path):  # version 7.3
        return _hdf5(path, names)
    listed = whosmat(path)
    stated = [(name, shape, kind) for name, shape, kind in listed if name in names]
    for name, _, kind in stated:
        if not kind.startswith(NUMBERS_OF_MAT):  # cells and sparse arrays are not read at all
            raise SceneError(f"{name} is not an array of numbers")
    structs = [] if stated else [name for name, _, kind in listed if kind == "struct"]
    if sum(16 * math.prod(shape) for _, shape, _ in stated) + (16 * _unpacked(path) if structs else 0) > UNPACKED_BYTES:
        raise SceneError(f"holds more than {UNPACKED_BYTES // 16} numbers when unpacked")
    _refuse_beyond_memory(sum(math.prod(shape) for _, shape, _ in stated))
    if structs:
        found = loadmat(path, variable_names=structs, simplify_cells=True)
        tables = {name: found[name] for name in structs if isinstance(found[name], dict)}
        arrays = _only_one({name: table for name, table in tables.items() if table.keys() & set(names)})
        return {name: np.asarray(values) for name, values in arrays.items() if name in names}
    arrays = loadmat(path, variable_names=list(names)) if stated else {}
    if not stated:
        raise _none_of(names, [f"{name} ({'x'.join(map(str, shape))} {kind})" for name, shape, kind in listed])
    return {name: values for name, values in arrays.items() if name in names}


def _only_one(groups: dict[str, Any]) -> Any:
    """Return the one group or struct, {} if there are none."""
    if len(groups) > 1:
        raise SceneError(f"the structs {', '.join(groups)} have such arrays; write a file with one of them")
    return next(iter(groups.values()), {})


def _none_of(names: Sequence[str], listed: Sequence[str]) -> SceneError:
    holds = textwrap.shorten(", ".join(listed), 400) or "nothing"
    return SceneError(f"has none of the arrays {', '.join(names)}; it holds {holds}")


def _unpacked(path: Path) -> int:
    """Return the bytes of a MAT file of version 5 when unpacked, up to a limit; variables may be compressed."""
    data, total, at = path.read_bytes(), 0, 128
    order: Literal["little", "big"] = "little" if data[126:128] == b"IM" else "big"
    while at + 8 <= len(data) and total <= UNPACKED_BYTES:
        kind, size = (int.from_bytes(data[at + i : at + i + 4], order) for i in (0, 4))
        if kind == COMPRESSED:
            stream, rest = zlib.decompressobj(), data[at + 8 : at + 8 + size]
            while rest and total <= UNPACKED_BYTES:
                total += len(stream.decompress(rest, 2**20))
                rest = stream.unconsumed_tail
        else:
            total += size
        at += 8 + size
    return total


def _hdf5(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    with h5py.File(path, "r") as file:
        group: h5py.Group = file
        if not any(name in file for name in names):
            groups = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
            found = {name: file[name] for name in groups if isinstance(file[name], h5py.Group)}
            group = _only_one({name: inner for name, inner in found.items() if any(each in inner for each in names)})
            if not group:
                listed = [f"{name} {file[name].shape}" if name not in found else f"{name}/" for name in groups]
                raise _none_of(names, listed)
        datasets = {name: member(group, name, h5py.Dataset) for name in names if name in group}
        for name, dataset in datasets.items():
            if dataset.is_virtual or dataset.external:
                raise SceneError(f"{name} is kept in another file; write its values")
            if dataset.shape is None or dataset.dtype.hasobject:
                raise SceneError(f"{name} is not an array of numbers")
        if sum(dataset.nbytes for dataset in datasets.values()) > UNPACKED_BYTES:
            raise SceneError(f"holds more than {UNPACKED_BYTES} bytes when unpacked")
        _refuse_beyond_memory(sum(dataset.size for dataset in datasets.values()))
        return {name: _complex(dataset[()]) for name, dataset in datasets.items()}


def _refuse_beyond_memory(numbers: int) -> None:
    refuse_beyond_memory(BYTES_A_NUMBER * numbers, f"holds {numbers} numbers")


def _complex(values: np.ndarray) -> np.ndarray:
    """Return numbers for pairs of real and imaginary part, as some programs store them."""
    parts = values.dtype.names or ()
    return np.asarray(values[parts[0]] + 1j * values[parts[1]] if len(parts) == 2 else values)
