"""A drive for each of several targets: what each search finds, the crosstalk, files, tables, pictures, checkpoints."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import scene_of

from warp_plate import PlateSolver, Scene, SceneError, load_result, localize, resume
from warp_plate.cli.main import main
from warp_plate.cli.output import warnings_of
from warp_plate.problem import problem
from warp_plate.result import save_result
from warp_plate.result.checkpoint import load_checkpoint, save_checkpoint
from warp_plate.result.crosstalk import best_drive_scenes, crosstalk, decibels, target_cases, target_regions
from warp_plate.scene.dump import dump_scene
from warp_plate.studies.checkpointing import CheckpointFile
from warp_plate.viz.plots.crosstalk import draw_crosstalk

TARGETS = (
    {"name": "disc", "disc": (0.06, 0.06, 0.03)},
    {"name": "left", "area": (0.0, 0.1, 0.0, 0.2)},
    {"name": "three corners", "polygon": ((0.1, 0.1), (0.19, 0.1), (0.19, 0.19))},
)
SEARCH = {"particles": 8, "iterations": 9, "seed": 3}


def panel(**tables):
    """A small scene with three targets; with other tables where these are given."""
    made = scene_of(damping=88.5, precision="float32", **{"search": SEARCH, **tables}).model_dump()
    return Scene.model_validate({**made, "targets": TARGETS, "target": alone_table(0)})


def alone_table(index):
    """The table ``[target]`` of one of them."""
    return {key: value for key, value in TARGETS[index].items() if key != "name"}


@pytest.fixture(scope="module")
def found():
    """What a search without a stop finds."""
    return localize(panel(), "mine", "cpu", estimate=False)


def alone(made, index):
    """The scene with one of its targets only."""
    return made.with_tables(targets=(), target=alone_table(index))


def test_each_drive_is_that_of_a_search_of_its_own(found):
    """To the last bit: drives, displacements, bounds, histories."""
    made = panel()
    assert list(found.cases) == ["equal", "single", "best", "best left", "best three corners"]
    assert found.evaluations == 3 * 8 * 9
    for index, case in enumerate(target_cases(made).values()):
        own = localize(alone(made, index), "mine", "cpu", estimate=False)
        np.testing.assert_array_equal(found.cases[case].phasors, own.cases["best"].phasors)
        np.testing.assert_array_equal(found.cases[case].displacement, own.cases["best"].displacement)
        assert found.cases[case].localization_factor == own.cases["best"].localization_factor
        assert found.target_searches[index].bound == own.bound
        for name, values in own.history.items():
            np.testing.assert_array_equal(found.target_searches[index].history[name], values)
    assert found.bound == found.target_searches[0].bound
    assert found.scene.target == made.target


def test_crosstalk_is_the_share_of_each_target_under_each_drive(found):
    """By one run of all three drives in float64, with the targets as regions."""
    shares = crosstalk(found)
    made = found.scene.with_tables(grid={**found.scene.grid.model_dump(), "precision": "float64"})
    drives = np.array([found.cases[case].phasors for case in target_cases(made).values()])
    run = PlateSolver(made, "cpu", areas=target_regions(made)).run(drives)
    np.testing.assert_allclose(shares, run.energy[:, 2:] / run.energy[:, :1], rtol=1e-4)
    for row, case in enumerate(target_cases(made).values()):
        assert shares[row, row] == found.cases[case].localization_factor
    np.testing.assert_allclose(decibels(shares), 10 * np.log10(shares / np.diag(shares)[:, None]), atol=1e-12)


@pytest.mark.parametrize(("kinds", "measured"), [(["localization"], 1), (["uniformity"], 3), (["displacement"], 2)])
def test_gram_matrices_are_measured_once(kinds, measured, monkeypatch):
    """Of displacements too; again for each target where an objective has regions of its own."""
    measure, calls = problem.measure_response, []
    monkeypatch.setattr(problem, "measure_response", lambda *given: calls.append(1) or measure(*given))
    limits = {"magnitude": 2.0} if "displacement" in kinds else {}
    search = {**SEARCH, "objectives": [{"kind": kind} for kind in kinds], "limits": limits}
    made = panel(search=search, nodes=(17, 17))
    found = localize(made, "mine", "cpu", evaluator="response", estimate=False)
    assert len(calls) == measured
    own = localize(alone(made, 2), "mine", "cpu", evaluator="response", estimate=False)
    np.testing.assert_array_equal(found.cases["best three corners"].phasors, own.cases["best"].phasors)


def stopped_at(count):
    def told(done, total, best):
        assert total == 27
        if done == count:
            raise KeyboardInterrupt

    return told


@pytest.mark.parametrize(("count", "index", "iterations"), [(9, 0, 9), (10, 1, 1), (25, 2, 7)])
def test_a_stopped_search_goes_on_to_the_same_bits(count, index, iterations, found, tmp_path):
    file = CheckpointFile(tmp_path / "one.checkpoint.h5", np.inf)
    left = localize(panel(), "mine", "cpu", on_progress=stopped_at(count), estimate=False, checkpoints=file)
    assert left.interrupted
    assert len(left.target_searches) == index + 1
    shares = crosstalk(left)
    assert np.isfinite(shares[: index + 1]).all()
    assert np.isnan(shares[index + 1 :]).all()
    checkpoint = load_checkpoint(file.path)
    name = TARGETS[index]["name"]
    assert checkpoint.progress == f"{iterations} of 9 iterations of target {index + 1} of 3 ({name!r})"
    gone_on = resume(checkpoint, estimate=False)
    assert (gone_on.node_steps, gone_on.evaluations) == (found.node_steps, found.evaluations)
    for case, one in found.cases.items():
        np.testing.assert_array_equal(gone_on.cases[case].phasors, one.phasors)
        assert gone_on.cases[case].energy == one.energy
    for one, other in zip(gone_on.target_searches, found.target_searches, strict=True):
        assert (one.bound, one.evaluations) == (other.bound, other.evaluations)
        assert one.single_actuator == other.single_actuator
        np.testing.assert_array_equal(one.position, other.position)


def test_a_checkpoint_of_other_targets_is_refused(tmp_path):
    file = CheckpointFile(tmp_path / "one.checkpoint.h5", np.inf)
    localize(panel(), "mine", "cpu", on_progress=stopped_at(12), estimate=False, checkpoints=file)
    checkpoint = load_checkpoint(file.path)
    save_checkpoint(replace(checkpoint, scene=checkpoint.scene.aimed_at(0)), file.path)
    with pytest.raises(SceneError, match="1 searches do not fit the scene's targets"):
        load_checkpoint(file.path)


def test_one_actuator_leaves_no_choice_for_any_target():
    made = panel()
    made = made.with_tables(actuators=[made.actuators[0].model_dump()])
    found = localize(made, "mine", "cpu", estimate=False)
    assert [one.position for one in found.target_searches] == [None] * 3
    np.testing.assert_allclose(crosstalk(found), crosstalk(found)[[0, 0, 0]], rtol=1e-12)


def test_files_keep_it(found, tmp_path):
    again = load_result(save_result(found, tmp_path / "result.h5"))
    np.testing.assert_array_equal(crosstalk(again), crosstalk(found))
    assert [one.bound for one in again.target_searches] == [one.bound for one in found.target_searches]
    np.testing.assert_array_equal(again.target_searches[2].history["best"], found.target_searches[2].history["best"])
    with h5py.File(tmp_path / "result.h5") as file:
        np.testing.assert_array_equal(file["crosstalk"][:], crosstalk(found))
        assert json.loads(file["crosstalk"].attrs["targets"]) == ["disc", "left", "three corners"]
    scenes = best_drive_scenes(again)
    assert list(scenes) == ["best", "best left", "best three corners"]
    for index, (case, scene) in enumerate(scenes.items()):
        assert scene.target == scene.targets[index].unnamed
        drive = np.array([[one.magnitude * np.exp(-1j * one.phase) for one in scene.actuators]])
        energy = PlateSolver(scene, "cpu").run(drive).energy[0]
        assert energy[1] / energy[0] == pytest.approx(found.cases[case].localization_factor, rel=1e-4)


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("panel.toml").write_text(dump_scene(panel()), encoding="utf-8")


def test_the_command_prints_the_table_and_writes_a_scene_for_each(written, capsys):
    main(["localize", "panel.toml", "--device", "cpu", "--evaluator", "response", "--no-estimate", "--no-pictures"])
    out = capsys.readouterr().out
    assert "localization factor, target disc" in out
    assert [out.count(f"Drive found for {name}") for name in ("disc", "left", "three corners")] == [1, 1, 1]
    assert "Crosstalk: share of the plate's kinetic energy in" in out
    assert " dB)" in out
    assert [Path(f"panel-localize.best{part}.toml").exists() for part in ("", ".2", ".3", ".4")] == [1, 1, 1, 0]
    second = Scene.load("panel-localize.best.2.toml")
    assert second.target == second.targets[1].unnamed


def test_places_that_no_panel_has_for_all_targets_are_told(found):
    """Of a search alone, and only where it moves actuators."""
    moved = found.scene.with_tables(search={**SEARCH, "position": {}})
    told = [line for line in warnings_of(replace(found, scene=moved)) if "places of its own" in line]
    assert len(told) == 1
    assert "Each of the 3 targets" in told[0]
    for other in (found, replace(found, scene=moved, command="simulate"), replace(found, scene=alone(moved, 0))):
        assert "places of its own" not in " ".join(warnings_of(other))


def test_the_command_s_json_has_it(written, capsys):
    main(["localize", "panel.toml", "--device", "cpu", "--json", "--no-estimate", "--no-pictures"])
    told = json.loads(capsys.readouterr().out)["crosstalk"]
    assert told["targets"] == ["disc", "left", "three corners"]
    assert told["cases"] == list(told["drives"]) == ["best", "best left", "best three corners"]
    assert np.shape(told["share"]) == np.shape(told["decibels"]) == (3, 3)
    assert len(told["bound"]) == 3
    assert [one["actuator"] for one in told["drives"]["best left"]] == ["0", "1", "2"]


def test_simulate_tells_of_every_target(written, capsys):
    main(["simulate", "panel.toml", "--device", "cpu", "--json", "--no-estimate", "--no-pictures"])
    energy = json.loads(capsys.readouterr().out)["energy"]
    assert list(energy) == ["plate", "target", "target disc", "target left", "target three corners"]
    assert energy["target"] == energy["target disc"]


def test_the_picture(found, tmp_path):
    pytest.importorskip("matplotlib")
    from PIL import Image

    for result in (found, replace(found, cases={name: found.cases[name] for name in ("equal", "single", "best")})):
        with Image.open(draw_crosstalk(result, tmp_path / "crosstalk.png")) as picture:
            assert min(picture.size) > 300
            # The drive's own share is green, and dashed outlines lie on the plates.
            colours = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
        assert ((colours[:, 1] > colours[:, 0] + 30) & (colours[:, 1] > colours[:, 2] + 30)).mean() > 0.01
    with pytest.raises(ValueError, match="one target only"):
        draw_crosstalk(replace(found, scene=alone(found.scene, 0)), tmp_path / "none.png")


def test_the_example_is_a_scene():
    made = Scene.load(Path(__file__).parents[2] / "docs" / "examples" / "three-targets.toml")
    assert [target.shape for target in made.targets] == ["disc", "polygon", "area"]
    assert np.isfinite(PlateSolver(made, "cpu", areas=target_regions(made)).run(np.ones((1, 6))).energy).all()
