"""A search that was stopped goes on to the result of one that was not."""

from dataclasses import fields, replace

import numpy as np
import pytest

from warp_plate import PlateSolver, SceneError, localize, resume
from warp_plate.result.checkpoint import load_checkpoint, previous_path, save_checkpoint
from warp_plate.studies.checkpointing import CheckpointFile

SMALL = {"search": {"particles": 8, "iterations": 9, "seed": 3}, "record": {"points": ((0.1, 0.1),)}}
# Of two runs, what the clock decides.
TIMED = {"seconds", "accuracy"}


def assert_same(one, other):
    """All that a search finds, to the last bit."""
    for name in {field.name for field in fields(one)} - TIMED - {"cases", "times", "trace_times", "history"}:
        assert getattr(one, name) == getattr(other, name), name
    np.testing.assert_array_equal(one.times, other.times)
    assert one.history.keys() == other.history.keys()
    for name in one.history:
        np.testing.assert_array_equal(one.history[name], other.history[name])
    assert one.cases.keys() == other.cases.keys()
    for name, case in one.cases.items():
        assert case.energy == other.cases[name].energy
        for part in ("phasors", "displacement", "trace"):
            np.testing.assert_array_equal(getattr(case, part), getattr(other.cases[name], part))


@pytest.fixture
def stopped(tmp_path):
    """Search until ``told`` or the solver raises KeyboardInterrupt; the checkpoint that is left."""

    def run(made, *options, on_progress=None):
        file = CheckpointFile(tmp_path / "one.checkpoint.h5", np.inf)
        result = localize(made, "mine", *options, on_progress=on_progress, estimate=False, checkpoints=file)
        assert result.interrupted
        return load_checkpoint(file.path)

    return run


def stop_after(iterations):
    def told(done, total, best):
        if done == iterations:
            raise KeyboardInterrupt

    return told


@pytest.mark.parametrize("evaluator", ["direct", "response"])
def test_from_any_iteration_to_the_same_bits(evaluator, device, path, scene, stopped):
    made = scene(damping=88.5, precision="float32", **SMALL)
    options = (device, None, evaluator, path)
    whole = localize(made, "mine", *options, estimate=False)
    for iterations in (1, 4, 8):
        checkpoint = stopped(made, *options, on_progress=stop_after(iterations))
        assert (checkpoint.iterations, checkpoint.progress) == (iterations, f"{iterations} of 9 iterations")
        assert_same(resume(checkpoint, estimate=False), whole)


@pytest.mark.parametrize("call", [3, 5, 10])
def test_ctrl_c_amid_an_iteration(call, scene, stopped, monkeypatch):
    """The swarm has moved, its losses are not known: it goes on from there, and nothing is counted twice."""
    made = scene(damping=88.5, **SMALL)
    whole = localize(made, "mine", "cpu", estimate=False)
    run, calls = PlateSolver.run, []

    def interrupted(self, *arguments, **options):
        answer = run(self, *arguments, **options)
        calls.append(1)
        if len(calls) == call:
            raise KeyboardInterrupt
        return answer

    monkeypatch.setattr(PlateSolver, "run", interrupted)
    checkpoint = stopped(made, "cpu")
    assert checkpoint.iterations == call - 3  # the response and the single actuators come first
    assert_same(resume(checkpoint, estimate=False), whole)


def test_stopped_again_and_again(scene, stopped, tmp_path):
    made = scene(damping=88.5, effects={"stretching": {}}, **SMALL)
    whole = localize(made, "mine", "cpu", estimate=False)
    checkpoint = stopped(made, "cpu", on_progress=stop_after(1))
    for iterations in range(2, 9):
        file = CheckpointFile(tmp_path / "two.checkpoint.h5", np.inf, resumes=True)
        resume(checkpoint, on_progress=stop_after(iterations), estimate=False, checkpoints=file)
        checkpoint = load_checkpoint(file.path)
        assert checkpoint.iterations == iterations
    found = resume(checkpoint, estimate=False)
    assert found.bound is None
    assert_same(found, whole)


def test_a_grid_that_was_chosen_is_not_chosen_again(scene, stopped, monkeypatch):
    """Timing takes part in the choice: it is kept with the search, and so is what was asked for."""
    asked = scene(damping=88.5, **SMALL).model_copy(update={"grid": type(scene().grid)(accuracy=0.3)})
    whole = None

    def keep(done, total, best):
        if done == 2:
            raise KeyboardInterrupt

    checkpoint = stopped(asked, "cpu", on_progress=keep)
    assert checkpoint.scene_as_written == asked
    monkeypatch.setattr("warp_plate.studies.grid_choice.choose", None)
    found = resume(checkpoint, estimate=False)
    whole = localize(checkpoint.scene, "mine", "cpu", estimate=False)
    assert_same(found, whole)
    assert found.accuracy == checkpoint.accuracy
    assert found.accuracy["asked"] == 0.3


def test_another_device_only_by_name(scene, stopped):
    checkpoint = stopped(scene(**SMALL), "cpu", on_progress=stop_after(2))
    elsewhere = replace(checkpoint, device="cuda:7", processor="another one")
    with pytest.raises(SceneError, match=r"began on cuda:7 \(another one\).*--device") as refused:
        resume(elsewhere)
    assert "\n" not in str(refused.value)
    found = resume(elsewhere, "cpu", estimate=False)
    assert found.device.startswith("cuda:7 (another one), then cpu")
    older = resume(replace(checkpoint, versions={**checkpoint.versions, "warp": "0.1"}), estimate=False)
    assert older.versions["warp"] == f"0.1, then {checkpoint.versions['warp']}"


def test_a_search_that_moved_goes_on_where_it_is(scene, stopped, tmp_path):
    checkpoint = stopped(scene(**SMALL), "cpu", on_progress=stop_after(2))
    elsewhere = replace(checkpoint, device="cuda:7", processor="another one")
    file = CheckpointFile(tmp_path / "two.checkpoint.h5", np.inf, resumes=True)
    resume(elsewhere, "cpu", on_progress=stop_after(4), estimate=False, checkpoints=file)
    moved = load_checkpoint(file.path)
    assert (moved.device, moved.processor) == (checkpoint.device, checkpoint.processor)
    found = resume(moved, estimate=False)
    assert found.device.startswith("cuda:7 (another one), then cpu")
    assert found.versions == checkpoint.versions


def test_checkpoints_come_by_the_clock(scene, tmp_path, monkeypatch):
    """None before its time, one an iteration with 0, and the one before is kept."""
    made, now = scene(**SMALL), [0.0]
    monkeypatch.setattr("warp_plate.studies.checkpointing.time.monotonic", lambda: now[0])
    written = []

    def told(done, total, best):
        now[0] += 1.0
        path = tmp_path / "a.checkpoint.h5"
        if path.exists() and (not written or load_checkpoint(path).iterations != written[-1]):
            written.append(load_checkpoint(path).iterations)

    for every, expected in ((4.0, [5, 9]), (0.0, [*range(1, 10)]), (100.0, [])):
        file = CheckpointFile(tmp_path / "a.checkpoint.h5", every)
        localize(made, "", "cpu", on_progress=told, estimate=False, checkpoints=file)
        assert written == expected
        if len(expected) > 1:
            assert load_checkpoint(previous_path(file.path)).iterations == expected[-2]
        file.remove()
        assert not list(tmp_path.iterdir())
        written.clear()


def test_the_one_before_is_never_that_of_another_search(scene, tmp_path, stopped):
    checkpoint = stopped(scene(**SMALL), "cpu", on_progress=stop_after(2))
    path = tmp_path / "a.checkpoint.h5"
    other = replace(checkpoint, seed=99)
    save_checkpoint(other, path)
    save_checkpoint(other, previous_path(path))
    file = CheckpointFile(path)
    file.save(checkpoint)
    assert not previous_path(path).exists()
    file.save(checkpoint)
    assert load_checkpoint(previous_path(path)).seed == checkpoint.seed


@pytest.mark.parametrize(
    "tables",
    [
        {"drive": {"frequency": 290.0, "burst": {"duration": 0.005, "ramp": 0.001}}},
        {"drive": {"frequency": 290.0, "electrostatic": {"bias": 2.0, "gain": 0.5}}},
        {"effects": {"moving_load": {"force": 0.1, "start": (0.05, 0.1), "velocity": (3.0, 0.0)}}},
    ],
    ids=["burst", "electrostatic", "moving load"],
)
def test_drives_of_every_kind(tables, scene, stopped):
    made = scene(**SMALL)
    made = made.with_tables(**{**tables, **({"drive": made.drive.model_dump()} if "drive" not in tables else {})})
    whole = localize(made, "mine", "cpu", estimate=False)
    assert_same(resume(stopped(made, "cpu", on_progress=stop_after(4)), estimate=False), whole)
