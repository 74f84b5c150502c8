"""The state of a search in an HDF5 file, whatever its method: each array a dataset, all the rest JSON.

A state is a flat dictionary. Its ``history`` has a row for each iteration; its ``settings`` are not kept: they follow
from the scene.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from warp_plate.result.safe_hdf5 import names_in, numbers, table

SETTINGS, SHAPES, NUMBERS = "settings", "shapes", "numbers"


def put_state(file: h5py.File, name: str, state: Mapping[str, Any]) -> None:
    """Write the state as the group ``name``."""
    group = file.create_group(name)
    rest = {}
    for key, value in state.items():
        if isinstance(value, np.ndarray):
            group[key] = value
        elif key != SETTINGS:
            rest[key] = value
    group.attrs[SHAPES] = json.dumps({key: group[key].shape for key in group})
    group.attrs[NUMBERS] = json.dumps(rest)


def read_state(file: h5py.File, name: str) -> dict[str, Any]:
    """What :func:`put_state` wrote.

    Raises:
        SceneError: not plain numbers in this file itself. (Whether they fit the search its ``from_state`` says.)
    """
    names_in(file, name)
    arrays = {key: numbers(file, f"{name}/{key}", tuple(shape)) for key, shape in table(file[name], SHAPES).items()}
    return {**table(file[name], NUMBERS), **arrays}
