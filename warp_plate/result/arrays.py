"""Named arrays of numbers in files of other programs: MAT files of MATLAB, and HDF5 files such as those of xarray.

Nothing in them is executed. Every array has at most ``MOST_NUMBERS``, whatever its compressed size in the file.
"""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from warp_plate.result import hdf5
from warp_plate.scene.errors import SceneError

MAT, HDF5 = (".mat",), (".h5", ".hdf5", ".nc")
MOST_NUMBERS, MOST_EXPANDED = 2**24, 2**28
# Of MAT files of level 5: bytes of the header, and the type of a compressed element.
HEADER, COMPRESSED = 128, 15


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the arrays of real or complex numbers with these names that a MAT or HDF5 file has.

    Args:
        path: File that ends in .mat, .h5, .hdf5 or .nc.
        names: Variables, or datasets at the top of the file.

    Raises:
        ValueError: The file is damaged or none of that kind, has none of the names, or an array is too large or not
            made of numbers.
    """
    try:
        found = _mat(path, names) if path.suffix.lower() in MAT else _hdf5(path, names)
    except NotImplementedError:
        raise ValueError("a MAT file of version 7.3; save it with -v7") from None
    except SceneError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(
            f"cannot be read as a {'MAT' if path.suffix.lower() in MAT else 'HDF5'} file: {error}"
        ) from None
    if not found:
        raise ValueError(f"has none of the arrays {', '.join(names)}")
    for name, values in found.items():
        if values.dtype.kind not in "fiuc":
            raise ValueError(f"{name} is not an array of numbers")
    return found


def _mat(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    import scipy.io

    data = path.read_bytes()
    _check_expanded(data)
    sizes = {name: math.prod(shape) for name, shape, _ in scipy.io.whosmat(io.BytesIO(data)) if name in names}
    _check_sizes(sizes)
    found = scipy.io.loadmat(io.BytesIO(data), variable_names=list(sizes))
    return {name: np.asarray(found[name]) for name in sizes}


def _check_expanded(data: bytes) -> None:
    """Raise a SceneError if the compressed elements of a MAT file of level 5 hold too much."""
    order, place, left = "<" if data[126:128] == b"IM" else ">", HEADER, MOST_EXPANDED
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        if kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            left -= len(unpacker.decompress(data[place + 8 : place + 8 + size], left))
            if left <= 0:
                raise SceneError(f"holds more than {MOST_EXPANDED} bytes when unpacked")
        place += 8 + size


def _hdf5(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    with h5py.File(path, "r") as file:
        found = {name: hdf5.member(file, name, h5py.Dataset) for name in names if name in file}
        for name, dataset in found.items():
            if dataset.is_virtual or dataset.external:
                raise SceneError(f"{name} is kept in another file; write its values")
        _check_sizes({name: max(math.prod(item.shape), math.prod(item.chunks or ())) for name, item in found.items()})
        return {name: _complex(dataset[()]) for name, dataset in found.items()}


def _complex(values: np.ndarray) -> np.ndarray:
    """Return numbers for pairs of real and imaginary part, as some programs store them."""
    parts = values.dtype.names or ()
    return np.asarray(values[parts[0]] + 1j * values[parts[1]] if len(parts) == 2 else values)


def _check_sizes(sizes: dict[str, int]) -> None:
    for name, size in sizes.items():
        if size > MOST_NUMBERS:
            raise SceneError(f"{name} has {size} numbers; at most {MOST_NUMBERS} are read")
