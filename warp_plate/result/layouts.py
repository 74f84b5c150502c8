"""Layouts of data classes in HDF5 files, by the annotations of their fields.

    str, bool, int, float, Literal     attribute
    Scene                              attribute, TOML text
    Mapping or tuple of these          attribute, JSON text
    data class                         group
    Mapping or tuple of data classes   group of groups, named by key or 0, 1, 2, ...
    X | None                           absent if None

Fields with another layout, all arrays among them, or with another name in the file say so in their annotation:
``Annotated[np.ndarray, Dataset("s", "times of the traces", ("trace_times",))]``. Dimensions are stored as netCDF-4
stores them, as scales: datasets of the same name in the group of the dataset or in one above.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import h5py
import numpy as np

from warp_plate.result.hdf5 import full_path, member, read_array, read_attribute, write_along, write_array
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, Count, as_kind
from warp_plate.scene.model import Scene

T = TypeVar("T")
Sizes = dict[str, int]  # lengths of named dimensions, as far as known
Counts = Mapping[str, Count]


def write_fields(group: h5py.Group, value: Any) -> None:
    """Write the fields of a data class instance into a group, except those with the layout ``ELSEWHERE``."""
    for attribute, name, layout, _ in _fields(type(value)):
        content = getattr(value, attribute)
        if layout is not ELSEWHERE and content is not None:
            layout.write(group, name, content)


def read_fields(cls: type[T], group: h5py.Group, sizes: Sizes | None = None, **given: Any) -> T:
    """Return an instance of a data class with the fields ``given`` and those that :func:`write_fields` wrote.

    Lengths of named dimensions are those in ``sizes``, or set by the scene, or else by the first dataset.
    """
    sizes = dict(sizes or {})
    for attribute, name, layout, optional in _fields(cls):
        if attribute not in given:
            absent = optional and name not in group and name not in group.attrs
            given[attribute] = None if absent else layout.read(group, name, sizes)
    return cls(**given)


def _fields(cls: type) -> Iterator[tuple[str, str, Layout, bool]]:
    """Yield attribute, name in the file, layout and optionality of each field of a data class."""
    hints = get_type_hints(cls, include_extras=True)
    for item in dataclasses.fields(cls):
        hint = hints[item.name]
        hint, *extras = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        name = next((extra for extra in extras if isinstance(extra, str)), item.name)
        layout = next((extra for extra in extras if isinstance(extra, Layout)), _default_layout(kinds[0]))
        yield item.name, name, layout, NoneType in kinds


def _default_layout(kind: Any) -> Layout:
    if kind is Scene:
        return SceneText()
    classes = [part for part in (kind, *get_args(kind)) if isinstance(part, type) and dataclasses.is_dataclass(part)]
    return Groups(classes[0], get_origin(kind)) if classes else Attribute(kind)


class Layout:
    """Form of a field in a group; ``read`` raises a SceneError if the value is missing or not as it should be."""

    def write(self, group: h5py.Group, name: str, value: Any) -> None:
        raise NotImplementedError

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        raise NotImplementedError


# The layout of fields that the module of their file writes and reads itself.
ELSEWHERE = Layout()


@dataclass(frozen=True)
class Attribute(Layout):
    """An attribute with a value of an annotated kind, of the group or of the dataset before a slash in its name.

    Mappings and tuples are JSON text; integers are 0 or more.
    """

    kind: Any

    def write(self, group: h5py.Group, name: str, value: Any) -> None:
        parent, _, key = name.rpartition("/")
        if get_origin(self.kind) in (Mapping, tuple):
            value = json.dumps(value, default=dict)
        if isinstance(value, str):  # names of files need not be UTF-8
            value = value.encode(errors="backslashreplace").decode()
        (group[parent] if parent else group).attrs[key] = int(value) if isinstance(value, bool) else value

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        parent, _, key = name.rpartition("/")
        value = read_attribute(member(group, parent, h5py.Dataset) if parent else group, key)
        if value is None:
            raise SceneError(f"{full_path(group, name)} is missing")
        try:
            value = value.item() if isinstance(value, np.generic) else value
            value = json.loads(value) if get_origin(self.kind) in (Mapping, tuple) else value
            return as_kind(tuple(value) if isinstance(value, list) else value, self.kind)
        except (ValueError, TypeError):
            kind = getattr(self.kind, "__name__", self.kind)
            raise SceneError(f"attribute {full_path(group, name)} is not of the kind {kind}") from None


class SceneText(Layout):
    """A scene as an attribute of TOML text; the files that the scene names lie beside the HDF5 file."""

    def write(self, group: h5py.Group, name: str, value: Scene) -> None:
        group.attrs[name] = value.to_toml()

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Scene:
        path, text = group.file.filename, Attribute(str).read(group, name, sizes)
        scene = Scene.parse(text, f"{path}: its scene").in_folder(Path(path).parent)
        (nx, ny), actuators = scene.grid.nodes, len(scene.actuators)
        sizes.update(actuator=actuators, parts=2 * actuators, x=nx, y=ny, axis=2, drive=2)
        return scene


@dataclass(frozen=True)
class Dataset(Layout):
    """A dataset of real numbers with the attributes ``units`` and ``long_name``; without a shape, a float."""

    units: str
    long_name: str
    shape: tuple[str | int | None, ...] = ()  # lengths, names of dimensions (see read_fields), or None for any length
    bounded: bool = False  # True to refuse, on reading, what is not a number of at most LARGEST

    def write(self, group: h5py.Group, name: str, value: Any) -> None:
        write_array(group, name, value, self.units, self.long_name)
        for axis, dimension in enumerate(self.shape):
            if isinstance(dimension, str):  # netCDF gives no two axes of a dataset the same name
                _attach_scale(group[name], axis, dimension + "_2" * (dimension in self.shape[:axis]))

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        values = read_array(group, name, tuple(sizes.get(n) if isinstance(n, str) else n for n in self.shape))
        sizes.update({n: length for n, length in zip(self.shape, values.shape, strict=True) if isinstance(n, str)})
        if self.bounded and not np.all(np.abs(values) <= LARGEST):
            raise SceneError(f"{full_path(group, name)} must hold numbers from {-LARGEST:g} to {LARGEST:g}")
        return values if self.shape else float(values)


def _attach_scale(dataset: h5py.Dataset, axis: int, name: str) -> None:
    """Name a dimension: it is the dataset's own, or that of a scale in the group or above, or a numbered new one."""
    if dataset.name.rpartition("/")[2] == name:
        return dataset.make_scale(name)
    group, length = dataset.parent, dataset.shape[axis]
    while name not in group and group.name != "/":
        group = group.parent
    if name not in group:
        group = dataset.parent
        write_along(group, name, np.arange(length), "1", f"number of the {name}")
    if group[name].shape == (length,):
        dataset.dims[axis].attach_scale(group[name])


@dataclass(frozen=True)
class Datasets(Layout):
    """A mapping of numbers or arrays, or of such mappings, as a group of datasets; no group if it is empty."""

    layout: Callable[[str], Dataset]  # by the path in the group
    names: tuple[str, ...] = ()  # datasets that must be there

    @staticmethod
    def of(**columns: Dataset) -> Datasets:
        """Return the layout of a mapping with these datasets."""
        return Datasets(columns.__getitem__, tuple(columns))

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any], prefix: str = "") -> None:
        for key in [name for name in self.names if name in value] or value:  # dimensions are the first
            content = value[key]
            if isinstance(content, Mapping):
                self.write(group, f"{name}/{key}", content, f"{prefix}{key}/")
            else:
                self.layout(prefix + key).write(group, f"{name}/{key}", content)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        values, sizes = {}, dict(sizes)
        inner = member(group, name) if name in group else {}
        for key in (self.names or sorted(inner)) if inner else ():
            nested = not self.names and isinstance(member(inner, key, h5py.HLObject), h5py.Group)
            values[key] = (self if nested else self.layout(key)).read(inner, key, sizes)
        return values


@dataclass(frozen=True)
class Groups(Layout):
    """An instance of a data class as a group of its fields; a container of instances as groups in a group."""

    cls: type
    container: type | None = None  # Mapping or tuple, which is absent from the file if it is empty

    def write(self, group: h5py.Group, name: str, value: Any) -> None:
        if self.container is None:
            return write_fields(group.create_group(name), value)
        for key, content in value.items() if self.container is Mapping else enumerate(value):
            write_fields(group.create_group(f"{name}/{key}"), content)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        if self.container is None:
            return read_fields(self.cls, member(group, name), sizes)
        names = sorted(member(group, name)) if name in group else []
        keys = names if self.container is Mapping else [str(index) for index in range(len(names))]
        instances: dict[str, Any] = {key: read_fields(self.cls, member(group, f"{name}/{key}"), sizes) for key in keys}
        return instances if self.container is Mapping else tuple(instances.values())


class SearchState(Layout):
    """The flat state of an optimizer as a group: arrays as datasets, the rest as JSON in the attribute ``numbers``."""

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any]) -> None:
        state = group.create_group(name)
        numbers: dict[str, Any] = {}
        for key, content in value.items():
            (state if isinstance(content, np.ndarray) else numbers)[key] = content
        state.attrs["numbers"] = json.dumps(numbers)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        state = member(group, name)
        numbers = Attribute(Mapping[str, Any]).read(state, "numbers", sizes)
        return {**numbers, **{key: read_array(state, key) for key in sorted(state)}}
