"""One HDF5 file a result: plain datasets with units and long names, readable by h5py, MATLAB's h5read, xarray.

    /x, /y, /times, /trace_times         coordinates
    /localization_factor/CASE            scalars, and /localization_factor/bound
    /peak_displacement                   scalar
    /cases/CASE/magnitude, phase, energy, displacement, trace
    /cases/CASE/frequency, centre, delay     where the plate had its own
    /history/evaluations, best, mean
    /objectives/KIND, sum, bound         scalars, where more than the localization factor is sought
    /objectives_of/CASE/KIND, sum        the same of other cases
    /crosstalk                           of several targets; /searches/0, ... what was found for each
    /robust/fresh, searched, nominal_plate   of the robust and the nominal drive
    /spectrum/frequency, equal, single, best, resonances
    attributes of /: command, source, scene (TOML), device, seed, effects, versions, seconds, bound_kind, ...

Behind the HDF5 content stands a seal, see ``warp_plate.result.atomic_io``.
"""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np

from warp_plate.result.crosstalk import crosstalk
from warp_plate.result.model import Case, Result, bound_kind
from warp_plate.result.robust import RobustComparison
from warp_plate.result.safe_hdf5 import count, lost_of, names_in, numbers, opened, put, save_hdf5, table, text
from warp_plate.result.several import put_several, read_several
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import OBJECTIVE_UNITS

HISTORY = {
    "evaluations": "drives tried so far",
    "best": "largest localization factor so far",
    "mean": "mean localization factor of the iteration",
}
VALUES = {"sum": "sum of the objectives with their weights", "bound": "of that sum: no drive comes above it"}
SPECTRUM = {
    "frequency": ("Hz", "where the localization factors were taken"),
    "equal": ("1", "localization factor of all actuators alike"),
    "single": ("1", "localization factor of the best single actuator"),
    "best": ("1", "largest localization factor, which no drive that may be chosen passes"),
    "resonances": ("Hz", "natural frequencies of the plate"),
}
# What a plate may have of its own: unit, meaning, and shape after the actuators.
OWN = {
    "frequency": ("Hz", "frequency of each actuator", ()),
    "centre": ("m", "x, y of the middle of each actuator", (2,)),
    "delay": ("s", "start of each actuator's burst", ()),
}
FORMAT = "warp-plate result 3"


def save_result(result: Result, path: str | Path) -> Path:
    """Write the file whole or not at all.

    Raises:
        SceneError: the folder is missing or cannot be written to, or the disk is full.
    """
    path = Path(path)
    save_hdf5(lambda file: _write(file, result), path)
    return path


def load_result(path: str | Path) -> Result:
    """Read what :func:`save_result` wrote.

    Raises:
        SceneError: no such file, not a result of this program, or damaged.
    """
    path = Path(path)
    with opened(path, FORMAT, "result") as file:
        return _read(file, str(path))


def _write(file: h5py.File, result: Result) -> None:
    plain = {
        "format": FORMAT,
        "command": result.command,
        "source": result.source,
        "title": result.scene.title,
        "scene": dump_scene(result.scene),
        "device": result.device,
        "evaluator": result.evaluator,
        "path": result.path,
        "effects": json.dumps(list(result.effects)),
        "versions": json.dumps(dict(result.versions)),
        "seconds": json.dumps(dict(result.seconds)),
        "accuracy": json.dumps(dict(result.accuracy)),
        "lost": json.dumps(dict(result.lost_plates)),
    }
    file.attrs.update(plain)
    file.attrs["seed"] = result.seed
    file.attrs["node_steps"] = result.node_steps
    file.attrs["evaluations"] = result.evaluations
    file.attrs["interrupted"] = int(result.interrupted)
    put(file, "x", result.x, "m", "position of the nodes along x")
    put(file, "y", result.y, "m", "position of the nodes along y")
    put(file, "times", result.times, "s", "times of the displacements")
    put(file, "trace_times", result.trace_times, "s", "times of the traces")
    factor = "share of the plate's kinetic energy in the target"
    for name, case in result.cases.items():
        put(file, f"localization_factor/{name}", case.localization_factor, "1", factor)
        _write_case(file, f"cases/{name}", case, result.scene.drive_unit.replace("²", "^2"))
    if result.peak_displacement is not None:
        put(file, "peak_displacement", result.peak_displacement, "m", "largest displacement seen over the run")
    if result.bound is not None:
        put(file, "localization_factor/bound", result.bound, "1", "largest that any drive can reach")
        file["localization_factor/bound"].attrs["about"] = result.bound_description
    file.attrs["bound_kind"] = result.bound_kind
    for name, values in result.history.items():
        put(file, f"history/{name}", values, "1", f"{HISTORY.get(name, name)}, after each iteration")
    for name, value in result.objective_values.items():
        _put_value(file, f"objectives/{name}", value)
    for drive, worth in result.objective_values_by_case.items():
        for name, value in worth.items():
            _put_value(file, f"objectives_of/{drive}/{name}", value, f", of the drive {drive}")
    for name, values in result.spectrum.items():
        put(file, f"spectrum/{name}", values, *SPECTRUM[name])
    if result.target_searches:
        put_several(file, result.target_searches)
        put(file, "crosstalk", crosstalk(result), "1", "share of the plate's energy in each target, by each's drive")
        file["crosstalk"].attrs["targets"] = json.dumps([target.name for target in result.scene.targets])
    if result.robust is not None:
        _write_comparison(file, result.robust)


def _put_value(file: h5py.File, at: str, value: float, whose: str = "") -> None:
    name = at.rpartition("/")[2]
    put(file, at, value, OBJECTIVE_UNITS.get(name.split()[0], "1"), VALUES.get(name, name) + whose)


def _write_case(file: h5py.File, at: str, case: Case, unit: str) -> None:
    put(file, f"{at}/magnitude", case.magnitude, unit, "drive magnitude of each actuator")
    put(file, f"{at}/phase", case.phase, "rad", "drive phase lag of each actuator")
    energy = np.array(list(case.energy.values()))
    put(file, f"{at}/energy", energy, "J", "kinetic energy averaged over the window, for each region")
    file[f"{at}/energy"].attrs["regions"] = json.dumps(list(case.energy))
    file[f"{at}/energy"].attrs["status"] = case.status
    put(file, f"{at}/displacement", case.displacement, "m", "displacement (times, y, x)")
    put(file, f"{at}/trace", case.trace, "m", "displacement at the recorded points (points, steps)")
    for name, (units, meaning, _) in OWN.items():
        values = getattr(case, name)
        if values is not None:
            put(file, f"{at}/{name}", values, units, meaning)


def _read(file: h5py.File, name: str) -> Result:
    scene = Scene.parse(text(file, "scene"), f"{name}: its scene").in_folder(Path(name).parent)
    times, steps = numbers(file, "times", (None,)), numbers(file, "trace_times", (None,))
    cases = {case: _read_case(file, f"cases/{case}", scene, times, steps) for case in names_in(file, "cases")}
    if not cases:
        raise SceneError("cases is missing or empty")
    factors = names_in(file, "localization_factor")
    return Result(
        command=text(file, "command"),
        source=text(file, "source"),
        path=text(file, "path"),
        scene=scene,
        device=text(file, "device"),
        seed=count(file, "seed"),
        effects=tuple(map(str, table(file, "effects", list))),
        cases=cases,
        times=times,
        trace_times=steps,
        seconds=table(file, "seconds"),
        node_steps=count(file, "node_steps"),
        evaluations=count(file, "evaluations"),
        bound=float(numbers(file, "localization_factor/bound", ())) if "bound" in factors else None,
        bound_kind=bound_kind(text(file, "bound_kind")),
        history={key: numbers(file, f"history/{key}", (None,)) for key in names_in(file, "history")},
        objective_values={key: float(numbers(file, f"objectives/{key}", ())) for key in names_in(file, "objectives")},
        objective_values_by_case={
            case: {key: float(numbers(file, f"{at}/{key}", ())) for key in names_in(file, at)}
            for case, at in ((case, f"objectives_of/{case}") for case in names_in(file, "objectives_of"))
        },
        evaluator=text(file, "evaluator"),
        interrupted=bool(count(file, "interrupted")),
        versions=table(file, "versions"),
        accuracy=table(file, "accuracy"),
        peak_displacement=float(numbers(file, "peak_displacement", ())) if "peak_displacement" in file else None,
        spectrum=_read_spectrum(file),
        target_searches=read_several(file),
        robust=_read_comparison(file),
        lost_plates=lost_of(file),
    )


def _read_spectrum(file: h5py.File) -> dict[str, np.ndarray]:
    if "spectrum" not in file:
        return {}
    frequencies = numbers(file, "spectrum/frequency", (None,))
    lengths = {name: None if name == "resonances" else len(frequencies) for name in SPECTRUM}
    return {name: numbers(file, f"spectrum/{name}", (length,)) for name, length in lengths.items()}


def _read_case(file: h5py.File, at: str, scene: Scene, times: np.ndarray, steps: np.ndarray) -> Case:
    actuators, (nx, ny) = len(scene.actuators), scene.grid.nodes
    magnitude, phase = (numbers(file, f"{at}/{name}", (actuators,)) for name in ("magnitude", "phase"))
    energy = numbers(file, f"{at}/energy", (None,))
    regions = table(file[f"{at}/energy"], "regions", list)
    if not {"plate", "target"} <= set(regions):
        raise SceneError(f"{at}/energy has regions {regions}, without plate or target")
    trace = numbers(file, f"{at}/trace", (None, None))
    if trace.size and trace.shape[1] != len(steps):
        raise SceneError(f"{at}/trace has {trace.shape[1]} steps, trace_times {len(steps)}")
    return Case(
        phasors=magnitude * np.exp(-1j * phase),
        energy=dict(zip(map(str, regions), energy.tolist(), strict=True)),
        displacement=numbers(file, f"{at}/displacement", (len(times), ny, nx)),
        trace=trace,
        status=text(file[f"{at}/energy"], "status"),
        **{
            name: numbers(file, f"{at}/{name}", (actuators, *more))
            for name, (_, _, more) in OWN.items()
            if f"{at}/{name}" in file
        },
    )


def _write_comparison(file: h5py.File, compared: RobustComparison) -> None:
    rows = "of the robust and of the nominal drive"
    unit = "1" if compared.localization else "weighted"
    put(file, "robust/fresh", compared.validation, unit, f"value {rows} in each fresh scenario")
    put(file, "robust/searched", compared.searched, unit, f"measure {rows} over the scenarios of the search")
    put(file, "robust/nominal_plate", compared.nominal_plate, unit, f"value {rows} without scatter")
    if compared.bound is not None:
        put(file, "robust/bound", compared.bound, unit, "of the measure: no drive comes above it")
    group = file["robust"]
    group.attrs.update({"measure": compared.measure, "scenarios": compared.scenarios})
    group.attrs["localization"] = int(compared.localization)


def _read_comparison(file: h5py.File) -> RobustComparison | None:
    if "robust" not in file:
        return None
    group = file["robust"]
    return RobustComparison(
        measure=text(group, "measure"),
        scenarios=count(group, "scenarios"),
        localization=bool(count(group, "localization")),
        bound=float(numbers(file, "robust/bound", ())) if "bound" in group else None,
        searched=numbers(file, "robust/searched", (2,)),
        nominal_plate=numbers(file, "robust/nominal_plate", (2,)),
        validation=numbers(file, "robust/fresh", (2, None)),
    )
