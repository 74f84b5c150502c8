"""Result files: what is saved is loaded again, and other programs find it by the documented names."""

import json
from dataclasses import fields, is_dataclass, replace

import h5py
import numpy as np
import pytest

from support.scenes import refused
from warp_plate.result.atomic_io import make_seal
from warp_plate.result.case import Case
from warp_plate.result.model import Result, RobustComparison, TargetSearch, load_result, save_result
from warp_plate.scene.model import Scene

LINKED = ("times", "cases", "cases/best", "cases/best/energy", "objectives/sum", "objectives_of/equal", "searches/0")


@pytest.fixture
def full_result(random):
    """A result with something in every field."""
    scene = Scene.load("paper")
    targets = [{"name": name, "disc": (0.05, 0.05, 0.01 + 0.01 * len(name))} for name in ("a", "bc")]
    scene = Scene.from_tables({**scene.model_dump(exclude={"target"}, exclude_none=True), "targets": targets})

    def case(**options):
        energy = {region: float(random.uniform(1, 2)) for region in ("target", "plate", "target a", "target bc")}
        return Case(
            phasors=np.array([0, *random.normal(size=3)]) * np.exp(1j * random.uniform(-9, 9, 4)),
            energy=energy,
            displacement=random.normal(size=(2, 27, 27)).astype(np.float32),
            trace=random.normal(size=(3, 11)),
            **options,
        )

    history = {"evaluations": np.arange(20, 101, 20), "best": random.uniform(size=5), "mean": random.uniform(size=5)}
    shorter = {name: values[:2] for name, values in history.items()}
    own = {"frequency": random.uniform(size=4), "centre": random.uniform(size=(4, 2)), "delay": random.uniform(size=4)}
    line = random.uniform(size=3)
    search = TargetSearch(random.normal(size=6), 3, 0.5, "bound only", 100, history, {"sum": 0.5})
    return Result(
        command="localize", source='panel "A" (größer).toml', scene=scene, device="cpu", seed=12345,
        effects=("damping",), times=np.array([0.0464, 0.0696]), trace_times=np.linspace(0, 1e-3, 11),
        cases={"equal": case(), "best": case(**own), "best bc": case(status="grew")}, seconds={"compile": 1.5},
        node_steps=2**40 + 1, evaluations=1600, bound=0.6867, bound_kind="attained", history=history,
        objective_values={"velocity of the rest": 0.25, "sum": 0.5, "bound": 1.0},
        objective_values_by_case={"equal": {"contrast": 2.0, "sum": -1.0}}, evaluator="response", path="resident",
        interrupted=True, versions={"numpy": np.__version__}, accuracy={"estimate": {"line": "±", "cases": [0.1]}},
        peak_displacement=1e-6,
        spectrum={"frequency": line, "equal": line, "single": line, "best": line, "resonances": np.array([90.0])},
        target_searches=(search, replace(search, position=None, bound=None, bound_kind="", history=shorter)),
        robust=RobustComparison("mean", 2, False, 0.75, line[:2], line[1:], random.uniform(size=(2, 7))),
        lost_plates={"killed": 3},
    )  # fmt: skip


def test_results_compare_by_identity(full_result):
    """A comparison of arrays would have no single truth value."""
    assert full_result == full_result
    assert full_result != replace(full_result)
    assert len({full_result, full_result.robust, *full_result.cases.values(), *full_result.target_searches}) == 7


def assert_equal(one, other):
    """Compare nested data classes to the bit."""
    if is_dataclass(one) and not isinstance(one, Scene):
        for name in (field.name for field in fields(one)):
            assert_equal(getattr(one, name), getattr(other, name))
    elif isinstance(one, (dict, tuple)) and len(one):
        assert len(one) == len(other)
        for key in one if isinstance(one, dict) else range(len(one)):
            assert_equal(one[key], other[key])
    else:
        np.testing.assert_array_equal(other, one) if isinstance(one, np.ndarray) else None
        assert isinstance(one, np.ndarray) or one == other
        assert getattr(one, "dtype", None) == getattr(other, "dtype", None)


def test_a_result_is_loaded_as_it_was_saved(full_result, tmp_path):
    path = save_result(full_result, tmp_path / "run.h5")
    assert_equal(full_result, load_result(path))


def test_other_programs_find_the_documented_names_and_units(full_result, tmp_path):
    units = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            assert item.attrs["long_name"], name
            units[name] = item.attrs["units"]

    with h5py.File(save_result(full_result, tmp_path / "run.h5")) as file:
        file.visititems(visit)
        best = full_result.cases["best"]
        for name, expected in {
            "x": np.linspace(0, 0.2, 27), "y": np.linspace(0, 0.2, 27), "cases/best/magnitude": best.magnitude,
            "cases/best/phase": best.phase, "cases/best/energy": list(best.energy.values()),
            "localization_factor/best": best.energy["target"] / best.energy["plate"],
        }.items():  # fmt: skip
            np.testing.assert_allclose(file[name], expected, rtol=1e-15)
        assert json.loads(file["cases/best/energy"].attrs["regions"]) == list(best.energy)
        assert file["cases/best bc/energy"].attrs["status"] == "grew"
        shares = [[best.energy[f"target {name}"] / best.energy["plate"] for name in ("a", "bc")]]
        np.testing.assert_allclose(file["crosstalk"][:1], shares)
        assert json.loads(file["crosstalk"].attrs["targets"]) == ["a", "bc"]
        assert (file.attrs["interrupted"], file.attrs["title"]) == (1, full_result.scene.title)
        assert {"lost", "versions", "accuracy", "bound_kind", "node_steps", "format"} <= set(file.attrs)
    expected = {
        "x": "m", "times": "s", "trace_times": "s", "localization_factor/bound": "1", "peak_displacement": "m",
        "cases/best/magnitude": "N/m^2", "cases/best/phase": "rad", "cases/best/energy": "J",
        "cases/best/displacement": "m", "cases/best/trace": "m", "cases/best/frequency": "Hz",
        "cases/best/centre": "m", "cases/best/delay": "s", "history/best": "1", "history/mean": "1",
        "history/evaluations": "1", "objectives/velocity of the rest": "m/s", "objectives/sum": "1",
        "objectives_of/equal/contrast": "dB", "robust/fresh": "weighted", "robust/searched": "weighted",
        "spectrum/frequency": "Hz", "spectrum/resonances": "Hz", "searches/1/history/best": "1",
    }  # fmt: skip
    assert {name: units.get(name) for name in expected} == expected


def test_the_phase_lag_is_positive_and_zero_for_an_idle_actuator():
    case = Case(np.array([2, -1j, 1j, 0]), {"target": 0.0, "plate": 0.0}, np.zeros(0), np.zeros(0))
    np.testing.assert_allclose(case.phase, [0, np.pi / 2, 3 * np.pi / 2, 0])
    assert np.isnan(case.localization_factor)


def refusal_after(path, change):
    """Change a file, seal it again and return the one line with which it is refused."""
    with h5py.File(path, "r+") as file:
        change(file)
    content = path.read_bytes()
    path.write_bytes(content + make_seal(content))
    line = refused(load_result, path)
    assert line.startswith(f"{path}: ")
    return line


def replace_member(parent, name, value):
    """Replace an attribute or dataset; None removes it, a dictionary has the options of a dataset."""
    del parent[name]
    if isinstance(value, dict):
        parent.create_dataset(name, **value)
    elif value is not None:
        parent[name] = value


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("times", None, "times is missing"), ("cases", None, "cases is missing"),
        ("cases/best/real", None, "cases/best/real is missing"), ("searches/0", None, "searches/0 is missing"),
        ("spectrum/equal", None, "spectrum/equal is missing"), ("spectrum/equal", np.ones(2), "instead of (3,)"),
        ("cases/best/energy", np.ones(3), "cases/best/energy"), ("cases/best/trace", np.ones((3, 10)), "best/trace"),
        ("cases/best/centre", np.ones((4, 3)), "cases/best/centre has shape (4, 3) instead of (4, 2)"),
        ("cases/best/real", np.ones(5), "cases/best/real has shape (5,) instead of (4,)"),
        ("times", np.ones(3), "cases/best/displacement has shape (2, 27, 27) instead of (3, 27, 27)"),
        ("times", np.ones((2, 1)), "times has shape"), ("peak_displacement", np.ones(2), "displacement has shape"),
        ("times", np.array([b"text"]), "times is not a dataset of real numbers"),
        ("objectives/sum", np.array(True), "objectives/sum is not a dataset of real numbers"),
        ("times", {"shape": (10**12,), "dtype": float}, "more than the file holds"),
        ("times", {"shape": (2,), "dtype": float, "external": [("secret.raw", 0, 16)]}, "kept in another file"),
        ("times", {"shape": (2,), "dtype": float, "chunks": (1,)}, "times is in chunks"),
        ("cases/best/real", np.ones(4, np.float16), "cases/best/real has numbers of 16 bits, which this program does"),
        ("robust", np.ones(2), "robust is not a group"), ("times", h5py.SoftLink("/trace_times"), "times is a link"),
        *((name, h5py.ExternalLink("secret.h5", "data"), f"{name} is a link") for name in LINKED),
    ],
)  # fmt: skip
def test_wrong_datasets_are_refused_by_name(full_result, tmp_path, name, values, words):
    path = save_result(full_result, tmp_path / "run.h5")
    assert words in refusal_after(path, lambda file: replace_member(file, name, values))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("command", 7), ("command", None), ("interrupted", 2), ("seed", -1), ("seed", 1.5), ("seed", "3"),
        ("bound_kind", "certain"), ("scene", "title = 3"), ("effects", "[1]"), ("effects", "{}"), ("effects", "["),
        ("seed", np.ones(2)), ("effects", 3),
        ("seconds", '{"a": "1"}'), ("seconds", "[" * 10**5), ("format", "warp-plate result 3"),
    ],
)  # fmt: skip
def test_wrong_attributes_are_refused_in_one_line(full_result, tmp_path, name, value):
    line = refusal_after(
        save_result(full_result, tmp_path / "run.h5"), lambda file: replace_member(file.attrs, name, value)
    )
    assert f" {name} " in line or "its scene" in line or "damaged" in line
