"""One HDF5 file a result: plain datasets with units and long names, readable by h5py, MATLAB's h5read, xarray.

    /x, /y, /times, /trace_times         coordinates
    /localization_factor/CASE            scalars, and /localization_factor/bound
    /cases/CASE/magnitude, phase, energy, displacement, trace
    /history/evaluations, best, mean
    attributes of /: command, source, scene (TOML), device, seed, effects, versions, seconds, ...
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from warp_plate.result.model import Case, Result
from warp_plate.result.whole_file import written_whole
from warp_plate.scene.errors import SceneError
from warp_plate.scene.load import dump_scene, parse_scene

HISTORY = {
    "evaluations": "drives tried so far",
    "best": "largest localization factor so far",
    "mean": "mean localization factor of the swarm",
}
FORMAT = "warp-plate result 1"


def save_result(result: Result, path: str | Path) -> Path:
    """Write the file whole or not at all.

    Raises:
        SceneError: the folder is missing or cannot be written to, or the disk is full.
    """
    path = Path(path)
    with written_whole(path) as (temporary,), h5py.File(temporary, "w") as file:
        _write(file, result)
    return path


def load_result(path: str | Path) -> Result:
    """Read what :func:`save_result` wrote.

    Raises:
        SceneError: no such file, not a result of this program, or damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise SceneError(f"{path}: no such file; a result is an .h5 file that localize or simulate wrote")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise SceneError(f"{path}: not a result of warp-plate (no attribute format = {FORMAT!r})")
            return _read(file, str(path))
    except (OSError, KeyError, ValueError, RuntimeError, TypeError, UnicodeDecodeError) as error:
        if isinstance(error, SceneError):
            raise
        reason = " ".join(str(error).split())
        raise SceneError(f"{path}: damaged or not an HDF5 file of this program: {reason}") from None


def _write(file: h5py.File, result: Result) -> None:
    plain = {
        "format": FORMAT,
        "command": result.command,
        "source": result.source,
        "title": result.scene.title,
        "scene": dump_scene(result.scene),
        "device": result.device,
        "evaluator": result.evaluator,
        "effects": json.dumps(list(result.effects)),
        "versions": json.dumps(dict(result.versions)),
        "seconds": json.dumps(dict(result.seconds)),
        "accuracy": json.dumps(dict(result.accuracy)),
    }
    file.attrs.update(plain)
    file.attrs["seed"] = result.seed
    file.attrs["node_steps"] = result.node_steps
    file.attrs["evaluations"] = result.evaluations
    file.attrs["interrupted"] = int(result.interrupted)
    _dataset(file, "x", result.x, "m", "position of the nodes along x")
    _dataset(file, "y", result.y, "m", "position of the nodes along y")
    _dataset(file, "times", result.times, "s", "times of the displacements")
    _dataset(file, "trace_times", result.trace_times, "s", "times of the traces")
    factor = "share of the plate's kinetic energy in the target"
    for name, case in result.cases.items():
        _dataset(file, f"localization_factor/{name}", case.localization_factor, "1", factor)
        _write_case(file, f"cases/{name}", case)
    if result.bound is not None:
        _dataset(file, "localization_factor/bound", result.bound, "1", "largest that any drive can reach")
    for name, values in result.history.items():
        _dataset(file, f"history/{name}", values, "1", f"{HISTORY.get(name, name)}, after each iteration")


def _write_case(file: h5py.File, at: str, case: Case) -> None:
    _dataset(file, f"{at}/magnitude", case.magnitude, "N/m^2", "drive magnitude of each actuator")
    _dataset(file, f"{at}/phase", case.phase, "rad", "drive phase lag of each actuator")
    energy = np.array(list(case.energy.values()))
    _dataset(file, f"{at}/energy", energy, "J", "kinetic energy averaged over the window, for each region")
    file[f"{at}/energy"].attrs["regions"] = json.dumps(list(case.energy))
    _dataset(file, f"{at}/displacement", case.displacement, "m", "displacement (times, y, x)")
    _dataset(file, f"{at}/trace", case.trace, "m", "displacement at the recorded points (points, steps)")


def _dataset(file: h5py.File, name: str, values: object, units: str, long_name: str) -> None:
    file[name] = np.asarray(values)
    file[name].attrs.update({"units": units, "long_name": long_name})


def _read(file: h5py.File, name: str) -> Result:
    text = {key: str(file.attrs[key]) for key in ("command", "source", "device", "evaluator")}
    scene = parse_scene(str(file.attrs["scene"]), f"{name}: its scene")
    cases = {case: _read_case(group) for case, group in file["cases"].items()}
    bound = file.get("localization_factor/bound")
    history: Mapping[str, h5py.Dataset] = file.get("history", {})
    return Result(
        **text,
        scene=scene,
        seed=int(file.attrs["seed"]),
        effects=tuple(json.loads(str(file.attrs["effects"]))),
        cases=cases,
        times=file["times"][()],
        trace_times=file["trace_times"][()],
        seconds=json.loads(str(file.attrs["seconds"])),
        node_steps=int(file.attrs["node_steps"]),
        evaluations=int(file.attrs["evaluations"]),
        bound=None if bound is None else float(bound[()]),
        history={key: values[()] for key, values in history.items()},
        interrupted=bool(file.attrs["interrupted"]),
        versions=json.loads(str(file.attrs["versions"])),
        accuracy=json.loads(str(file.attrs.get("accuracy", "{}"))),
    )


def _read_case(group: h5py.Group) -> Case:
    drive = group["magnitude"][()] * np.exp(-1j * group["phase"][()])
    regions = json.loads(str(group["energy"].attrs["regions"]))
    return Case(
        drive=drive,
        energy=dict(zip(regions, group["energy"][()].tolist(), strict=True)),
        displacement=group["displacement"][()],
        trace=group["trace"][()],
    )
