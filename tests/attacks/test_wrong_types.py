"""Arguments of public functions that are of another type: one line that names the argument."""

from pathlib import Path
from types import NoneType

import numpy as np
import pytest

import warp_plate
from support.scenes import MATERIAL, refused, scene_of
from warp_plate.modal.radiation import Air

SCENE = scene_of((9, 9), damping=88.5, window=(0.001, 0.004))
WRONG = (None, 5, float("nan"), b"paper", ["paper"], {}, np.zeros(3), object(), ValueError("a"))
# Functions by their arguments, with what else they need.
OF_SCENES = "check", "fit", "focus", "frf", "localize", "modes", "simulate", "specify", "sweep", "PlateSolver"
OTHERS = {"fit": {"data": "a.csv"}, "sweep": {"vary": ["drive.frequency=280,290"]}}
OF_PATHS = "load_checkpoint", "load_focus", "load_result", "load_sweep"
OF_RESULTS = {"export": ("a.csv", "csv"), "motion": (), "save_result": ("a.h5",), "save_focus": ("a.h5",),
              "save_sweep": ("a.h5",), "verify": ("a.csv",)}  # fmt: skip


@pytest.fixture(scope="module")
def result():
    """The result of a run."""
    return warp_plate.simulate(SCENE, device="cpu", estimate=False)


@pytest.mark.parametrize("wrong", WRONG, ids=lambda value: type(value).__name__)
def test_arguments_of_wrong_types(wrong, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kind = f", not a {type(wrong).__name__}"
    for name in OF_SCENES:
        message = refused(lambda name=name: getattr(warp_plate, name)(wrong, **OTHERS.get(name, {})))
        assert message.startswith("scene: must be a Scene or ")
        assert message.endswith(kind)
    for name in OF_PATHS:
        assert refused(getattr(warp_plate, name), wrong) == f"path: must be a str or Path{kind}"
    for name, others in OF_RESULTS.items():
        message = refused(getattr(warp_plate, name), wrong, *others)
        assert message.startswith(("result: must be a ", "sweep: must be a Sweep"))
        assert message.endswith(kind)
    assert refused(warp_plate.PlateSolver, SCENE, wrong) == f"device: must be a str{kind}"
    assert refused(lambda: warp_plate.PlateSolver(SCENE, "cpu", per_plate=wrong)).endswith(kind)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wrong", WRONG, ids=lambda value: type(value).__name__)
def test_arguments_of_sweeps_of_wrong_types(wrong):
    arguments = {"source", "frequencies", "vary", "on_progress", "pool"}
    if wrong is not None:
        arguments |= {"what", "path", "evaluator"}
    if not isinstance(wrong, int | None):
        arguments |= {"samples", "seed", "count"}
    for argument in arguments - ({"on_progress", "pool"} if wrong is None else set()):
        message = refused(lambda name=argument: warp_plate.sweep(SCENE, **{"vary": ["plate.density=9,8"], name: wrong}))
        assert message.startswith((argument, f"--{argument}")), message
    message = refused(warp_plate.sweep, SCENE, [wrong])
    assert message == f"vary[0]: must be a str, not a {type(wrong).__name__}"


@pytest.mark.parametrize("wrong", WRONG, ids=lambda value: type(value).__name__)
def test_arguments_of_searches_and_pictures_of_wrong_types(wrong, result):
    kind = type(wrong).__name__
    for argument in ("source", "checkpoints", "pool", "on_progress", "seed"):
        if argument != "source" and (wrong is None or (argument == "seed" and isinstance(wrong, int))):
            continue
        message = refused(lambda name=argument: warp_plate.localize(SCENE, device="cpu", **{name: wrong}))
        assert message.startswith(argument)
    for flag in ("estimate", "spectrum", "baselines"):
        message = refused(lambda name=flag: warp_plate.localize(SCENE, device="cpu", **{name: wrong}))
        assert message == f"{flag}: must be a bool, not a {kind}"
    if wrong is not None:
        message = refused(lambda: warp_plate.localize(SCENE, device="cpu", evaluator=wrong))
        assert message == f"evaluator = {wrong!r}: must be 'direct', 'response' or 'modal'"
    assert refused(warp_plate.resume, wrong) == f"checkpoint: must be a Checkpoint, not a {kind}"
    assert refused(warp_plate.view, wrong) == f"result: must be a Result, not a {kind}"
    assert refused(warp_plate.render, result, wrong) == f"path: must be a str or Path, not a {kind}"
    assert refused(warp_plate.verify, result, wrong) == f"data: must be a Path or MeasuredField, not a {kind}"
    assert refused(warp_plate.plot, result, wrong) == f"stem: must be a str or Path, not a {kind}"
    assert refused(lambda: warp_plate.specify("console", tolerances=wrong)).startswith("tolerances: must be a bool")
    assert refused(warp_plate.Scene.parse, wrong, "a") == f"text: must be a str, not a {kind}"
    assert refused(SCENE.replace, wrong, 1) == f"key: must be a str, not a {kind}"
    assert refused(warp_plate.Scene.load, "paper", [wrong]) == f"assignments[0]: must be a str, not a {kind}"
    assert refused(warp_plate.Scene.load, "paper", "drive.frequency=3") == (
        "assignments: must be a list or tuple, not a str"
    )
    if wrong is not None and not isinstance(wrong, int):
        assert refused(lambda: warp_plate.view(result, frames=wrong)).startswith("frames = ")
        assert refused(lambda: warp_plate.measure_accuracy(SCENE, budget=wrong)).startswith("budget = ")


def test_ranges_that_are_iterators(result):
    """A range is read once."""
    assert warp_plate.motion(result, frames=2, span=iter((0.001, 0.004)), device="cpu").span == (0.001, 0.004)
    of_tuple = warp_plate.frf(SCENE, frequency_range=(280, 300)).frequencies
    assert np.array_equal(warp_plate.frf(SCENE, frequency_range=iter((280, 300))).frequencies, of_tuple)
    assert warp_plate.sound(SCENE, frequency_range=map(float, (280, 300))).frequencies[-1] == 300


@pytest.mark.parametrize("wrong", [*WRONG, (1, "a"), (1, 2, 3), 10**400, "ab"], ids=lambda value: type(value).__name__)
def test_further_arguments_of_wrong_types(wrong, result):
    """One line that begins with the argument, whatever else is valid."""
    calls = {
        "points": lambda: warp_plate.sound(SCENE, points=wrong),
        "path": lambda: warp_plate.PlateSolver(SCENE, "cpu", path=wrong),
        "quantity": lambda: warp_plate.PlateSolver(SCENE, "cpu", quantity=wrong),
        "drive": lambda: warp_plate.simulate(SCENE, device="cpu", drive=wrong),
        "estimate": lambda: warp_plate.simulate(SCENE, device="cpu", estimate=wrong),
    }
    if np.shape(wrong) != (3,):
        calls["points[0]"] = lambda: warp_plate.sound(SCENE, points=[wrong])
    if wrong is not None:
        calls |= {
            "frequency_range": lambda: warp_plate.frf(SCENE, frequency_range=wrong),
            "frequency_range ": lambda: warp_plate.sound(SCENE, frequency_range=wrong),
            "span": lambda: warp_plate.motion(result, span=wrong),
            "progress": lambda: warp_plate.simulate(SCENE, device="cpu", progress=wrong),
            "air": lambda: warp_plate.sound(SCENE, air=wrong),
        }
    if not isinstance(wrong, int | None):
        calls |= {
            "case": lambda: warp_plate.motion(result, case=0.5 if isinstance(wrong, str) else wrong),
            "frames": lambda: warp_plate.motion(result, frames=wrong),
            "chunk": lambda: warp_plate.PlateSolver(SCENE, "cpu", chunk=wrong),
        }
    if not isinstance(wrong, NoneType) and repr(wrong) != "5":
        calls["threads"] = lambda: warp_plate.PlateSolver(SCENE, "cpu", threads=wrong)
    for argument, call in calls.items():
        message = refused(call)
        assert message.removeprefix("--").startswith(argument.strip()), message
        assert "must be" in message or "no such" in message


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e200, "1", True])
def test_numbers_that_are_none(wrong):
    """Of points, ranges and the air, not finite or of another type; they made all results NaN."""
    assert refused(lambda: warp_plate.sound(SCENE, points=[(wrong, 0.1, 1)])).endswith("must be x, y, z in metres")
    assert "must be two positive frequencies" in refused(lambda: warp_plate.frf(SCENE, frequency_range=(0.1, wrong)))
    air = Air(density=wrong)
    assert refused(lambda: warp_plate.sound(SCENE, air=air)).startswith("air.density = ")


def test_points_in_arrays():
    places = np.array([[0.05, 0.05], [0.1, 0.1]])
    of_array = warp_plate.frf(SCENE, inputs=places, points=places, frequency_range=(50, 100))
    of_list = warp_plate.frf(SCENE, inputs=places.tolist(), points=places.tolist(), frequency_range=(50, 100))
    np.testing.assert_array_equal(of_array.responses, of_list.responses)
    for points in ([1, 2], [None], [[0.1, 0.1, 0.1]], np.zeros(3), "ab", np.array(0.1), [(10**400, 0.1)]):
        assert refused(lambda points=points: warp_plate.frf(SCENE, points=points)).startswith("points: must be a list")
    assert "quantity = None: must be one of" in refused(lambda: warp_plate.frf(SCENE, quantity=None))


def test_points_off_an_outline_have_no_responses():
    scene = SCENE.with_tables(plate={**MATERIAL, "outline": {"disc": (0.1, 0.1, 0.1)}}, edges={"outline": "clamped"},
                              actuators=[{"name": "a", "area": (0.08, 0.1, 0.08, 0.1), "force": 1.0}])  # fmt: skip
    for key in ("points", "inputs"):
        message = refused(lambda key=key: warp_plate.frf(scene, frequency_range=(50, 100), **{key: [(0.01, 0.01)]}))
        assert message == f"{key} = 0.01,0.01: is off the plate; name a point inside the outline, not in a hole"


@pytest.mark.parametrize("count", [0, -1, 2.5, np.float32(3), "3", [3], float("nan"), True])
def test_counts_of_modes_are_whole_numbers(count):
    assert refused(lambda: warp_plate.modes(SCENE, count)).startswith(f"count = {count!r}: must be a whole number")


def test_a_scene_may_be_a_preset_a_path_or_a_scene(tmp_path):
    (tmp_path / "a.toml").write_text(SCENE.to_toml(), encoding="utf-8")
    for source in (SCENE, str(tmp_path / "a.toml"), Path(tmp_path / "a.toml")):
        assert warp_plate.Scene.load(source) == SCENE
