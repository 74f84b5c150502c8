"""Named arrays of numbers in files of other programs: MAT files of MATLAB, and HDF5 files such as those of xarray."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from warp_plate.result import hdf5
from warp_plate.scene.errors import SceneError

MAT, HDF5 = (".mat",), (".h5", ".hdf5", ".nc")
MOST_BYTES = 2**28  # of the arrays of an HDF5 file, which may be compressed


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the float64 or complex128 arrays with these names that a MAT or HDF5 file has.

    Args:
        path: File that ends in .mat, .h5, .hdf5 or .nc.
        names: Variables, or datasets at the top of the file.

    Raises:
        ValueError: The file is damaged or none of that kind, has none of the names, or an array is too large or not
            made of numbers.
    """
    kind, read = ("MAT", _mat) if path.suffix.lower() in MAT else ("HDF5", _hdf5)
    try:
        arrays = read(path, names)
    except SceneError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # of many kinds, for files of any content
        raise ValueError(f"cannot be read as a {kind} file: {error}") from None
    if not arrays:
        raise ValueError(f"has none of the arrays {', '.join(names)}")
    for name, values in arrays.items():
        if values.dtype.kind not in "fiuc":
            raise ValueError(f"{name} is not an array of numbers")
    return {name: values.astype(complex if values.dtype.kind == "c" else float) for name, values in arrays.items()}


def _mat(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    from scipy.io import loadmat

    if h5py.is_hdf5(path):
        raise SceneError("a MAT file of version 7.3; save it with -v7")
    arrays = loadmat(path, variable_names=list(names))
    return {name: values for name, values in arrays.items() if name in names}


def _hdf5(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    with h5py.File(path, "r") as file:
        datasets = {name: hdf5.member(file, name, h5py.Dataset) for name in names if name in file}
        for name, dataset in datasets.items():
            if dataset.is_virtual or dataset.external:
                raise SceneError(f"{name} is kept in another file; write its values")
            if dataset.shape is None or dataset.dtype.hasobject:
                raise SceneError(f"{name} is not an array of numbers")
        if sum(dataset.nbytes for dataset in datasets.values()) > MOST_BYTES:
            raise SceneError(f"holds more than {MOST_BYTES} bytes when unpacked")
        return {name: _complex(dataset[()]) for name, dataset in datasets.items()}


def _complex(values: np.ndarray) -> np.ndarray:
    """Return numbers for pairs of real and imaginary part, as some programs store them."""
    parts = values.dtype.names or ()
    return np.asarray(values[parts[0]] + 1j * values[parts[1]] if len(parts) == 2 else values)
