"""The HDF5 codec of results, checkpoints, sweeps and comparisons, driven by the fields of their data classes.

The annotation of a field says how it is stored:

    str, bool, int, float, Literal     attribute
    Scene                              attribute, TOML text
    Mapping or tuple of these          attribute, JSON text
    data class                         group
    Mapping or tuple of data classes   group of groups, named by key or 0, 1, 2, ...
    X | None                           absent if None

Fields with another layout, all arrays among them, or with another name in the file name it in their annotation:
``Annotated[np.ndarray, Dataset("s", "times of the traces", ("steps",)), "trace_times"]``. Reading is strict: a missing
or unexpected value raises a SceneError that names it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import h5py
import numpy as np

from warp_plate.result.safe_hdf5 import full_path, member, member_names, read_attribute, read_numbers, subgroup
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

T = TypeVar("T")
# Units by placeholder, for datasets whose unit depends on the scene.
Units = Mapping[str, str]
# Lengths of named dimensions, as far as known.
Sizes = dict[str, int]


class Layout:
    """The place and form of a field in a group."""

    def exists(self, group: h5py.Group, name: str) -> bool:
        """Return whether the group holds the field."""
        return name in group

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        """Write the field's value."""
        raise NotImplementedError

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        """Return the field's value.

        Raises:
            SceneError: it is missing or not as it should be.
        """
        raise NotImplementedError


def write_fields(group: h5py.Group, value: Any, units: Units | None = None) -> None:
    """Write the fields of a data class instance into a group, except those with the layout ``ELSEWHERE``."""
    for attribute, name, layout, _ in _fields(type(value)):
        content = getattr(value, attribute)
        if layout is not ELSEWHERE and content is not None:
            layout.write(group, name, content, units or {})


def read_fields(cls: type[T], group: h5py.Group, sizes: Sizes | None = None, **given: Any) -> T:
    """Return an instance of a data class with the fields that :func:`write_fields` wrote.

    Args:
        sizes: lengths of dimensions that layouts name; other names stand for the length that is read first.
        given: fields that are known already.

    Raises:
        SceneError: a field is missing or not as it should be.
    """
    known = dict(sizes or {})
    for attribute, name, layout, optional in _fields(cls):
        if attribute not in given:
            absent = optional and not layout.exists(group, name)
            given[attribute] = None if absent else layout.read(group, name, known)
    return cls(**given)


@dataclass(frozen=True)
class Attribute(Layout):
    """An attribute of the group.

    Attributes:
        kind: Annotation of the value.
        of: Dataset in the group that has the attribute (default: the group itself).
    """

    kind: Any
    of: str = ""

    def exists(self, group: h5py.Group, name: str) -> bool:
        return name in self._item(group).attrs

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        if _is_container(self.kind):
            value = json.dumps(dict(value) if isinstance(value, Mapping) else list(value))
        self._item(group).attrs[name] = int(value) if isinstance(value, bool) else value

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        value = read_attribute(self._item(group), name)
        if _is_container(self.kind):
            value = json.loads(value) if isinstance(value, str) else None
        if self.kind is bool and value in (0, 1):
            value = bool(value)
        if not _conforms(value, self.kind):
            raise SceneError(f"attribute {full_path(self._item(group), name)} is not {_described(self.kind)}")
        return tuple(value) if get_origin(self.kind) is tuple else value

    def _item(self, group: h5py.Group) -> h5py.HLObject:
        return member(group, self.of) if self.of else group


class SceneText(Layout):
    """A scene as an attribute of TOML text. The files that the scene names lie beside the HDF5 file."""

    def write(self, group: h5py.Group, name: str, value: Scene, units: Units) -> None:
        group.attrs[name] = dump_scene(value)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Scene:
        path = group.file.filename
        text: str = Attribute(str).read(group, name, sizes)
        return Scene.parse(text, f"{path}: its scene").in_folder(Path(path).parent)


@dataclass(frozen=True)
class Dataset(Layout):
    """A dataset of real numbers with the attributes ``units`` and ``long_name``; read as a float if it has no shape.

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
        shape = tuple(sizes.get(length) if isinstance(length, str) else length for length in self.shape)
        values = read_numbers(group, name, shape)
        sizes.update({length: n for length, n in zip(self.shape, values.shape, strict=True) if isinstance(length, str)})
        return values if self.shape else float(values)


@dataclass(frozen=True)
class Datasets(Layout):
    """A mapping of arrays or numbers, or of such mappings, as a group of datasets; no group if it is empty.

    Attributes:
        entries: Layout of each dataset by its name, all of which must be there; or a function from the path of an entry
            in the group to its layout.
    """

    entries: Mapping[str, Dataset] | Callable[[str], Dataset]

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any], units: Units) -> None:
        for path, content in _leaves(value).items():
            self._entry(path).write(group, f"{name}/{path}", content, units)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        if name not in group:
            return {}
        if isinstance(self.entries, Mapping):
            return {key: entry.read(group, f"{name}/{key}", sizes) for key, entry in self.entries.items()}
        return self._read(group, name, "", sizes)

    def _read(self, group: h5py.Group, name: str, prefix: str, sizes: Sizes) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key in member_names(group, name):
            path = f"{name}/{key}"
            if isinstance(member(group, path), h5py.Group):
                found[key] = self._read(group, path, f"{prefix}{key}/", sizes)
            else:
                found[key] = self._entry(prefix + key).read(group, path, sizes)
        return found

    def _entry(self, path: str) -> Dataset:
        return self.entries[path] if isinstance(self.entries, Mapping) else self.entries(path)


@dataclass(frozen=True)
class Group(Layout):
    """A data class as a group of its fields.

    Attributes:
        cls: The data class.
    """

    cls: type

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        write_fields(group.create_group(name), value, units)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        return read_fields(self.cls, subgroup(group, name), sizes)


@dataclass(frozen=True)
class Groups(Layout):
    """A mapping or tuple of data class instances as a group of groups; no group if it is empty.

    Attributes:
        cls: The data class.
        numbered: True for a tuple.
    """

    cls: type
    numbered: bool

    def write(self, group: h5py.Group, name: str, value: Any, units: Units) -> None:
        items = enumerate(value) if self.numbered else value.items()
        for key, content in items:
            Group(self.cls).write(group, f"{name}/{key}", content, units)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        names = member_names(group, name)
        keys = [str(index) for index in range(len(names))] if self.numbered else names
        found = {key: Group(self.cls).read(group, f"{name}/{key}", sizes) for key in keys}
        return tuple(found.values()) if self.numbered else found


class SearchState(Layout):
    """The flat state of an optimizer as a group: arrays as datasets, the rest as JSON in the attribute ``numbers``.

    The entry ``settings`` is left out, for the scene determines it.
    """

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any], units: Units) -> None:
        state, rest = group.create_group(name), {}
        for key, content in value.items():
            if isinstance(content, np.ndarray):
                state[key] = content
            elif key != "settings":
                rest[key] = content
        state.attrs["numbers"] = json.dumps(rest)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        arrays = {key: read_numbers(group, f"{name}/{key}") for key in member_names(group, name)}
        return {**Attribute(Mapping[str, Any]).read(subgroup(group, name), "numbers", sizes), **arrays}


# The layout of fields that their file's module writes and reads itself.
ELSEWHERE = Layout()


def _fields(cls: type) -> tuple[tuple[str, str, Layout, bool], ...]:
    """Return attribute, name in the file, layout and optionality of each field of a data class."""
    hints, fields = get_type_hints(cls, include_extras=True), []
    for item in dataclasses.fields(cls):
        hint, extras = hints[item.name], []
        if get_origin(hint) is Annotated:
            hint, *extras = get_args(hint)
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        name = next((extra for extra in extras if isinstance(extra, str)), item.name)
        layout = next((extra for extra in extras if isinstance(extra, Layout)), None) or _default_layout(kinds[0])
        fields.append((item.name, name, layout, NoneType in kinds))
    return tuple(fields)


def _default_layout(kind: Any) -> Layout:
    inner = [part for part in get_args(kind) if isinstance(part, type) and dataclasses.is_dataclass(part)]
    if kind is Scene:
        return SceneText()
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return Group(kind)
    return Groups(inner[0], get_origin(kind) is tuple) if inner else Attribute(kind)


def _is_container(kind: Any) -> bool:
    return get_origin(kind) in (Mapping, tuple)


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


def _described(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return f"one of {get_args(kind)}"
    names = {str: "text", int: "a whole number from 0 on", float: "a number", bool: "0 or 1"}
    return names.get(kind) or f"JSON of {kind}".replace("collections.abc.", "").replace("typing.", "")


def _leaves(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of nested mappings by their paths."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        found |= _leaves(value, f"{prefix}{key}/") if isinstance(value, Mapping) else {prefix + key: value}
    return found
