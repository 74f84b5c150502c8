"""Files of this program with other content, under a right seal."""

import h5py
import numpy as np

from warp_plate.result.atomic_io import SEAL_BYTES, make_seal

# Replacements of attributes and items of JSON.
VALUES = [None, True, -1, 0, 99, 2**62, 10**400, 1.5, float("nan"), float("inf"), "", "a", "NaN", "9" * 30, [], [1], {}]
# Replacements of datasets, by their content; those of texts get zeros.
ARRAYS = {
    "nan": lambda values: np.full(values.shape, np.nan),
    "one nan": lambda values: np.where(np.arange(values.size).reshape(values.shape) == 0, np.nan, values),
    "inf": lambda values: np.full(values.shape, np.inf),
    "huge": lambda values: np.full(values.shape, 1e300),
    "half": lambda values: values.astype(np.float16),
    "quadruple": lambda values: values.astype(np.longdouble),
    "negative": lambda values: -1.0 - np.abs(values),
    "empty": lambda values: np.zeros((0,) * max(values.ndim, 1)),
    "longer": lambda values: np.zeros(tuple(length + 1 for length in values.shape) or (2,)),
    "twice": lambda values: np.concatenate([np.atleast_1d(values)] * 2),
    "text": lambda values: "abc",
    "complex": lambda values: np.full(values.shape, 1j),
}


def forge(path, change):
    """Write the file beside ``path`` that ends in .right, after ``change(file)`` and under a new seal, to ``path``."""
    path.write_bytes(path.with_suffix(".right").read_bytes()[:-SEAL_BYTES])
    with h5py.File(path, "r+") as file:
        change(file)
    changed = path.read_bytes()
    path.write_bytes(changed + make_seal(changed))


def places(path):
    """Return the (object, attribute) of all attributes and the (object, None) of all datasets, but for ``format``."""
    found = []

    def visit(name, item):
        found.extend((name, key) for key in item.attrs if key not in ("format", "units", "long_name"))
        if isinstance(item, h5py.Dataset):
            found.append((name, None))

    with h5py.File(path, "r") as file:
        visit("/", file)
        file.visititems(visit)
    return sorted(found, key=str)


def set_attribute(item, key, value):
    """Replace an attribute; what HDF5 cannot keep becomes a text."""
    del item.attrs[key]
    try:
        item.attrs[key] = value
    except (TypeError, OverflowError, ValueError):
        item.attrs[key] = str(value)


def set_dataset(file, name, values):
    """Replace a dataset, with its attributes."""
    attributes = dict(file[name].attrs)
    del file[name]
    file[name] = values
    file[name].attrs.update({key: attributes[key] for key in ("units", "long_name") if key in attributes})


def forge_place(path, place, value, way):
    """Replace one attribute of a file by a value, or one dataset in a way of ``ARRAYS``; ``place`` counts them."""
    known = places(path.with_suffix(".right"))
    name, key = known[place % len(known)]

    def change(file):
        if key is None:
            values = np.asarray(file[name][()])
            set_dataset(file, name, ARRAYS[way](np.zeros(values.shape) if values.dtype.kind in "OS" else values))
        else:
            set_attribute(file[name], key, value)

    forge(path, change)
