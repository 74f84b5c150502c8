"""Named arrays of numbers in files of other programs: MAT files of MATLAB, and HDF5 files such as those of xarray.

Nothing in them is executed. Every array has at most ``MOST_NUMBERS``, and all together ``MOST_EXPANDED`` bytes,
whatever their compressed size in the file.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import h5py
import numpy as np

from warp_plate.result import hdf5
from warp_plate.scene.errors import SceneError

MAT, HDF5 = (".mat",), (".h5", ".hdf5", ".nc")
MOST_NUMBERS, MOST_EXPANDED = 2**24, 2**28
# Variables of a MAT file.
MOST_VARIABLES = 100_000
# MAT files of level 5: bytes of the header; types of elements; flag of complex arrays; classes of numbers.
HEADER, MATRIX, COMPRESSED, COMPLEX, NUMERIC = 128, 14, 15, 0x800, range(6, 16)
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the float64 or complex128 arrays with these names that a MAT or HDF5 file has.

    Args:
        path: File that ends in .mat, .h5, .hdf5 or .nc.
        names: Variables, or datasets at the top of the file.

    Raises:
        ValueError: The file is damaged or none of that kind, has none of the names, or an array is too large or not
            made of numbers.
    """
    try:
        arrays = _mat(path, names) if path.suffix.lower() in MAT else _hdf5(path, names)
    except SceneError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(
            f"cannot be read as a {'MAT' if path.suffix.lower() in MAT else 'HDF5'} file: {error}"
        ) from None
    if not arrays:
        raise ValueError(f"has none of the arrays {', '.join(names)}")
    for name, values in arrays.items():
        if values.dtype.kind not in "fiuc":
            raise ValueError(f"{name} is not an array of numbers")
    return {name: values.astype(complex if values.dtype.kind == "c" else float) for name, values in arrays.items()}


def _mat(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return arrays of a MAT file of level 5; SciPy's reader follows damaged ones beyond its tables, and crashes."""
    if h5py.is_hdf5(path):
        raise SceneError("a MAT file of version 7.3; save it with -v7")
    data, left, arrays = memoryview(path.read_bytes()), MOST_EXPANDED, {}
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126:HEADER]))
    if order is None:
        raise SceneError("cannot be read as a MAT file of version 6 or 7; save it with -v7")
    for count, (kind, body) in enumerate(_elements(data[HEADER:], order)):
        if count == MOST_VARIABLES:
            raise SceneError(f"holds more than {MOST_VARIABLES} variables")
        if kind == COMPRESSED:
            unpacked = zlib.decompressobj().decompress(body, left)
            if (left := left - len(unpacked)) <= 0:
                raise SceneError(f"holds more than {MOST_EXPANDED} bytes when unpacked")
            kind, body = next(_elements(memoryview(unpacked), order), (0, body))
        if kind == MATRIX:
            parts = list(islice(_elements(body, order), 5))
            if len(parts) > 2 and (name := bytes(parts[2][1]).decode("latin-1")) in names:
                arrays[name] = _matrix(name, parts, order)
    return arrays


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield the type and the content of each element of a MAT file of level 5, or of one of its matrices."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        start = place + 8
        if small := kind >> 16:  # up to four bytes, within the eight of the head
            kind, size, start = kind & 0xFFFF, small, place + 4
        if start + size > (place + 8 if small else len(data)):
            raise SceneError("damaged: an array ends too early")
        yield kind, data[start : start + size]
        place = start + size if kind == COMPRESSED else start + size + -(start + size - place) % 8


def _matrix(name: str, parts: Sequence[tuple[int, memoryview]], order: str) -> np.ndarray:
    """Return the values of a matrix from its flags, shape, name, real and imaginary parts."""
    flags, shape = (np.frombuffer(body, f"{order}u4") for _, body in parts[:2])
    values = [np.frombuffer(body, order + NUMBERS[kind]) for kind, body in parts[3:] if kind in NUMBERS]
    if not values or flags[0] & 0xFF not in NUMERIC:
        raise SceneError(f"{name} is not an array of numbers")
    _check_sizes({name: values[0].size})
    complex_ = len(values) == 2 and bool(flags[0] & COMPLEX)
    return (values[0] + 1j * values[1] if complex_ else values[0]).reshape(shape.tolist(), order="F")


def _hdf5(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    with h5py.File(path, "r") as file:
        datasets = {name: hdf5.member(file, name, h5py.Dataset) for name in names if name in file}
        for name, dataset in datasets.items():
            if dataset.is_virtual or dataset.external:
                raise SceneError(f"{name} is kept in another file; write its values")
            if dataset.shape is None or dataset.dtype.hasobject:
                raise SceneError(f"{name} is not an array of numbers")
        sizes = {name: max(math.prod(item.shape), math.prod(item.chunks or ())) for name, item in datasets.items()}
        _check_sizes(sizes)
        if sum(sizes[name] * item.dtype.itemsize for name, item in datasets.items()) > MOST_EXPANDED:
            raise SceneError(f"holds more than {MOST_EXPANDED} bytes when unpacked")
        return {name: _complex(dataset[()]) for name, dataset in datasets.items()}


def _complex(values: np.ndarray) -> np.ndarray:
    """Return numbers for pairs of real and imaginary part, as some programs store them."""
    parts = values.dtype.names or ()
    return np.asarray(values[parts[0]] + 1j * values[parts[1]] if len(parts) == 2 else values)


def _check_sizes(sizes: dict[str, int]) -> None:
    for name, size in sizes.items():
        if size > MOST_NUMBERS:
            raise SceneError(f"{name} has {size} numbers; at most {MOST_NUMBERS} are read")
