"""Time series of fields for ParaView as a VTKHDF file, written without VTK.

The plate is flat image data in the plane z = 0. Its point data are fields such as ``displacement_best`` [m], and the
fractions of each node's cell that lie in the ``target`` and under the ``actuators``. See "VTKHDF format
specification" (temporal image data) in the VTK documentation.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from warp_plate.plate.weights import REGIONS, region_weights
from warp_plate.result.atomic_io import atomic_paths
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# By the first word of a field's name.
UNITS = {"displacement": "m", "velocity": "m/s", "rms": "m/s", "target": "1", "actuators": "1"}


def write_vtkhdf(scene: Scene, times: np.ndarray, fields: Mapping[str, np.ndarray], path: Path) -> list[Path]:
    """Write all times into one .vtkhdf file, for ParaView 5.12 and later; return its path.

    Args:
        scene: The scene.
        times: (times,) times [s].
        fields: (times, ny, nx) fields, or (1, ny, nx) constant ones, by names that begin with a word of ``UNITS``; the
            first one is active.
        path: The file.

    Raises:
        SceneError: there are no times, or the file cannot be written.
    """
    constant = {name: field[None] for name, field in _constant_fields(scene, times).items()}
    with atomic_paths(path) as (temporary,), h5py.File(temporary, "w") as file:
        root = file.create_group("VTKHDF")
        nx, ny = scene.grid.nodes
        root.attrs["Version"] = np.array([2, 0])
        root.attrs["Type"] = np.bytes_("ImageData")
        root.attrs["WholeExtent"] = np.array([0, nx - 1, 0, ny - 1, 0, 0])
        root.attrs["Origin"] = np.zeros(3)
        root.attrs["Spacing"] = np.array([scene.plate.size[0] / (nx - 1), scene.plate.size[1] / (ny - 1), 1.0])
        root.attrs["Direction"] = np.eye(3).ravel()
        points = root.create_group("PointData")
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = len(times)
        steps["Values"] = times.astype(float)
        offsets = steps.create_group("PointDataOffsets")
        # Arrays are (time, y, x): the format leaves out the axis of a flat image's thickness.
        for name, field in {**fields, **constant}.items():
            points[name] = field.astype("<f4")
            points[name].attrs["units"] = UNITS[name.split("_")[0]]
            offsets[name] = np.minimum(np.arange(len(times)), len(field) - 1)
        # The active array, for older readers and for those of version 2.6 of the format.
        active = next(iter(fields))
        points.attrs["Scalars"] = np.bytes_(active.encode())
        points[active].attrs["Attribute"] = "Scalars"
    return [path]


def _constant_fields(scene: Scene, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return the (ny, nx) covered fractions of each node's cell by name; refuse a series without times."""
    if not len(times):
        raise SceneError("holds no displacements; add record.times = [...] (seconds) to its scene and run it again")
    areas = {str(index): actuator.area for index, actuator in enumerate(scene.actuators)}
    by_overlap = scene.model_copy(update={"grid": scene.grid.model_copy(update={"load": "overlap"})})
    weights = region_weights(by_overlap, areas)
    actuators = np.minimum(weights[len(REGIONS) :].sum(axis=0), 1)
    return {"target": weights[REGIONS.index("target")], "actuators": actuators}
