"""Sweeps: quantities as the commands find them, refused points, files, workers, and resuming."""

import math

import numpy as np
import pytest

from support.inline_pool import InlinePool
from support.scenes import scene_of
from warp_plate import SceneError, load_sweep, sweep
from warp_plate.cluster.tasks import run_task
from warp_plate.modal.continuous_modes import continuous_modes
from warp_plate.plate import memory
from warp_plate.result.sweep import REFUSED, RUN, save_sweep
from warp_plate.scene.vary import make_plan, parse_vary
from warp_plate.studies.frequency_response import frf, respond_to_drive
from warp_plate.studies.localize import localize
from warp_plate.studies.simulate import simulate
from warp_plate.studies.sweep import SweepRequest, choose_evaluator, resume_sweep, run_sweep, save_finished, start_sweep
from warp_plate.studies.sweep_points import QUANTITIES, run_here, run_on_pool, run_point
from warp_plate.studies.unfinished import CheckpointFile


@pytest.fixture
def swept_plate():
    """A small scene whose thickness may be too large for its time step."""
    return scene_of(damping=88.5, time_step=2e-4, search={"particles": 8, "iterations": 10}, modal_density=0.5)


def plan_of(scene, *vary, samples=None):
    return make_plan([parse_vary(scene, text) for text in vary], samples, 0)


@pytest.mark.parametrize("evaluator", ["modal", "direct"])
def test_quantities_are_those_of_the_commands(swept_plate, evaluator):
    plan = plan_of(swept_plate, "drive.frequency=250,290", "actuators[1].phase=1.5")
    by_modes = evaluator == "modal"
    found = {}
    for what, quantities in QUANTITIES.items():
        asked = evaluator if evaluator in quantities.evaluators else None
        result = sweep(swept_plate, plan, what, device="cpu", count=3, evaluator=asked, frequencies="100,250")
        assert result.evaluator == asked or quantities.evaluators == (result.evaluator,)
        found[what] = result.values
    for point in (0, 1):
        scene = swept_plate.with_values(plan.values(point))
        at = {what: {name: array[point] for name, array in values.items()} for what, values in found.items()}
        single = simulate(scene, device="cpu", path="modal" if by_modes else "auto", estimate=False)
        assert at["simulate"] == {
            "localization_factor": single.cases["drive"].localization_factor,
            "energy_plate": single.cases["drive"].energy["plate"],
            "energy_target": single.cases["drive"].energy["target"],
            "peak_displacement": single.peak_displacement,
        }
        searched = localize(scene, device="cpu", evaluator="modal" if by_modes else "response", estimate=False)
        factors = {name: case.localization_factor for name, case in searched.cases.items()}
        for name in ("equal", "single"):
            assert at["localize"][name] == pytest.approx(factors[name], rel=1e-9)
        assert at["localize"]["bound"] == pytest.approx(searched.bound, rel=1e-9)
        assert factors["best"] <= at["localize"]["best"] * (1 + 1e-9) <= searched.bound * (1 + 3e-9)
        np.testing.assert_allclose(at["modes"]["frequency"], continuous_modes(scene, 3).frequencies, rtol=1e-7)
        response = frf(scene, frequency_range=(90, 260))
        nearest = np.abs(response.frequencies - 100).argmin()
        at_nearest = respond_to_drive(scene, response.frequencies[[nearest]])
        assert at_nearest[1] == pytest.approx(response.localization_factor[[nearest]], rel=1e-5)
        assert at_nearest[2] == pytest.approx(response.bound[[nearest]], rel=1e-5)
        at_one = respond_to_drive(scene, np.array([250.0]))
        assert [values[1] for values in at["frf"].values()] == pytest.approx([float(*values) for values in at_one])
        assert at["check"]["time_step"] == 2e-4
        assert at["check"]["steps_a_period"] == pytest.approx(1 / (scene.drive.frequency * 2e-4))


SEARCH = {"particles": 6, "iterations": 8}


@pytest.mark.parametrize(
    ("tables", "evaluator"),
    [
        ({"search": {**SEARCH, "method": "gradient", "limits": {"equal_magnitudes": True}}}, "response"),
        ({"effects": {"stretching": {}}, "search": SEARCH}, "direct"),
        ({"actuators": [(0.03, 0.06, 0.03, 0.06)]}, "response"),
        ({"search": {**SEARCH, "robust": {"thickness": 0.05, "scenarios": 2, "fresh": 1}}}, "response"),
    ],
    ids=["limits", "nonlinear", "one actuator", "robust"],
)
def test_what_no_eigenvector_answers_is_searched(tables, evaluator):
    scene = scene_of((9, 9), **{"damping": None if "effects" in tables else 88.5, **tables})
    found = sweep(scene, ["drive.frequency=290"], device="cpu", evaluator="direct").values
    searched = localize(scene, device="cpu", evaluator=evaluator, estimate=False)
    assert found["best"][0] == pytest.approx(searched.cases["best"].localization_factor, rel=1e-6)
    expected = math.nan if searched.bound is None else searched.bound
    assert found["bound"][0] == pytest.approx(expected, rel=1e-9, nan_ok=True)


def test_refused_points_have_a_reason_and_others_run(swept_plate):
    found = sweep(swept_plate, ["plate.thickness=5e-4,2e-3,0.1", "drive.frequency=250,290"], "check", device="cpu")
    assert found.status.tolist() == [RUN, RUN, REFUSED, REFUSED, REFUSED, REFUSED]
    assert np.isfinite(found.shaped("limit")[0]).all()
    assert np.isnan(found.shaped("limit")[1:]).all()
    assert "grid.time_step = 0.0002: above the stability limit" in found.reasons[2]
    assert "not thin" in found.reasons[4]
    assert found.refusal(2).startswith("at plate.thickness = 0.002, drive.frequency = 250: grid.time_step = 0.0002: ab")
    with pytest.raises(SceneError, match=r"all points are refused; grid\.order = 3: must be 2 or 4 \(and 1 point more"):
        sweep(swept_plate, ["grid.order=3,5"], "check", device="cpu")


def test_keys_without_effect(swept_plate):
    for vary, samples, keys in (
        (["drive.frequency=200,300", "search.seed=1,2", "plate.density=1000"], None, ("search.seed",)),
        (["search.seed=1:9"], 3, ("search.seed",)),
        (["search.seed=1:9", "drive.frequency=200:300"], 3, ()),
    ):
        found = sweep(swept_plate, vary, "check", samples, device="cpu")
        assert found.keys_without_effect == keys
        assert found.warnings == tuple(f"{key} has no effect on the results" for key in keys)


def test_a_sweep_interrupted_anywhere_resumes_to_the_same(swept_plate, tmp_path, random):
    vary = ["plate.thickness=4e-4:2e-3:5", "drive.frequency=log:200:300:2"]
    plan, file, described = plan_of(swept_plate, *vary), tmp_path / "a.h5", []

    def on_progress(done, total, note):
        described.append(note)
        if random.random() < 0.4:
            raise KeyboardInterrupt

    current = start_sweep(SweepRequest(swept_plate, vary=plan, what="modes", count=2), "cpu")
    while not current.finished:
        kept = CheckpointFile(file, math.inf)
        try:
            current = run_sweep(current, on_progress, kept)
        except KeyboardInterrupt:
            current = resume_sweep(load_sweep(file))
    full, read = sweep(swept_plate, plan, "modes", device="cpu", count=2), load_sweep(save_sweep(current, file))
    for name in ("values", "status", "reasons"):
        np.testing.assert_equal(getattr(read, name), getattr(full, name))
    assert len(described) == len(set(described)) == len(plan)  # no point is run twice
    assert read.plan.same(plan)
    assert read.plan.logarithmic == (False, True)
    assert (read.scene, read.what, read.count, read.outputs) == (swept_plate, "modes", 2, full.outputs)


@pytest.mark.parametrize(
    ("tables", "keys", "path", "evaluator"),
    [
        ({}, ["drive.frequency"], "auto", "modal"),
        ({}, ["drive.frequency", "grid.nodes[0]"], "auto", "direct"),
        ({}, ["drive.frequency"], "streaming", "direct"),
        ({"effects": {"stretching": {}}}, ["drive.frequency"], "auto", "direct"),
        ({"effects": {"loss_factor": {"eta": 0.1}}}, ["grid.nodes[0]"], "auto", "modal"),
    ],
)
def test_linear_scenes_are_swept_by_modes(tables, keys, path, evaluator):
    assert choose_evaluator(scene_of((9, 9), **tables), keys, "localize", path) == evaluator


def test_only_linear_scenes_are_swept_by_modes():
    with pytest.raises(SceneError, match=r"effects\.stretching needs time steps; write 'direct'"):
        choose_evaluator(scene_of((9, 9), effects={"stretching": {}}), [], "localize", "auto", "modal")
    with pytest.raises(SceneError, match=r"all points are refused.*effects\.stretching"):
        sweep(scene_of((9, 9), effects={"stretching": {}}), ["plate.density=1000"], "frf", frequencies="100")


def test_workers_are_sent_the_files_that_vary(tmp_path):
    for name, factor in (("a.csv", 1.0), ("b.csv", 1.2)):
        (tmp_path / name).write_text(f"{factor},1.1\n", encoding="utf-8")
    (tmp_path / "c.csv").write_text("thick\n", encoding="utf-8")
    scene = scene_of((9, 9), effects={"variation": {"thickness": "a.csv"}}).in_folder(tmp_path)
    vary, asked = ["effects.variation.thickness=*.csv", "edges.left=clamped,glued"], {"frequencies": "100,200"}
    here = sweep(scene, vary, "frf", device="cpu", **asked)
    away = sweep(scene, vary, "frf", pool=InlinePool(), **asked)
    np.testing.assert_equal(away.values, here.values)
    assert here.status.tolist() == [RUN, REFUSED, RUN, REFUSED, REFUSED, REFUSED]
    assert here.reasons == away.reasons
    assert "must be 'clamped', 'supported', 'free'" in here.reasons[1]
    assert "'c.csv': holds no numbers" in here.reasons[4]


@pytest.mark.parametrize("error", [RuntimeError("Failed to allocate 9 bytes\non device 'cuda:0'"), MemoryError("9")])
def test_a_point_without_memory_is_given_up_and_others_run(swept_plate, error):
    def run(point):
        if point.values["drive.frequency"] == 250:
            raise error
        return run_point(point)

    class Full(InlinePool):
        def run(self, function, argument):
            return run_task(run, argument)

    start = start_sweep(SweepRequest(swept_plate, vary=["drive.frequency=200:300:3"], what="check"), "cpu")
    points = [0, 1, 2]
    for results, attempts in (
        (run_here(start, points, run), ""),
        (run_on_pool(start, points, Full()), " after 3 attempts"),
    ):
        reason = f"given up{attempts}: out of memory ({' '.join(str(error).split())})"
        assert {result.point: result.reason for result in results} == {0: "", 1: reason, 2: ""}
    error = RuntimeError("a fault of the program")
    with pytest.raises(RuntimeError, match="a fault of the program"):
        list(run_here(start, [1], run))


def test_numbers_beyond_the_memory_are_refused_before_any_point(swept_plate, monkeypatch):
    monkeypatch.setattr(memory, "machine_memory", lambda: 2.0**24)
    with pytest.raises(SceneError, match=r"^--vary: 300000 numbers at 100 points: takes about 0\.0156 GiB of memory"):
        sweep(swept_plate, ["plate.thickness=4e-4:5e-4:100"], "frf", frequencies="100:200:1000")


def test_points_that_no_file_holds_are_not_said_to_be_saved(swept_plate, tmp_path):
    start = start_sweep(SweepRequest(swept_plate, vary=plan_of(swept_plate, "drive.frequency=200:300:3"), what="check"))
    (tmp_path / "disk").mkdir()

    def on_progress(done, total, note):
        if done == 2:
            (tmp_path / "disk").rename(tmp_path / "gone")

    file = CheckpointFile(tmp_path / "disk" / "a.checkpoint.h5", every=0)
    assert run_sweep(start, on_progress, file).finished
    assert file.saved.progress == load_sweep(tmp_path / "gone" / "a.checkpoint.h5").progress == "1 of 3 points"


def test_a_result_that_cannot_be_written_leaves_all_points(swept_plate, tmp_path):
    found = sweep(swept_plate, ["drive.frequency=200,300"], "check", device="cpu")
    unfinished = CheckpointFile(tmp_path / "a.checkpoint.h5")
    (tmp_path / "a.h5").mkdir()
    with pytest.raises(SceneError, match=r"a\.h5"):
        save_finished(found, tmp_path / "a.h5", unfinished)
    assert load_sweep(unfinished.path).finished
    save_finished(found, tmp_path / "b.h5", unfinished)
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["b.h5"]
    # A file of others that appears during a sweep stays.
    (tmp_path / "c.h5").write_bytes(b"theirs")
    with pytest.raises(SceneError, match="or give --force"):
        save_finished(found, tmp_path / "c.h5", unfinished)
    assert (tmp_path / "c.h5").read_bytes() == b"theirs"
    assert load_sweep(unfinished.path).finished
    save_finished(found, tmp_path / "c.h5", unfinished, force=True)
    assert load_sweep(tmp_path / "c.h5").finished


def test_ctrl_c_returns_the_points_that_are_done(swept_plate):
    def interrupt(done, total, values):
        if done == 2:
            raise KeyboardInterrupt

    vary = ["drive.frequency=250,270,290"]
    result = sweep(swept_plate, vary, device="cpu", on_progress=interrupt)
    assert result.pending.tolist() == [2]
    assert result.warnings == ("interrupted: 2 of 3 points",)
    whole = sweep(swept_plate, vary, device="cpu")
    np.testing.assert_array_equal(result.values["best"], [*whole.values["best"][:2], math.nan])
