"""The HDF5 codec: every kind of field is read back as written, and any departure in the file is refused by name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

import h5py
import numpy as np
import pytest

from warp_plate.result.hdf5 import Attribute, Dataset, Datasets, SearchState, read_fields, write_fields
from warp_plate.result.safe_hdf5 import open_hdf5, save_hdf5
from warp_plate.scene import Scene, SceneError

FORMAT = "test 1"


def entry(path):
    """Return the layout of any entry of a mapping."""
    return Dataset("1", path)


@dataclass(frozen=True)
class Item:
    """A data class inside another one."""

    weight: Annotated[np.ndarray, Dataset("drive", "weights", ("length", 2))]
    note: Annotated[str, Attribute(str, of="weight")]
    limit: float | None


@dataclass(frozen=True)
class Record:
    """A data class with a field of every kind."""

    text: str
    flag: bool
    count: int
    size: float
    kind: Literal["a", "b"]
    scene: Scene
    names: tuple[str, ...]
    seconds: Mapping[str, float]
    anything: Annotated[Mapping[str, Any], "other"]
    array: Annotated[np.ndarray, Dataset("m", "an array", ("rows", None))]
    scalar: Annotated[float, Dataset("s", "a number"), "group/scalar"]
    absent: Annotated[float | None, Dataset("s", "a number")]
    columns: Annotated[Mapping[str, np.ndarray], Datasets({"x": Dataset("m", "x", ("rows",))})]
    nested: Annotated[Mapping[str, Any], Datasets(entry)]
    item: Item
    items: tuple[Item, ...]
    named: Mapping[str, Item]
    state: Annotated[Mapping[str, Any] | None, SearchState()]


@pytest.fixture
def record(scene, random):
    def item(**options):
        return Item(**{"weight": random.normal(size=(3, 2)), "note": "größer", "limit": None, **options})

    return Record(
        text='a "b"\nc', flag=True, count=2**40, size=0.1, kind="b", scene=scene(), names=("x", "y"),
        seconds={"a": 1.5},
        anything={"deep": [1, {"x": None}]}, array=random.normal(size=(2, 3)).astype(np.float32), scalar=0.1 + 0.2,
        absent=None, columns={"x": np.array([1, 2])}, nested={"sum": 1.0, "case": {"sum": 2.0}}, item=item(limit=0.25),
        items=tuple(item() for _ in range(11)), named={"a b": item()},
        state={"settings": {"x": 1}, "rows": np.arange(6.0).reshape(2, 3), "best": np.inf, "random": {"state": 2**100}},
    )  # fmt: skip


@pytest.fixture
def path(record, tmp_path):
    save_hdf5(tmp_path / "a.h5", FORMAT, lambda file: write_fields(file, record, {"drive": "V"}))
    return tmp_path / "a.h5"


def load(path):
    with open_hdf5(path, FORMAT, "record") as file:
        return read_fields(Record, file, {"length": 3})


def assert_same(one, other):
    """Compare values of any kind, with the types of arrays."""
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, (Item, Record)):
        for item in fields(one):
            assert_same(getattr(one, item.name), getattr(other, item.name))
    elif isinstance(one, (dict, tuple)):
        assert len(one) == len(other)
        for key in one if isinstance(one, dict) else range(len(one)):
            assert_same(one[key], other[key])
    else:
        assert one == other


def test_every_kind_of_field_is_read_back(record, path):
    del record.state["settings"]
    assert_same(load(path), record)


def test_others_read_units_names_and_json(record, path):
    with h5py.File(path) as file:
        assert file.attrs["format"] == FORMAT
        assert (file["array"].attrs["units"], file["array"].attrs["long_name"]) == ("m", "an array")
        assert file["item/weight"].attrs["units"] == "V"
        assert (file.attrs["flag"], json.loads(file.attrs["names"])) == (1, ["x", "y"])
        assert file["group/scalar"][()] == record.scalar
        assert "absent" not in file
        assert file["nested/case/sum"].attrs["long_name"] == "case/sum"


def refused(path, forge):
    """Change a file, seal it again and return the one line with which it is refused."""

    def write(file):
        with h5py.File(path) as old:
            for name in old:
                old.copy(name, file)
            file.attrs.update(old.attrs)
        forge(file)

    save_hdf5(path.with_name("forged.h5"), FORMAT, write)
    with pytest.raises(SceneError) as caught:
        load(path.with_name("forged.h5"))
    line = str(caught.value)
    assert line.startswith(f"{path.with_name('forged.h5')}: ")
    assert "\n" not in line
    return line


def replaced(name, values=None, **options):
    def forge(file):
        del file[name]
        if values is not None or options:
            file.create_dataset(name, data=values, **options)

    return forge


@pytest.mark.parametrize(
    ("forge", "words"),
    [
        (replaced("array"), "array is missing"),
        (replaced("group"), "group/scalar is missing"),
        (replaced("item/weight"), "item/weight is missing"),
        (replaced("items/5/weight"), "items/5/weight is missing"),
        (replaced("items/5"), "items/5"),
        (replaced("named/a b/weight", np.ones((2, 2))), "named/a b/weight has shape (2, 2) instead of (3, 2)"),
        (replaced("array", np.ones((3, 3))), "columns/x has shape (2,) instead of (3,)"),
        (replaced("array", np.ones(2)), "array has shape (2,)"),
        (replaced("group/scalar", np.ones(2)), "group/scalar has shape (2,)"),
        (replaced("columns/x"), "columns/x is missing"),
        (replaced("array", np.array([[b"text"]])), "array is not a dataset of real numbers"),
        (replaced("array", np.ones((2, 3), complex)), "array is not a dataset of real numbers"),
        (replaced("state/rows", np.array([True])), "state/rows is not a dataset of real numbers"),
        (replaced("array", shape=(10**12, 3), dtype=float), "more than the file holds"),
        (replaced("item", np.ones(2)), "item is not a group"),
    ],
)
def test_wrong_datasets_are_refused_by_name(path, forge, words):
    assert words in refused(path, forge)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("text", 7), ("text", None), ("flag", 2), ("count", -1), ("count", 1.5), ("count", np.inf), ("count", "many"),
        ("size", "0.1"), ("kind", "c"), ("scene", "title = 3"), ("scene", "[plate]\nthickness = 1"), ("names", "[1]"),
        ("names", '{"x": 1}'), ("names", "["), ("names", 3), ("seconds", "[1]"), ("seconds", '{"a": "b"}'),
        ("seconds", "[" * 10**5), ("format", "test 0"),
    ],
)  # fmt: skip
def test_wrong_attributes_are_refused_by_name(path, name, value):
    def forge(file):
        del file.attrs[name]
        if value is not None:
            file.attrs[name] = value

    line = refused(path, forge)
    assert name in line or "damaged" in line


def test_nothing_outside_the_file_is_read(path, tmp_path):
    """Links and data in other files are refused by name."""
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["data"] = np.ones((2, 3))
    (tmp_path / "secret.raw").write_bytes(bytes(100))

    def link(name, target):
        def forge(file):
            del file[name]
            file[name] = target

        return forge

    def virtual(file):
        del file["array"]
        layout = h5py.VirtualLayout((2, 3), float)
        layout[...] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "data", (2, 3))
        file.create_virtual_dataset("array", layout)

    external = h5py.ExternalLink(str(tmp_path / "secret.h5"), "data")
    for name in ("array", "items", "item/weight", "nested/sum", "state/rows", "columns/x"):
        assert "is a link" in refused(path, link(name, external))
    assert "is a link" in refused(path, link("array", h5py.SoftLink("/columns/x")))
    raw = [(str(tmp_path / "secret.raw"), 0, 48)]
    assert "in another file" in refused(path, replaced("array", shape=(2, 3), dtype=float, external=raw))
    assert "in another file" in refused(path, virtual)
