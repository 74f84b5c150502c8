"""Result files: one HDF5 file for each result, readable by h5py, MATLAB's h5read and xarray; see docs/scene.md.

Beside the fields of :class:`Result` a file holds derived values for other programs: the positions of the nodes, the
localization factors, and the crosstalk between several targets.
"""

from __future__ import annotations

import json
from pathlib import Path

import h5py

from warp_plate.result.crosstalk import crosstalk
from warp_plate.result.hdf5 import Dataset, SceneText, read_fields, write_fields
from warp_plate.result.model import Result
from warp_plate.result.safe_hdf5 import open_hdf5, save_hdf5
from warp_plate.scene.errors import SceneError

FORMAT = "warp-plate result 4"


def save_result(result: Result, path: str | Path) -> Path:
    """Write a result file atomically.

    Raises:
        SceneError: the folder is missing or cannot be written to, or the disk is full.
    """
    path = Path(path)
    save_hdf5(path, FORMAT, lambda file: _write(file, result))
    return path


def load_result(path: str | Path) -> Result:
    """Read a file that :func:`save_result` wrote.

    Raises:
        SceneError: the file is missing, damaged or not a result.
    """
    path = Path(path)
    with open_hdf5(path, FORMAT, "result") as file:
        scene = SceneText().read(file, "scene", {})
        nx, ny = scene.grid.nodes
        result = read_fields(Result, file, {"actuators": len(scene.actuators), "nx": nx, "ny": ny}, scene=scene)
        if not result.cases:
            raise SceneError("cases is missing or empty")
        for name, case in result.cases.items():
            if case.trace.size and case.trace.shape[1] != len(result.trace_times):
                raise SceneError(f"cases/{name}/trace has other steps than trace_times")
        return result


def _write(file: h5py.File, result: Result) -> None:
    robust = result.robust
    value_unit = "weighted" if robust is not None and not robust.localization else "1"
    units = {"drive": result.scene.drive_unit.replace("²", "^2"), "value": value_unit}
    write_fields(file, result, units)
    file.attrs["title"] = result.scene.title
    Dataset("m", "position of the nodes along x").write(file, "x", result.x, units)
    Dataset("m", "position of the nodes along y").write(file, "y", result.y, units)
    factor = Dataset("1", "share of the plate's kinetic energy in the target")
    for name, case in result.cases.items():
        factor.write(file, f"localization_factor/{name}", case.localization_factor, units)
    if result.bound is not None:
        file["localization_factor/bound"].attrs["about"] = result.bound_description
    if result.target_searches:
        shares = Dataset("1", "share of the plate's energy in each target, by each's drive")
        shares.write(file, "crosstalk", crosstalk(result), units)
        file["crosstalk"].attrs["targets"] = json.dumps([target.name for target in result.scene.targets])
