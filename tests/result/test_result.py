"""The result file: what goes in comes out, whole or not at all, and readable without this program."""

import errno
import json
import os
from contextlib import contextmanager
from dataclasses import fields, replace

import h5py
import numpy as np
import pytest

from warp_plate.result import Case, Result, load_result, save_result, store
from warp_plate.result.atomic_io import make_seal
from warp_plate.scene import Scene, SceneError

TIMES = (0.0464, 0.0696)


@pytest.fixture
def result(random):
    """A result with other numbers every time."""

    def case():
        return Case(
            phasors=np.array([0, *random.normal(size=3)]) * np.exp(1j * random.uniform(-9, 9, 4)),
            energy={"target": float(random.uniform(1, 2)), "plate": float(random.uniform(3, 4))},
            displacement=random.normal(size=(2, 27, 27)).astype(np.float32),
            trace=random.normal(size=(3, 11)),
        )

    return Result(
        command="localize",
        source='panel "A" (größer).toml',
        scene=Scene.load("paper"),
        device="cpu",
        seed=12345,
        effects=("damping",),
        cases={name: case() for name in ("equal", "single", "best")},
        times=np.array(TIMES),
        trace_times=np.linspace(0, 1e-3, 11),
        seconds={"compile": 1.5, "solve": 0.25},
        node_steps=2**40 + 1,
        evaluations=1600,
        bound=0.6867,
        history={
            "evaluations": np.arange(20, 101, 20),
            "best": random.uniform(size=5),
            "mean": random.uniform(size=5),
        },
        evaluator="response",
        interrupted=True,
        versions={"warp-plate": "0.1.0", "numpy": np.__version__},
    )


def assert_equal(first, second):
    """Every field; drives to round-off, as they are stored by magnitude and phase."""
    arrays = ("times", "trace_times")
    for name in {field.name for field in fields(Result)} - {"cases", "history", *arrays}:
        assert getattr(first, name) == getattr(second, name), name
    for name in arrays:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.history.keys() == second.history.keys()
    for name, values in first.history.items():
        np.testing.assert_array_equal(values, second.history[name])
    assert first.cases.keys() == second.cases.keys()
    for name, case in first.cases.items():
        other = second.cases[name]
        np.testing.assert_allclose(case.phasors, other.phasors, rtol=1e-14)
        assert dict(case.energy) == dict(other.energy)
        assert case.displacement.dtype == other.displacement.dtype
        np.testing.assert_array_equal(case.displacement, other.displacement)
        np.testing.assert_array_equal(case.trace, other.trace)


def test_a_result_comes_back_as_it_was_saved(result, tmp_path):
    path = save_result(result, tmp_path / "run.h5")
    assert path == tmp_path / "run.h5"
    assert_equal(result, load_result(path))


def test_a_simulation_has_neither_bound_nor_history_nor_records(result, tmp_path):
    case = replace(result.cases["equal"], displacement=np.zeros((0, 27, 27)), trace=np.zeros((0, 11)))
    simulation = replace(
        result, cases={"drive": case}, times=np.zeros(0), bound=None, history={}, interrupted=False
    )
    assert_equal(simulation, load_result(save_result(simulation, tmp_path / "run.h5")))


def test_every_dataset_says_its_unit_and_meaning(result, tmp_path):
    units = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            assert item.attrs["long_name"], name
            units[name] = item.attrs["units"]

    with h5py.File(save_result(result, tmp_path / "run.h5")) as file:
        file.visititems(visit)
        assert file.attrs["format"] == store.FORMAT
        assert json.loads(file.attrs["versions"]) == result.versions
        assert json.loads(file["cases/best/energy"].attrs["regions"]) == ["target", "plate"]
        assert file["cases/best/displacement"].shape == (2, 27, 27)
        assert file["localization_factor/best"][()] == pytest.approx(result.cases["best"].localization_factor)
    expected = {
        "x": "m",
        "times": "s",
        "localization_factor/bound": "1",
        "cases/best/magnitude": "N/m^2",
        "cases/best/phase": "rad",
        "cases/best/energy": "J",
        "cases/best/displacement": "m",
        "cases/best/trace": "m",
        "history/best": "1",
    }
    assert expected.items() <= units.items()


def test_phase_lag_is_positive_and_zero_for_an_idle_actuator():
    case = Case(np.array([2, -1j, 1j, 0]), {"target": 0.0, "plate": 0.0}, np.zeros(0), np.zeros(0))
    np.testing.assert_allclose(case.phase, [0, np.pi / 2, 3 * np.pi / 2, 0])
    np.testing.assert_allclose(case.magnitude, [2, 1, 1, 0])
    assert np.isnan(case.localization_factor)


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_behind(result, tmp_path, monkeypatch):
    path = save_result(result, tmp_path / "run.h5")
    before = path.read_bytes()

    def full_disk(handle):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(SceneError, match=r"cannot be written.*No space left") as caught:
        save_result(replace(result, seed=1), path)
    assert str(caught.value).startswith(f"{path}: ")
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_write_keeps_the_old_file_too(result, tmp_path, monkeypatch):
    path = save_result(result, tmp_path / "run.h5")

    def interrupt(file, at, case, unit):
        raise KeyboardInterrupt

    monkeypatch.setattr(store, "_write_case", interrupt)
    with pytest.raises(KeyboardInterrupt):
        save_result(replace(result, seed=1), path)
    assert list(tmp_path.iterdir()) == [path]
    assert_equal(result, load_result(path))


def test_a_missing_folder_is_named(result, tmp_path):
    with pytest.raises(SceneError, match="cannot be written"):
        save_result(result, tmp_path / "nowhere" / "run.h5")


@contextmanager
def changed(path, mode="r+"):
    """A file for writing that gets its seal back, as somebody who means to do harm would do it."""
    with h5py.File(path, mode) as file:
        yield file
    content = path.read_bytes()
    path.write_bytes(content + make_seal(content))


def load_error(path):
    with pytest.raises(SceneError) as caught:
        load_result(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text


def test_what_is_no_result_is_refused_in_one_line(tmp_path):
    assert "no such file" in load_error(tmp_path / "run.h5")
    (tmp_path / "empty.h5").touch()
    assert "damaged" in load_error(tmp_path / "empty.h5")
    (tmp_path / "text.h5").write_text("a = 1\n")
    assert "damaged" in load_error(tmp_path / "text.h5")
    with changed(tmp_path / "other.h5", "w") as file:
        file["x"] = 1
    assert "not a result of warp-plate" in load_error(tmp_path / "other.h5")


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.99])
def test_a_file_cut_short_is_refused_in_one_line(result, tmp_path, kept):
    path = save_result(result, tmp_path / "run.h5")
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    assert "damaged" in load_error(path)


@pytest.mark.parametrize("lost", ["times", "cases", "cases/best/phase"])
def test_a_file_without_a_dataset_is_refused_in_one_line(result, tmp_path, lost):
    path = save_result(result, tmp_path / "run.h5")
    with changed(path) as file:
        del file[lost]
    assert lost.rpartition("/")[2] in load_error(path)


@pytest.mark.parametrize(
    ("attribute", "value"), [("seed", "many"), ("effects", "["), ("scene", "title = 3"), ("node_steps", None)]
)
def test_a_file_with_a_damaged_attribute_is_refused_in_one_line(result, tmp_path, attribute, value):
    path = save_result(result, tmp_path / "run.h5")
    with changed(path) as file:
        del file.attrs[attribute]
        if value is not None:
            file.attrs[attribute] = value
    load_error(path)
