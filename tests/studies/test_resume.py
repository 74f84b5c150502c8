"""An interrupted search continues to the result of an uninterrupted one."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from support.inline_pool import InlinePool
from support.scenes import scene_of
from support.searches import assert_same_results, interrupted_search
from warp_plate import CheckpointFile, SceneError, load_checkpoint, localize, resume
from warp_plate.result.checkpoint import Checkpoint, save_checkpoint
from warp_plate.scene.grid import Grid
from warp_plate.studies.localize import load_to_resume
from warp_plate.studies.unfinished import device_like

SEARCH = {"search": {"particles": 8, "iterations": 9, "seed": 3}, "record": {"points": ((0.1, 0.1),)}}


@pytest.mark.parametrize(("evaluator", "iterations"), [("direct", 8), ("response", 4)])
def test_bit_identical_from_any_iteration(evaluator, iterations, device, path, tmp_path):
    scene = scene_of(damping=88.5, precision="float32", **SEARCH)
    options = {"device": device, "evaluator": evaluator, "path": path}
    result, checkpoint = interrupted_search(tmp_path, scene, after=iterations, **options)
    assert (checkpoint.iterations, checkpoint.progress) == (iterations, f"{iterations} of 9 iterations")
    full = localize(scene, source="mine", estimate=False, **options)
    assert (result.evaluations, result.bound) == (8 * iterations, full.bound)
    np.testing.assert_array_equal(result.history["best"], full.history["best"][:iterations])
    assert result.cases["best"].localization_factor == pytest.approx(result.history["best"][-1], abs=2e-6)
    assert_same_results(resume(checkpoint, estimate=False), full)


def test_checkpoints_are_written_when_due_and_removed_with_what_kills_left(tmp_path, monkeypatch):
    search, written = scene_of(search={"particles": 4, "iterations": 3, "method": "pso"}), []
    monkeypatch.setattr("warp_plate.studies.unfinished.save_checkpoint", lambda start, path: written.append(path))
    for every, count in ((0, 4), (np.inf, 0), (30, 0)):  # one before the first iteration
        file = CheckpointFile(tmp_path / f"{every}.checkpoint.h5", every)
        localize(search, device="cpu", estimate=False, checkpoints=file)
        assert written.count(file.path) == count
    for name in (file.path.name, f".{file.path.name}.1a2b.part.h5", "other.checkpoint.h5"):
        (tmp_path / name).touch()
    file.remove()
    assert [path.name for path in tmp_path.iterdir()] == ["other.checkpoint.h5"]


class Interrupted(InlinePool):
    """A pool that Ctrl-C interrupts after so many tasks."""

    def __init__(self, tasks):
        super().__init__()
        self.left = tasks

    def run(self, function, argument):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt
        return super().run(function, argument)


def test_a_checkpoint_is_due_some_seconds_after_the_last(tmp_path, monkeypatch):
    times = iter([0.0, 29.9, 30.0, 31.0, 60.9, 61.0])
    monkeypatch.setattr("warp_plate.studies.unfinished.time", SimpleNamespace(monotonic=lambda: next(times)))
    monkeypatch.setattr("warp_plate.studies.unfinished.save_checkpoint", lambda start, path: None)
    file = CheckpointFile(tmp_path / "a.checkpoint.h5")
    assert [file.due(), file.due()] == [False, True]
    file.save(MagicMock(spec=Checkpoint))
    assert [file.due(), file.due()] == [False, True]


@pytest.mark.parametrize("error", [RuntimeError("of a driver"), SceneError("of a worker")])
def test_an_error_leaves_a_checkpoint(error, tmp_path):
    def fail(done, total, best):
        if done == 2:
            raise error

    file = CheckpointFile(tmp_path / "a.checkpoint.h5", np.inf)
    with pytest.raises(type(error), match="of a"):
        localize(scene_of(**SEARCH), device="cpu", estimate=False, on_progress=fail, checkpoints=file)
    assert load_checkpoint(file.path).iterations == 2


def test_interrupted_between_ask_and_tell(tmp_path):
    """Positions are new and their losses unknown; nothing is lost or counted twice."""
    scene = scene_of(damping=88.5, **SEARCH)
    full = localize(scene, source="mine", device="cpu", estimate=False, pool=InlinePool())
    _, checkpoint = interrupted_search(tmp_path, scene, device="cpu", pool=Interrupted(6))
    assert 0 < checkpoint.iterations < 9
    assert_same_results(resume(checkpoint, estimate=False, pool=InlinePool()), full)


def test_the_chosen_grid_is_kept(tmp_path):
    search = {**SEARCH["search"], "frequency": {"range": [100.0, 400.0]}}
    written = scene_of(damping=88.5, search=search).model_copy(update={"grid": Grid(accuracy=0.3)})
    options = {"device": "cpu", "evaluator": "direct"}
    _, checkpoint = interrupted_search(tmp_path, written, after=2, **options)
    assert checkpoint.scene_as_written == written
    assert checkpoint.scene.drive == written.drive
    assert checkpoint.scene.grid.time_step <= 1 / 20 / 400
    found = resume(checkpoint, estimate=False)
    assert_same_results(found, localize(checkpoint.scene, source="mine", estimate=False, **options))
    assert found.accuracy == checkpoint.accuracy
    assert found.accuracy["asked"] == 0.3


def test_another_device_and_other_versions_are_kept(tmp_path):
    _, checkpoint = interrupted_search(tmp_path, scene_of(**SEARCH), device="cpu", after=2)
    elsewhere = replace(checkpoint, device="cuda:7", processor="another one")
    assert device_like(checkpoint) == "cpu"
    older = replace(elsewhere, versions={**checkpoint.versions, "warp": "0.1"})
    lines = []
    save_checkpoint(older, tmp_path / "older.checkpoint.h5")
    load_to_resume(tmp_path / "older.checkpoint.h5", None, "cpu", lines.append)
    assert "continues on cpu" in lines[0]
    assert lines[0].endswith("which rounds differently: the result may differ")
    assert "began with warp 0.1, this is " in lines[1]
    found = resume(older, estimate=False)
    assert found.device.startswith("cuda:7 (another one), then ")
    assert found.versions == {**checkpoint.versions, "warp": f"0.1, then {checkpoint.versions['warp']}"}
