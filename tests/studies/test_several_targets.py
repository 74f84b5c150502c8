"""A drive for each of several targets: searches, crosstalk, files, tables, pictures and checkpoints."""

import json
from dataclasses import asdict
from pathlib import Path

import h5py
import numpy as np
import pytest

from support.commands import output_of
from support.scenes import scene_of
from support.searches import assert_same_results, interrupted_search
from warp_plate import PlateSolver, Scene, load_result, localize, resume
from warp_plate.plate.scheme import make_scheme
from warp_plate.result.case import relative_to_own, target_cases
from warp_plate.result.model import best_drive_scenes, crosstalk, save_result
from warp_plate.studies.simulate import simulate

TARGETS = (
    {"name": "disc", "disc": (0.06, 0.06, 0.03)},
    {"name": "left", "area": (0.0, 0.1, 0.0, 0.2)},
    {"name": "three corners", "polygon": ((0.1, 0.1), (0.19, 0.1), (0.19, 0.19))},
)
SEARCH = {"particles": 8, "iterations": 9, "seed": 3}


def panel_of_targets(**tables):
    """A small scene with three targets."""
    made = scene_of(damping=88.5, precision="float32", **{"search": SEARCH, **tables})
    return single_target(made, 0).with_tables(targets=TARGETS)


def single_target(scene, index):
    """The scene with one of its targets only."""
    target = {key: value for key, value in TARGETS[index].items() if key != "name"}
    return scene.with_tables(targets=(), target=target)


@pytest.fixture(scope="module")
def whole():
    """The result of an uninterrupted search."""
    return localize(panel_of_targets(), source="mine", device="cpu", estimate=False)


def test_each_search_equals_that_of_a_single_target(whole):
    scene = panel_of_targets()
    assert list(whole.cases) == ["equal", "single", "best", "best left", "best three corners"]
    assert (whole.evaluations, whole.bound, whole.scene.target) == (216, whole.target_searches[0].bound, scene.target)
    # Gram matrices once; for each target single actuators, the swarm and three cases.
    assert whole.node_steps == 11 * 11 * make_scheme(whole.scene).steps * (21 + 3 * (3 + 72 + 3))
    for index, case in enumerate(target_cases(scene.targets).values()):
        single = localize(single_target(scene, index), source="mine", device="cpu", estimate=False)
        search, best = whole.target_searches[index], single.cases["best"]
        np.testing.assert_array_equal(whole.cases[case].phasors, best.phasors)
        np.testing.assert_array_equal(whole.cases[case].displacement, best.displacement)
        assert whole.cases[case].localization_factor == best.localization_factor
        assert search.bound == single.bound
        np.testing.assert_equal(search.history, single.history)


def test_crosstalk_is_the_share_of_each_target_under_each_drive(whole):
    """Compared with one run of all three drives in float64, with the targets as regions."""
    shares = crosstalk(whole)
    scene = whole.scene.with_tables(grid={**whole.scene.grid.model_dump(), "precision": "float64"})
    phasors = np.array([whole.cases[case].phasors for case in target_cases(scene.targets).values()])
    run = PlateSolver(scene, "cpu", areas=scene.target_regions).run(phasors)
    np.testing.assert_allclose(shares, run.energy[:, 2:] / run.energy[:, :1], rtol=1e-4)
    for row, case in enumerate(target_cases(scene.targets).values()):
        assert shares[row, row] == whole.cases[case].localization_factor
    np.testing.assert_allclose(relative_to_own(shares), 10 * np.log10(shares / np.diag(shares)[:, None]), atol=1e-12)


@pytest.mark.parametrize(("count", "index", "iterations"), [(9, 0, 9), (25, 2, 7)])
def test_an_interrupted_search_resumes_bit_identically(count, index, iterations, whole, tmp_path):
    left, checkpoint = interrupted_search(tmp_path, panel_of_targets(), device="cpu", after=count)
    assert len(left.target_searches) == index + 1
    shares = crosstalk(left)
    assert np.isfinite(shares[: index + 1]).all()
    assert np.isnan(shares[index + 1 :]).all()
    name = TARGETS[index]["name"]
    assert checkpoint.progress == f"{iterations} of 9 iterations of target {index + 1} of 3 ({name!r})"
    assert_same_results(resume(checkpoint, estimate=False), whole)


def test_files_keep_the_searches(whole, tmp_path):
    again = load_result(save_result(whole, tmp_path / "result.h5"))
    np.testing.assert_equal([asdict(search) for search in again.target_searches],
                            [asdict(search) for search in whole.target_searches])  # fmt: skip
    with h5py.File(tmp_path / "result.h5") as file:
        np.testing.assert_array_equal(file["crosstalk"][:], crosstalk(whole))
        assert json.loads(file["crosstalk"].attrs["targets"]) == ["disc", "left", "three corners"]
    scenes = best_drive_scenes(again)
    assert list(scenes) == ["best", "best left", "best three corners"]
    for index, (case, scene) in enumerate(scenes.items()):
        assert scene.target == scene.targets[index].unnamed
        drive = simulate(scene, device="cpu", estimate=False).cases["drive"]
        assert drive.localization_factor == pytest.approx(whole.cases[case].localization_factor, rel=1e-4)


QUICK = ("panel.toml", "--device", "cpu", "--no-estimate", "--no-pictures")


def test_the_commands(command, write_scene):
    """Tables, a scene for each target, and JSON; simulate shows the energy of every target."""
    write_scene(panel_of_targets())
    out = output_of(command("localize", *QUICK, "--evaluator", "response"))
    assert "localization factor, target disc" in out
    assert [out.count(f"Drive found for {name}") for name in ("disc", "left", "three corners")] == [1, 1, 1]
    assert "Crosstalk: share of the plate's kinetic energy in" in out
    assert [Path(f"panel-localize.best{part}.toml").exists() for part in ("", ".2", ".3", ".4")] == [1, 1, 1, 0]
    second = Scene.load("panel-localize.best.2.toml")
    assert second.target == second.targets[1].unnamed
    record = json.loads(output_of(command("localize", *QUICK, "--json")))["crosstalk"]
    assert record["targets"] == ["disc", "left", "three corners"]
    assert record["cases"] == list(record["drives"]) == ["best", "best left", "best three corners"]
    assert np.shape(record["share"]) == np.shape(record["decibels"]) == (3, 3)
    assert [one["actuator"] for one in record["drives"]["best left"]] == ["0", "1", "2"]
    energy = json.loads(output_of(command("simulate", *QUICK, "--json")))["energy"]
    assert list(energy) == ["plate", "target", "target disc", "target left", "target three corners"]
    assert energy["target"] == energy["target disc"]
