"""A sweep's figures in one HDF5 file, laid out as netCDF-4 lays out its own, so that xarray opens it by name:

    /KEY                   of a grid: a dimension with the values of each varied key, such as /drive.frequency
    /sample, /KEY          of samples: their numbers, and the value of each key in every one
    /OUTPUT                a figure at every point (grid or sample, and the output's own axis); NaN where there is none
    /status                0 not run yet, 1 run, 2 refused
    /reason                why a point was refused
    attributes of /: source, scene (TOML), what, count, keys, outputs, seconds, versions, ...

Behind the HDF5 content stands a seal, see ``warp_plate.result.atomic_io``. An unfinished sweep is the same file with
points that are not run yet; it goes on from there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_plate.result.safe_hdf5 import count, numbers, opened, put, save_hdf5, table, text, texts
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import label_of, numeric_keys, unit_of
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import MOST_POINTS, Plan, counted

FORMAT = "warp-plate sweep 1"
NOT_RUN, RUN, REFUSED = 0, 1, 2


@dataclass(frozen=True)
class SweepOutput:
    """A figure of every point: its unit, its meaning, and the axis that it has of its own, None: it is one number."""

    unit: str
    meaning: str
    axis: str | None = None


@dataclass(frozen=True)
class Sweep:
    """What was found at the points of a plan.

    scene: as written, before anything is varied; source: its name; files: SHA-256 of the files that it names, by key.
    what: of ``QUANTITIES``; count: length of the outputs' own axis. device, processor: what points were
    run on last, as who ran them says, "" while no worker has said it; earlier, path: as in :class:`Checkpoint`.
    values: of each output (points,), or (points, count) where it has an axis. status: (points,); reasons: why points
    were refused, by point. seconds: spent on points so far.
    """

    source: str
    scene: Scene
    files: Mapping[str, str]
    plan: Plan
    what: str
    count: int
    device: str
    processor: str
    earlier_devices: str
    path: str
    outputs: Mapping[str, SweepOutput]
    values: Mapping[str, np.ndarray]
    status: np.ndarray
    reasons: Mapping[int, str]
    seconds: float
    versions: Mapping[str, str]

    @property
    def pending(self) -> np.ndarray:
        """Points that are not run yet."""
        return np.flatnonzero(self.status == NOT_RUN)

    @property
    def finished(self) -> bool:
        """Whether no point is left."""
        return not len(self.pending)

    @property
    def progress(self) -> str:
        """For people."""
        return f"{len(self.plan) - len(self.pending)} of {counted(len(self.plan), 'point')}"

    @property
    def devices_used(self) -> str:
        """For people: each device that points were run on, with its processor."""
        return f"{self.earlier_devices}{self.device} ({self.processor})"

    def moved_to(self, device: str, processor: str) -> Sweep:
        """The sweep whose next points run there; another processor than before is kept with those before it."""
        moved = self.processor not in ("", processor)
        earlier = f"{self.devices_used}, then " if moved else self.earlier_devices
        return replace(self, device=device, processor=processor, earlier_devices=earlier)

    @property
    def keys_without_effect(self) -> tuple[str, ...]:
        """Keys whose values change no figure, to the last bit; of samples, where all change at once, all or none."""
        figures, plan = [self.shaped(name) for name in self.outputs], self.plan
        if plan.sampled:
            return plan.keys if len(plan) > 1 and all(_alike(one, 0) for one in figures) else ()
        return tuple(
            key
            for axis, key in enumerate(plan.keys)
            if plan.shape[axis] > 1 and all(_alike(one, axis) for one in figures)
        )

    def refusal(self, point: int) -> str:
        """For people: the numbers of a refused point and its reason, which may begin with them."""
        at = ", ".join(f"{key} = {value:.6g}" for key, value in self.plan.numbers(point).items())
        reason = self.reasons[point]
        return reason if reason.startswith(f"{at}: ") else f"at {at}: {reason}"

    def shaped(self, output: str) -> np.ndarray:
        """The values of an output in the shape of the plan, and after it the output's own axis."""
        values = self.values[output]
        return values.reshape(*self.plan.shape, *values.shape[1:])


def save_sweep(sweep: Sweep, path: str | Path) -> Path:
    """Write the file whole or not at all.

    Raises:
        SceneError: the folder is missing or cannot be written to, or the disk is full.
    """
    path = Path(path)
    save_hdf5(lambda file: _write(file, sweep), path)
    return path


def load_sweep(path: str | Path) -> Sweep:
    """Read what :func:`save_sweep` wrote.

    Raises:
        SceneError: no such file, not a sweep of this program, or damaged.
    """
    path = Path(path)
    with opened(path, FORMAT, "sweep") as file:
        scene = Scene.parse(text(file, "scene"), f"{path}: its scene").in_folder(path.parent)
        return _read(file, scene)


def _write(file: h5py.File, sweep: Sweep) -> None:
    plan, scene = sweep.plan, sweep.scene
    for name in ("source", "what", "count", "device", "processor", "path", "seconds"):
        file.attrs[name] = getattr(sweep, name)
    file.attrs["earlier"] = sweep.earlier_devices
    file.attrs.update(
        {
            "format": FORMAT,
            "title": scene.title,
            "scene": dump_scene(scene),
            "files": json.dumps(dict(sweep.files)),
            "versions": json.dumps(dict(sweep.versions)),
            "keys": json.dumps(plan.keys),
            "logarithmic": json.dumps(plan.logarithmic),
            "outputs": json.dumps({name: vars(one) for name, one in sweep.outputs.items()}),
            "finished": int(sweep.finished),
        }
    )
    if plan.sampled:
        _put_axis(file, "sample", np.arange(len(plan)), "1", "number of the sample")
    for key, values in zip(plan.keys, plan.coordinates, strict=True):
        unit, words = _in_ascii(unit_of(scene, key)), label_of(scene, key)
        if plan.sampled:
            put(file, key, values, unit, words)
            file[key].dims[0].attach_scale(file["sample"])
        else:
            _put_axis(file, key, values, unit, words)
    axes = ("sample",) if plan.sampled else plan.keys
    for axis in dict.fromkeys(one.axis for one in sweep.outputs.values() if one.axis):
        _put_axis(file, axis, np.arange(1, sweep.count + 1), "1", f"number of the {axis}")
    for name, output in sweep.outputs.items():
        own = [output.axis] if output.axis else []
        _put_on(file, name, sweep.shaped(name), output.unit, output.meaning, [*axes, *own])
    _put_on(file, "status", sweep.status.astype("i1").reshape(plan.shape), "1", "what became of the point", axes)
    file["status"].attrs["flag_values"] = np.array([NOT_RUN, RUN, REFUSED], dtype="i1")
    file["status"].attrs["flag_meanings"] = "not_run run refused"
    reasons = np.array([sweep.reasons.get(point, "") for point in range(len(plan))], dtype=h5py.string_dtype())
    _put_on(file, "reason", reasons.reshape(plan.shape), "1", "why the point was refused", axes)
    if plan.sampled:
        for name in (*sweep.outputs, "status", "reason"):
            file[name].attrs["coordinates"] = " ".join(plan.keys)


def _put_axis(file: h5py.File, name: str, values: np.ndarray, unit: str, words: str) -> None:
    put(file, name, values, unit, words)
    file[name].make_scale(name)


def _put_on(
    file: h5py.File, name: str, values: np.ndarray, unit: str, words: str, axes: list[str] | tuple[str, ...]
) -> None:
    put(file, name, values, unit, words)
    for index, axis in enumerate(axes):
        file[name].dims[index].attach_scale(file[axis])


def _alike(values: np.ndarray, axis: int) -> bool:
    """Whether values are the same all along an axis."""
    return np.array_equal(values, np.broadcast_to(values.take([0], axis), values.shape), equal_nan=True)


def _in_ascii(unit: str) -> str:
    """As other programs read units."""
    return unit.replace("²", "^2").replace("³", "^3").replace("·", "*")


def _read(file: h5py.File, scene: Scene) -> Sweep:
    keys, logarithmic = tuple(map(str, table(file, "keys", list))), table(file, "logarithmic", list)
    unknown = [key for key in keys if key not in numeric_keys(scene)]
    if not keys or unknown or len(logarithmic) != len(keys):
        raise SceneError(f"keys {list(keys)} do not fit the scene")
    sampled = "sample" in file
    samples = len(numbers(file, "sample", (None,))) if sampled else None
    coordinates = tuple(numbers(file, key, (samples,)) for key in keys)
    plan = Plan(keys, coordinates, tuple(map(bool, logarithmic)), sampled)
    if not 1 <= len(plan) <= MOST_POINTS:
        raise SceneError(f"{len(plan)} points")
    length = count(file, "count")
    outputs = {str(name): _output(one) for name, one in table(file, "outputs").items()}
    values = {}
    for name, one in outputs.items():
        own = (length,) if one.axis else ()
        values[name] = numbers(file, name, (*plan.shape, *own)).reshape(len(plan), *own)
    status = numbers(file, "status", plan.shape).ravel()
    if not np.isin(status, (NOT_RUN, RUN, REFUSED)).all():
        raise SceneError("status holds other numbers than 0, 1 and 2")
    refused = np.flatnonzero(status == REFUSED)
    places = zip(*(axis.tolist() for axis in np.unravel_index(refused, plan.shape)), strict=True)
    reasons = texts(file, "reason", plan.shape, places)
    return Sweep(
        source=text(file, "source"),
        scene=scene,
        files=table(file, "files"),
        plan=plan,
        what=text(file, "what"),
        count=length,
        device=text(file, "device"),
        processor=text(file, "processor"),
        earlier_devices=text(file, "earlier"),
        path=text(file, "path"),
        outputs=outputs,
        values=values,
        status=status,
        reasons=dict(zip(refused.tolist(), reasons, strict=True)),
        seconds=float(file.attrs["seconds"]),
        versions=table(file, "versions"),
    )


def _output(said: Any) -> SweepOutput:
    unit, meaning, axis = (said[name] for name in ("unit", "meaning", "axis"))
    if not isinstance(unit, str) or not isinstance(meaning, str) or not isinstance(axis, str | None):
        raise SceneError("attribute outputs has no unit, meaning or axis")
    return SweepOutput(unit, meaning, axis)
