"""The HDF5 codec of results, checkpoints, comparisons and sweeps, driven by the fields of their data classes.

The annotation of a field says how it is stored:

    str, bool, int, float, Literal     attribute
    Scene                              attribute, TOML text
    Mapping or tuple of these          attribute, JSON text
    data class                         group
    Mapping or tuple of data classes   group of groups, named by key or 0, 1, 2, ...
    X | None                           absent if None

Fields with another layout, all arrays among them, or with another name in the file say so in their annotation:
``Annotated[np.ndarray, Dataset("s", "times of the traces", ("steps",)), "trace_times"]``. Reading is strict: a missing
or unexpected value raises a SceneError that names it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import h5py
import numpy as np

from warp_plate.result.safe_hdf5 import full_path, member, read_array
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

T = TypeVar("T")
# Units of datasets by placeholder, where they depend on the scene.
Units = Mapping[str, str]
# Lengths of named dimensions, as far as known.
Sizes = dict[str, int]


def write_fields(group: h5py.Group, value: Any, units: Units | None = None) -> None:
    """Write the fields of a data class instance into a group, except those with the layout ``ELSEWHERE``."""
    for attribute, name, layout, _ in _fields(type(value)):
        content = getattr(value, attribute)
        if layout is not ELSEWHERE and content is not None:
            layout.write(group, name, content, units or {})


def read_fields(cls: type[T], group: h5py.Group, sizes: Sizes | None = None, **given: Any) -> T:
    """Return an instance of a data class with the fields that :func:`write_fields` wrote.

    Args:
        cls: The data class.
        group: The group.
        sizes: Lengths of dimensions that layouts name; other names stand for the length that is read first.
        given: Fields that are known already.

    Raises:
        SceneError: a field is missing or not as it should be.
    """
    known = dict(sizes or {})
    for attribute, name, layout, optional in _fields(cls):
        if attribute not in given:
            absent = optional and name not in group and name not in group.attrs
            given[attribute] = None if absent else layout.read(group, name, known)
    return cls(**given)


class Layout:
    """Form of a field in a group: ``write(group, name, value, units)`` and ``read(group, name, sizes)``."""

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        """Write the field's value."""
        raise NotImplementedError

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        """Return the field's value, or raise a SceneError if it is missing or not as it should be."""
        raise NotImplementedError


# The layout of fields that the module of their file writes and reads itself.
ELSEWHERE = Layout()


@dataclass(frozen=True)
class Attribute(Layout):
    """An attribute of the group, or of the dataset ``of`` in it, whose value has the annotation ``kind``."""

    kind: Any
    of: str = ""

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        if get_origin(self.kind) in (Mapping, tuple):
            value = json.dumps(dict(value) if isinstance(value, Mapping) else list(value))
        (group[self.of] if self.of else group).attrs[name] = int(value) if isinstance(value, bool) else value

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        item = member(group, self.of, h5py.Dataset) if self.of else group
        value, path = item.attrs.get(name), f"attribute {full_path(item, name)}"
        if value is None:
            raise SceneError(f"{path} is missing")
        if isinstance(value, np.generic):
            value = value.item()
        if get_origin(self.kind) in (Mapping, tuple):
            value = json.loads(value)
        if self.kind is bool and value in (0, 1):
            value = bool(value)
        if not _conforms(value, self.kind):
            raise SceneError(f"{path} is not of the kind {getattr(self.kind, '__name__', self.kind)}")
        return tuple(value) if get_origin(self.kind) is tuple else value


class SceneText(Layout):
    """A scene as an attribute of TOML text; the files that the scene names lie beside the HDF5 file."""

    def write(self, group: h5py.Group, name: str, value: Scene, units: Units) -> None:
        group.attrs[name] = dump_scene(value)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Scene:
        path = group.file.filename
        return Scene.parse(Attribute(str).read(group, name, sizes), f"{path}: its scene").in_folder(Path(path).parent)


@dataclass(frozen=True)
class Dataset(Layout):
    """A dataset of real numbers with the attributes ``units`` and ``long_name``; without a shape, a float.

    Attributes:
        units: Unit, or a placeholder that is replaced when writing.
        long_name: Meaning, for people.
        shape: Length of each dimension: a number, a name (see :func:`read_fields`), or None for any length.
    """

    units: str
    long_name: str
    shape: tuple[str | int | None, ...] = ()

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        group[name] = np.asarray(value)
        group[name].attrs.update({"units": units.get(self.units, self.units), "long_name": self.long_name})

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        values = read_array(group, name, tuple(sizes.get(n) if isinstance(n, str) else n for n in self.shape))
        sizes.update({n: length for n, length in zip(self.shape, values.shape, strict=True) if isinstance(n, str)})
        return values if self.shape else float(values)


@dataclass(frozen=True)
class Datasets(Layout):
    """A mapping of arrays or numbers, or of such mappings, as a group of datasets; no group if it is empty.

    Attributes:
        entries: Layouts of the datasets by name, all of which must be there; or a function from the path of any dataset
            in the group to its layout.
    """

    entries: Mapping[str, Dataset] | Callable[[str], Dataset]

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any], units: Units) -> None:
        for path, content in _leaves(value):
            self._entry(path).write(group, f"{name}/{path}", content, units)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        if name not in group:
            return {}
        if isinstance(self.entries, Mapping):
            return {key: entry.read(group, f"{name}/{key}", sizes) for key, entry in self.entries.items()}
        return self._read_all(member(group, name), "", sizes)

    def _read_all(self, group: h5py.Group, prefix: str, sizes: Sizes) -> dict[str, Any]:
        return {
            key: self._read_all(member(group, key), f"{prefix}{key}/", sizes)
            if isinstance(member(group, key, h5py.HLObject), h5py.Group)
            else self._entry(prefix + key).read(group, key, sizes)
            for key in group
        }

    def _entry(self, path: str) -> Dataset:
        return self.entries[path] if isinstance(self.entries, Mapping) else self.entries(path)


@dataclass(frozen=True)
class Groups(Layout):
    """Instances of a data class as groups of their fields.

    Attributes:
        cls: The data class.
        container: ``Mapping`` or ``tuple`` of instances, which is a group of groups, or absent if empty; None for one.
    """

    cls: type
    container: type | None = None

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        if self.container is None:
            return write_fields(group.create_group(name), value, units)
        for key, content in value.items() if self.container is Mapping else enumerate(value):
            write_fields(group.create_group(f"{name}/{key}"), content, units)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        if self.container is None:
            return read_fields(self.cls, member(group, name), sizes)
        names = list(member(group, name)) if name in group else []
        keys = names if self.container is Mapping else [str(index) for index in range(len(names))]
        instances: dict[str, Any] = {
            key: read_fields(self.cls, member(group, f"{name}/{key}"), sizes) for key in keys
        }
        return instances if self.container is Mapping else tuple(instances.values())


class SearchState(Layout):
    """The flat state of an optimizer as a group: arrays as datasets, the rest as JSON in the attribute ``numbers``."""

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any], units: Units) -> None:
        state = group.create_group(name)
        rest: dict[str, Any] = {}
        for key, content in value.items():
            (state if isinstance(content, np.ndarray) else rest)[key] = content
        state.attrs["numbers"] = json.dumps(rest)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        state = member(group, name)
        rest = Attribute(Mapping[str, Any]).read(state, "numbers", sizes)
        return {**rest, **{key: read_array(state, key) for key in state}}


def _fields(cls: type) -> Iterator[tuple[str, str, Layout, bool]]:
    """Yield attribute, name in the file, layout and optionality of each field of a data class."""
    hints = get_type_hints(cls, include_extras=True)
    for item in dataclasses.fields(cls):
        hint = hints[item.name]
        hint, *extras = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        name = next((extra for extra in extras if isinstance(extra, str)), item.name)
        layout = next((extra for extra in extras if isinstance(extra, Layout)), None)
        yield item.name, name, layout or _default_layout(kinds[0]), NoneType in kinds


def _default_layout(kind: Any) -> Layout:
    classes = [part for part in (kind, *get_args(kind)) if isinstance(part, type) and dataclasses.is_dataclass(part)]
    if kind is Scene:
        return SceneText()
    if not classes:
        return Attribute(kind)
    return Groups(classes[0], get_origin(kind))


def _conforms(value: Any, kind: Any) -> bool:
    """Return whether an attribute or its JSON content is of an annotated kind; integers are 0 or more."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Literal:
        return value in parts
    if origin is Mapping:
        return isinstance(value, dict) and all(_conforms(item, parts[1]) for item in value.values())
    if origin is tuple:
        return isinstance(value, list) and all(_conforms(item, parts[0]) for item in value)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool) and value >= 0
    return kind is Any or isinstance(value, (int, float) if kind is float else kind)


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the paths and values of nested mappings."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}/")
        else:
            yield prefix + key, value
