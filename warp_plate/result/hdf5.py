"""The HDF5 codec of results, checkpoints, comparisons and sweeps, driven by the fields of their data classes.

The annotation of a field says how it is stored:

    str, bool, int, float, Literal     attribute
    Scene                              attribute, TOML text
    Mapping or tuple of these          attribute, JSON text
    data class                         group
    Mapping or tuple of data classes   group of groups, named by key or 0, 1, 2, ...
    X | None                           absent if None

Fields with another layout, all arrays among them, or with another name in the file say so in their annotation:
``Annotated[np.ndarray, Dataset("s", "times of the traces", ("trace_times",))]``. Dimensions are stored as netCDF-4
stores them, as scales: datasets of the same name in the group of the dataset or in one above.

Files are written atomically with a checksum, and their content is checked on reading: links, data in other files and
datasets larger than their file are refused, as is a file whose parts take far more memory than itself; a missing or
unexpected value raises a SceneError that names it.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import h5py
import numpy as np

from warp_plate.result.atomic_io import check_seal, make_seal, write_atomically
from warp_plate.result.reading_limits import names_in, reading_limit, spend
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, Count, as_kind
from warp_plate.scene.model import Scene

T = TypeVar("T")
Sizes = dict[str, int]  # lengths of named dimensions, as far as known
Counts = Mapping[str, Count]
# Bytes of the longest text of an attribute, and of texts that are read at once.
MOST_TEXT, MOST_BLOCK = 2**24, 2**28


@dataclass(frozen=True)
class FileFormat:
    """A kind of file, such as "result", with the version of its layout."""

    kind: str
    version: int

    @contextmanager
    def create(self, path: str | Path, previous: Path | None = None) -> Iterator[h5py.File]:
        """Yield a file that is written atomically at the end, or raise a SceneError; see :func:`atomic_path`."""
        # Composed in memory, for HDF5 does not reliably report a full disk.
        with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
            file.attrs["format"] = f"warp-plate {self.kind} {self.version}"
            yield file
            file.flush()
            content: bytes = file.id.get_file_image()
        write_atomically(content + make_seal(content), Path(path), previous)

    @contextmanager
    def open(self, path: str | Path) -> Iterator[h5py.File]:
        """Yield a file opened for reading; raise a SceneError if it is missing, damaged or of another kind."""
        path = Path(path)
        try:
            check_seal(path)
            with h5py.File(path, "r") as file, reading_limit(file.id.get_filesize()):
                if read_attribute(file, "format") != (wanted := f"warp-plate {self.kind} {self.version}"):
                    found = f"this is {described}, " if (described := _description(file)) else ""
                    asked = f"not a {self.kind} of warp-plate (no attribute format = {wanted!r})"
                    raise SceneError(f"{path}: {found}{asked}")
                yield file
        except FileNotFoundError:
            raise SceneError(f"{path}: no such file") from None
        except SceneError as error:
            line = str(error)
            raise SceneError(line if line.startswith(str(path)) else f"{path}: damaged: {line}") from None
        except (OSError, LookupError, ValueError, RuntimeError, TypeError, ArithmeticError) as error:
            raise SceneError(f"{path}: damaged or not an HDF5 file of this program: {error}") from None


def describe_file(path: Path) -> str:
    """Return what a file of this program holds, such as "a result of simulate" or "a sweep"; "" for any other file."""
    try:
        check_seal(path)
        with h5py.File(path, "r") as file:
            return _description(file).rpartition(" (")[0]
    except (OSError, LookupError, ValueError, RuntimeError):
        return ""


def _description(file: h5py.File) -> str:
    program, _, kind = str(read_attribute(file, "format")).partition(" ")
    name, _, version = kind.rpartition(" ")
    if program != "warp-plate" or not name:
        return ""
    command = f" of {read_attribute(file, 'command')}" if name == "result" else ""
    return f"a {name}{command} (format {version})"


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
    known = dict(sizes or {})
    for attribute, name, layout, optional in _fields(cls):
        if attribute not in given:
            absent = optional and name not in group and name not in group.attrs
            given[attribute] = None if absent else layout.read(group, name, known)
    return cls(**given)


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
            raise SceneError(f"{_full_path(group, name)} is missing")
        try:
            value = value.item() if isinstance(value, np.generic) else value
            value = json.loads(value) if get_origin(self.kind) in (Mapping, tuple) else value
            return as_kind(tuple(value) if isinstance(value, list) else value, self.kind)
        except (ValueError, TypeError):
            kind = getattr(self.kind, "__name__", self.kind)
            raise SceneError(f"attribute {_full_path(group, name)} is not of the kind {kind}") from None


class SceneText(Layout):
    """A scene as an attribute of TOML text; the files that the scene names lie beside the HDF5 file."""

    def write(self, group: h5py.Group, name: str, value: Scene) -> None:
        group.attrs[name] = dump_scene(value)

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
        group[name] = np.asarray(value)
        group[name].attrs.update({"units": self.units, "long_name": self.long_name})
        for axis, dimension in enumerate(self.shape):
            if isinstance(dimension, str):  # netCDF gives no two axes of a dataset the same name
                _attach_scale(group[name], axis, dimension + "_2" * (dimension in self.shape[:axis]))

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> Any:
        values = read_array(group, name, tuple(sizes.get(n) if isinstance(n, str) else n for n in self.shape))
        sizes.update({n: length for n, length in zip(self.shape, values.shape, strict=True) if isinstance(n, str)})
        if self.bounded and not np.all(np.abs(values) <= LARGEST):
            raise SceneError(f"{_full_path(group, name)} must hold numbers from {-LARGEST:g} to {LARGEST:g}")
        return values if self.shape else float(values)


@dataclass(frozen=True)
class Datasets(Layout):
    """A mapping of numbers or arrays, or of such mappings, as a group of datasets; no group if it is empty."""

    layout: Callable[[str], Dataset]  # by the path in the group
    names: tuple[str, ...] = ()  # datasets that must be there

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any], prefix: str = "") -> None:
        for key in [name for name in self.names if name in value] or value:  # dimensions are the first
            content = value[key]
            if isinstance(content, Mapping):
                self.write(group, f"{name}/{key}", content, f"{prefix}{key}/")
            else:
                self.layout(prefix + key).write(group, f"{name}/{key}", content)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        values, known = {}, dict(sizes)
        inner = member(group, name) if name in group else {}
        for key in (self.names or names_in(inner)) if inner else ():
            nested = not self.names and isinstance(member(inner, key, h5py.HLObject), h5py.Group)
            values[key] = (self if nested else self.layout(key)).read(inner, key, known)
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
        names = names_in(member(group, name)) if name in group else []
        keys = names if self.container is Mapping else [str(index) for index in range(len(names))]
        instances: dict[str, Any] = {key: read_fields(self.cls, member(group, f"{name}/{key}"), sizes) for key in keys}
        return instances if self.container is Mapping else tuple(instances.values())


class SearchState(Layout):
    """The flat state of an optimizer as a group: arrays as datasets, the rest as JSON in the attribute ``numbers``."""

    def write(self, group: h5py.Group, name: str, value: Mapping[str, Any]) -> None:
        state = group.create_group(name)
        rest: dict[str, Any] = {}
        for key, content in value.items():
            (state if isinstance(content, np.ndarray) else rest)[key] = content
        state.attrs["numbers"] = json.dumps(rest)

    def read(self, group: h5py.Group, name: str, sizes: Sizes) -> dict[str, Any]:
        state = member(group, name)
        rest = Attribute(Mapping[str, Any]).read(state, "numbers", sizes)
        return {**rest, **{key: read_array(state, key) for key in names_in(state)}}


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


def write_along(file: h5py.Group, name: str, values: Any, unit: str, meaning: str, axes: Iterable[str] = ()) -> None:
    """Write values along dimensions; without any, as a dimension itself."""
    if isinstance(values, list):  # of texts
        values = np.array(values, dtype=h5py.string_dtype())
    Dataset(unit, meaning).write(file, name, values)
    if not axes:
        file[name].make_scale(name)
    for index, axis in enumerate(axes):
        file[name].dims[index].attach_scale(file[axis])


def member(group: h5py.Group, name: str, kind: type = h5py.Group) -> Any:
    """Return the group, or other kind of object, at a path in a group; refuse links, which may lead to other files."""
    path, found = _full_path(group, name), group
    for part in name.split("/"):
        link = found.get(part, getlink=True) if isinstance(found, h5py.Group) else None
        if link is None:
            raise SceneError(f"{path} is missing")
        if not isinstance(link, h5py.HardLink):
            raise SceneError(f"{path} is a link, which this program does not follow")
        found = found[part]
    if not isinstance(found, kind):
        raise SceneError(f"{path} is not a {kind.__name__.lower()}")
    return found


def read_attribute(item: h5py.HLObject, name: str) -> Any:
    """Return the single value of an attribute, or None if it is missing."""
    if name not in item.attrs:
        return None
    found, path = item.attrs.get_id(name), _full_path(item, name)
    if found.shape != () or found.dtype.itemsize > MOST_TEXT:
        raise SceneError(f"attribute {path} is more than a single value")
    value = item.attrs[name]
    spend(path, len(value) if isinstance(value, str | bytes) else found.dtype.itemsize)
    if isinstance(value, str | bytes) and len(value) > MOST_TEXT:
        raise SceneError(f"attribute {path} is longer than {MOST_TEXT} bytes")
    return value


def read_array(
    group: h5py.Group, name: str, shape: tuple[int | None, ...] | None = None, text: bool = False
) -> np.ndarray:
    """Return a dataset of real numbers, or of text, that is in the file itself.

    Its shape must be ``shape``, where None stands for any length (default: any shape).
    """
    found, path = member(group, name, h5py.Dataset), _full_path(group, name)
    if (h5py.check_string_dtype(found.dtype) is None) if text else (found.dtype.kind not in "fiu"):
        raise SceneError(f"{path} is not a dataset of {'text' if text else 'real numbers'}")
    if found.chunks is not None:
        raise SceneError(f"{path} is in chunks, which this program does not write")
    if found.is_virtual or found.external:
        raise SceneError(f"{path} is kept in another file, which this program does not read")
    if math.prod(found.shape) * found.dtype.itemsize > found.file.id.get_filesize():
        raise SceneError(f"{path} has shape {found.shape}, more than the file holds")
    wanted = found.shape if shape is None else shape
    if len(wanted) != found.ndim or any(a not in (None, b) for a, b in zip(wanted, found.shape, strict=True)):
        raise SceneError(f"{path} has shape {found.shape} instead of {wanted} (None: any length)")
    if text:
        return np.array(_read_texts(found, path), dtype=object).reshape(found.shape)
    spend(path, found.nbytes)
    return np.asarray(found[()])


def _read_texts(dataset: h5py.Dataset, path: str) -> list[str]:
    """Return the texts of a dataset, read in blocks that even in a file made for it do not fill the memory."""
    texts: list[str] = []
    columns, step = dataset.shape[-1], max(1, MOST_BLOCK // dataset.file.id.get_filesize())
    for row in np.ndindex(dataset.shape[:-1]):
        for start in range(0, columns, step):
            block = dataset.asstr()[row + (slice(start, start + step),)].tolist()
            spend(path, sum(map(len, block)))
            texts += block
    return texts


def _full_path(item: h5py.HLObject, name: str) -> str:
    return f"{item.name}/{name}".lstrip("/")
