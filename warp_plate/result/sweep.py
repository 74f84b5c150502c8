"""Sweep files: HDF5 files laid out as netCDF-4 lays out its own, which xarray opens with named dimensions and units.

    /KEY                   of a grid: a dimension with the values of each varied key, such as /drive.frequency
    /sample, /KEY          of samples: a dimension with their numbers, and the value of each key in every sample
    /mode, /frequency      a dimension with the values of the outputs' own axis
    /OUTPUT                an output at every point (grid or sample, and the output's axis if it has one)
    /status                0 not run yet, 1 run, 2 refused
    /reason                why a point was refused

An unfinished sweep is the same file with points that are not run yet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import h5py
import numpy as np

from warp_plate.result import hdf5, layouts
from warp_plate.scene.errors import SceneError, check_type
from warp_plate.scene.keys import label_of, scalar_keys, unit_of
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import MOST_POINTS, Plan, counted, parse_frequencies, value_text

FORMAT = hdf5.FileFormat("sweep", 2)
KEYS = layouts.Attribute(tuple[str, ...])
LOGARITHMIC = layouts.Attribute(tuple[bool, ...])
OUTPUTS = layouts.Attribute(Mapping[str, Mapping[str, str | None]])
NOT_RUN, RUN, REFUSED = 0, 1, 2


@dataclass(frozen=True)
class SweepOutput:
    """A quantity that a sweep computes at every point."""

    unit: str
    meaning: str
    axis: Literal["mode", "frequency"] | None = None  # further axis of the output; None for one number per point


@dataclass(frozen=True, eq=False)
class Sweep:
    """Outputs of a command at the points of a plan."""

    source: str
    scene: Scene  # as written, before anything is varied
    files: Mapping[str, str]  # SHA-256 digests of the files that the scene names, by their keys
    plan: Annotated[Plan, layouts.ELSEWHERE]
    what: str  # name of the set of outputs, such as "localize"
    count: int  # number of modes, if these are an axis of outputs
    frequencies: str  # range of frequencies, if these are an axis of outputs, written as for ``--vary``; else empty
    device: str  # of the last points; "" until the first worker reports one
    processor: str  # model of the device's processor; "" likewise
    earlier_devices: Annotated[str, "earlier"]  # other devices that points were run on before, for people
    path: str
    evaluator: str  # "modal" or "direct"
    outputs: Annotated[Mapping[str, SweepOutput], layouts.ELSEWHERE]
    # (points,) or (points, axis) values of each output; NaN where a point is not run or refused
    values: Annotated[Mapping[str, np.ndarray], layouts.ELSEWHERE]
    status: Annotated[np.ndarray, layouts.ELSEWHERE]  # (points,) ``NOT_RUN``, ``RUN`` or ``REFUSED``
    reasons: Annotated[Mapping[int, str], layouts.ELSEWHERE]  # why points were refused, by point
    seconds: float  # wall time spent on points so far [s]
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        return f"<Sweep {self.what} over {', '.join(self.plan.keys)}: {self.progress}>"

    def along(self, axis: str) -> np.ndarray:
        """Return the values of an axis of outputs: numbers of modes, or frequencies [Hz]."""
        return np.arange(1, self.count + 1) if axis == "mode" else parse_frequencies(self.frequencies)

    def columns(self, output: str) -> dict[str, np.ndarray]:
        """Return the numbers (points,) that stand for an output in tables and pictures, by the end of its heading:
        each mode, or the largest over all frequencies."""
        values, axis = self.values[output], self.outputs[output].axis
        if axis == "mode":
            return {f" {index}": column for index, column in enumerate(values.T, 1)}
        return {"": values} if axis is None else {", largest": values.max(axis=1)}

    @property
    def pending(self) -> np.ndarray:
        """Indices of the points that are not run yet."""
        return np.flatnonzero(self.status == NOT_RUN)

    @property
    def finished(self) -> bool:
        return not len(self.pending)

    @property
    def progress(self) -> str:
        """Description of the progress, for people."""
        return f"{len(self.plan) - len(self.pending)} of {counted(len(self.plan), 'point')}"

    @property
    def devices_used(self) -> str:
        """Devices that points were run on, with their processors, for people."""
        return f"{self.earlier_devices}{self.device} ({self.processor})"

    def moved_to(self, device: str, processor: str) -> Sweep:
        """Return the sweep with its next points on a device; a change of processor is recorded."""
        changed = self.processor not in ("", processor)
        earlier = f"{self.devices_used}, then " if changed else self.earlier_devices
        return replace(self, device=device, processor=processor, earlier_devices=earlier)

    @property
    def keys_without_effect(self) -> tuple[str, ...]:
        """Keys that change no output to the last bit; of samples, where all keys change at once, all or none."""
        outputs, plan = [self.shaped(name) for name in self.outputs], self.plan
        constant = [
            length > 1 and all(np.array_equal(o, np.roll(o, 1, axis), equal_nan=True) for o in outputs)
            for axis, length in enumerate(plan.shape)
        ]
        return tuple(key for axis, key in enumerate(plan.keys) if constant[0 if plan.sampled else axis])

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        if not self.finished:
            return (f"interrupted: {self.progress}",)
        return tuple(f"{key} has no effect on the results" for key in self.keys_without_effect)

    def refusal(self, point: int) -> str:
        """Return the values of a refused point and the reason, for people."""
        place = ", ".join(f"{key} = {value_text(value, 6)}" for key, value in self.plan.values(point).items())
        reason = self.reasons[point]
        return reason if reason.startswith(f"{place}: ") else f"at {place}: {reason}"

    def shaped(self, output: str) -> np.ndarray:
        """Return the values of an output in the shape of the plan, followed by the output's own axis."""
        return self.values[output].reshape(*self.plan.shape, *self.values[output].shape[1:])


def save_sweep(sweep: Sweep, path: str | Path) -> Path:
    """Write a sweep file atomically and return its path, or raise a SceneError."""
    check_type("sweep", sweep, Sweep)
    plan, scene = sweep.plan, sweep.scene
    with FORMAT.create(path) as file:
        layouts.write_fields(file, sweep)
        file.attrs["title"] = scene.title
        KEYS.write(file, "keys", plan.keys)
        LOGARITHMIC.write(file, "logarithmic", plan.logarithmic)
        OUTPUTS.write(file, "outputs", {name: asdict(output) for name, output in sweep.outputs.items()})
        layouts.Attribute(bool).write(file, "finished", sweep.finished)
        axes = ["sample"] if plan.sampled else plan.keys
        if plan.sampled:
            hdf5.write_along(file, "sample", np.arange(len(plan)), "1", "number of the sample")
        for key, values in zip(plan.keys, plan.coordinates, strict=True):
            unit = unit_of(scene, key).replace("²", "^2").replace("³", "^3").replace("·", "*")
            values = values.astype(h5py.string_dtype()) if values.dtype.kind == "U" else values
            hdf5.write_along(file, key, values, unit, label_of(scene, key), axes if plan.sampled else ())
        for axis in dict.fromkeys(output.axis for output in sweep.outputs.values() if output.axis):
            unit, meaning = ("1", "number of the mode") if axis == "mode" else ("Hz", "frequency")
            hdf5.write_along(file, axis, sweep.along(axis), unit, meaning)
        for name, output in sweep.outputs.items():
            dimensions = [*axes, *filter(None, [output.axis])]
            hdf5.write_along(file, name, sweep.shaped(name), output.unit, output.meaning, dimensions)
        status = sweep.status.astype("i1").reshape(plan.shape)
        hdf5.write_along(file, "status", status, "1", "what became of the point", axes)
        file["status"].attrs["flag_values"] = np.array([NOT_RUN, RUN, REFUSED], dtype="i1")
        file["status"].attrs["flag_meanings"] = "not_run run refused"
        reasons = np.array([sweep.reasons.get(point, "") for point in range(len(plan))], dtype=h5py.string_dtype())
        hdf5.write_along(file, "reason", reasons.reshape(plan.shape), "1", "why the point was refused", axes)
        if plan.sampled:
            for name in (*sweep.outputs, "status", "reason"):
                file[name].attrs["coordinates"] = " ".join(plan.keys)
    return Path(path)


def load_sweep(path: str | Path) -> Sweep:
    """Read a sweep, or raise a SceneError if the file is missing, damaged or not a sweep."""
    with FORMAT.open(path) as file:
        scene = layouts.SceneText().read(file, "scene", {})
        plan = _read_plan(file, scene)
        outputs = {name: SweepOutput(**entry) for name, entry in OUTPUTS.read(file, "outputs", {}).items()}
        status = hdf5.read_array(file, "status", plan.shape).ravel()
        if not np.isin(status, (NOT_RUN, RUN, REFUSED)).all():
            raise SceneError("status must hold 0, 1 or 2 for each point: not run, run or refused")
        texts = hdf5.read_array(file, "reason", plan.shape, text=True).ravel()
        reasons = {point: str(texts[point]) for point in np.flatnonzero(status == REFUSED).tolist()}
        sweep = layouts.read_fields(
            Sweep, file, scene=scene, plan=plan, outputs=outputs, values={}, status=status, reasons=reasons
        )
        values = {}
        for name, output in outputs.items():
            further = (len(sweep.along(output.axis)),) if output.axis else ()
            values[name] = hdf5.read_array(file, name, (*plan.shape, *further)).reshape(len(plan), *further)
        return replace(sweep, values=values)


def _read_plan(file: h5py.File, scene: Scene) -> Plan:
    keys, logarithmic = KEYS.read(file, "keys", {}), LOGARITHMIC.read(file, "logarithmic", {})
    kinds = scalar_keys(scene)
    if not keys or not set(keys) <= set(kinds) or len(logarithmic) != len(keys):
        raise SceneError(f"keys {list(keys)} do not fit the scene")
    sampled = "sample" in file
    samples = len(hdf5.read_array(file, "sample", (None,))) if sampled else None
    coordinates = (hdf5.read_array(file, key, (samples,), text=kinds[key] is str) for key in keys)
    # Texts are read as objects.
    values = (column.astype(str) if column.dtype.kind == "O" else column for column in coordinates)
    plan = Plan(keys, tuple(values), logarithmic, sampled)
    if not 1 <= len(plan) <= MOST_POINTS:
        raise SceneError(f"the sweep has {len(plan)} points")
    return plan
