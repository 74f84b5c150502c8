"""Sweeps: figures as the commands give them, refused points, files, workers, and going on after a stop."""

import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from inline_pool import InlinePool

from warp_plate import SceneError, load_sweep, sweep
from warp_plate.cluster.pool import open_pool
from warp_plate.cluster.scheduler import ATTEMPTS
from warp_plate.plate.modes import natural_modes
from warp_plate.result.sweep import NOT_RUN, REFUSED, RUN, save_sweep
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.vary import make_plan, parse_vary
from warp_plate.studies import sweep as module
from warp_plate.studies.checkpointing import SweepFile
from warp_plate.studies.localize import localize
from warp_plate.studies.quantities_of_interest import QUANTITIES
from warp_plate.studies.simulate import simulate
from warp_plate.studies.sweep import run_sweep, start_sweep
from warp_plate.studies.sweep_file import check_replaceable, resume_sweep

ROOT = Path(__file__).parents[2]


@pytest.fixture
def plate(scene):
    """A small scene with one key that may be refused: thicker than the time step allows."""
    return scene(damping=88.5, time_step=2e-4, search={"particles": 8, "iterations": 10})


def test_figures_are_those_of_the_commands(plate):
    """Each point alone, by the command itself, gives the same."""
    plan = make_plan([parse_vary(plate, "drive.frequency=250,290"), parse_vary(plate, "actuators[1].phase=0,1.5")])
    found = {what: sweep(plate, plan, what, device="cpu", count=3) for what in QUANTITIES}
    for point in range(len(plan)):
        scene = plan.scene(plate, point)
        alone = simulate(scene, device="cpu", estimate=False)
        values = {name: one[point] for name, one in found["simulate"].values.items()}
        assert values["localization_factor"] == alone.cases["drive"].localization_factor
        assert values["energy_plate"] == alone.cases["drive"].energy["plate"]
        assert values["peak_displacement"] == alone.peak_displacement
        searched = localize(scene, device="cpu", evaluator="response", estimate=False)
        values = {name: one[point] for name, one in found["localize"].values.items()}
        assert values["bound"] == pytest.approx(searched.bound, rel=1e-9)
        for name in ("equal", "single"):
            assert values[name] == pytest.approx(searched.cases[name].localization_factor, rel=1e-9)
        assert searched.cases["best"].localization_factor <= values["best"] * (1 + 1e-9)
        assert values["best"] <= values["bound"] * (1 + 1e-9)
        np.testing.assert_array_equal(found["modes"].values["frequency"][point], natural_modes(scene, 3).frequencies)
        assert found["check"].values["time_step"][point] == 2e-4
        assert found["check"].values["steps_a_period"][point] == pytest.approx(1 / (scene.drive.frequency * 2e-4))


def test_where_no_eigenvector_is_the_answer_the_scene_is_searched(scene):
    """A limit on magnitudes, a plate that is not linear, one actuator, and one that is searched over panels: what
    ``localize`` finds."""
    search = {"particles": 6, "iterations": 8}
    limited = scene(damping=88.5, search={**search, "limits": {"equal_magnitudes": True}})
    stretched = scene((9, 9), effects={"stretching": {}}, search=search)
    alone = scene(damping=88.5, actuators=[(0.03, 0.06, 0.03, 0.06)])
    robust = scene((9, 9), damping=88.5, search={**search, "robust": {"thickness": 0.05, "scenarios": 2, "fresh": 1}})
    for one, evaluator in ((limited, "response"), (stretched, "direct"), (alone, "response"), (robust, "response")):
        found = sweep(one, ["drive.frequency=290"], device="cpu").values
        searched = localize(one, device="cpu", evaluator=evaluator, estimate=False)
        assert found["best"][0] == pytest.approx(searched.cases["best"].localization_factor, rel=1e-6)
        assert np.isnan(found["bound"][0]) == (searched.bound is None)
        if searched.bound is not None:
            assert found["bound"][0] == pytest.approx(searched.bound, rel=1e-9)


def test_refused_points_have_a_reason_and_others_run(plate):
    found = sweep(plate, ["plate.thickness=5e-4,2e-3,0.1", "drive.frequency=250,290"], "check", device="cpu")
    assert found.status.tolist() == [RUN, RUN, REFUSED, REFUSED, REFUSED, REFUSED]
    assert np.isfinite(found.shaped("limit")[0]).all()
    assert np.isnan(found.shaped("limit")[1:]).all()
    assert "grid.time_step = 0.0002: above the stability limit" in found.reasons[2]
    assert "not thin" in found.reasons[4]
    # The numbers are said once, and points are counted as people do.
    line = r"all points are refused; grid\.order = 3: must be 2 or 4 \(and 1 point more\)$"
    with pytest.raises(SceneError, match=line):
        sweep(plate, ["grid.order=3,5"], "check", device="cpu")
    assert found.refusal(2).startswith("at plate.thickness = 0.002, drive.frequency = 250: grid.time_step = 0.0002: ab")


def test_keys_that_change_nothing_are_known(plate):
    found = sweep(plate, ["drive.frequency=200,300", "search.seed=1,2", "plate.density=1000"], device="cpu")
    assert found.keys_without_effect == ("search.seed",)
    assert sweep(plate, ["search.seed=1:9"], samples=3, device="cpu").keys_without_effect == ("search.seed",)
    both = sweep(plate, ["search.seed=1:9", "drive.frequency=200:300"], samples=3, device="cpu")
    assert both.keys_without_effect == ()


def test_what_is_no_sweep(plate):
    with pytest.raises(SceneError, match="--what colours: must be one of localize"):
        sweep(plate, ["drive.frequency=1,2"], "colours")
    with pytest.raises(SceneError, match="--count 0"):
        sweep(plate, ["drive.frequency=1,2"], "modes", count=0)


@pytest.mark.parametrize("samples", [None, 7])
def test_a_file_gives_back_what_was_saved(plate, tmp_path, samples):
    vary = ["plate.thickness=4e-4,5e-4,2e-3", "drive.frequency=log:200:300:2"]
    found = sweep(plate, vary, "modes", samples=samples, device="cpu", count=2)
    read = load_sweep(save_sweep(found, tmp_path / "a.h5"))
    assert read.plan.same(found.plan)
    assert read.plan.logarithmic == (False, True)
    assert (read.scene, read.what, read.count, read.reasons) == (plate, "modes", 2, found.reasons)
    assert read.outputs == found.outputs
    np.testing.assert_array_equal(read.values["frequency"], found.values["frequency"])
    np.testing.assert_array_equal(read.status, found.status)


class Stop(KeyboardInterrupt):
    """Ctrl-C at a point of our choice."""


def test_a_sweep_that_is_stopped_anywhere_goes_on_to_the_same(plate, tmp_path, random):
    plan = make_plan([parse_vary(plate, "plate.thickness=4e-4:2e-3:5"), parse_vary(plate, "drive.frequency=200,300")])
    whole, file = sweep(plate, plan, "simulate", device="cpu"), tmp_path / "a.h5"
    ran = []

    def told(done, total, note):
        ran.append(note)
        if random.random() < 0.4:
            raise Stop

    begun = start_sweep(plate, plan, "simulate", "cpu")
    for _ in range(200):
        try:
            found = run_sweep(begun, told, SweepFile(file, math.inf, resumes=file.exists()))
            break
        except Stop:
            begun = resume_sweep(load_sweep(file))
    assert found.finished
    for name, values in whole.values.items():
        np.testing.assert_array_equal(found.values[name], values)
    np.testing.assert_array_equal(found.status, whole.status)
    assert found.reasons == whole.reasons
    assert len(ran) == len(set(ran)) == len(plan)  # none twice


def test_points_in_any_order_give_the_same(plate, random, monkeypatch):
    plan = make_plan([parse_vary(plate, "drive.frequency=200:300:6")])
    whole, real = sweep(plate, plan, "localize", device="cpu"), module.run_here
    monkeypatch.setattr(module, "run_here", lambda begun, left: real(begun, random.permutation(left).tolist()))
    shuffled = sweep(plate, plan, "localize", device="cpu")
    for name, values in whole.values.items():
        np.testing.assert_array_equal(shuffled.values[name], values)


class Killing(InlinePool):
    """A pool whose worker ends under some tasks, and under those of one point always."""

    def __init__(self, random, number):
        super().__init__()
        self.random, self.number, self.killed, self.met = random, number, 0, set()

    def run(self, function, argument):
        first = id(argument) not in self.met
        self.met.add(id(argument))
        if argument.numbers["drive.frequency"] == self.number or (first and self.random.random() < 0.5):
            self.killed += 1
            raise BrokenProcessPool
        return super().run(function, argument)


def test_a_pool_gives_the_same_and_names_what_it_lost(plate, random, tmp_path):
    (tmp_path / "thick.csv").write_text("1.0,1.1\n", encoding="utf-8")
    varied = plate.with_tables(effects={"variation": {"thickness": "thick.csv"}}).in_folder(tmp_path)
    plan = make_plan([parse_vary(varied, "drive.frequency=200:300:6"), parse_vary(varied, "plate.thickness=5e-4,0.1")])
    pool = Killing(random, 220.0)
    here, there = sweep(varied, plan, "modes", device="cpu"), sweep(varied, plan, "modes", device="cpu", pool=pool)
    lost = plan.points[:, 0] == 220.0
    assert lost.sum() == 2
    assert pool.killed >= 2 * ATTEMPTS
    np.testing.assert_array_equal(there.values["frequency"][~lost], here.values["frequency"][~lost])
    np.testing.assert_array_equal(there.status[~lost], here.status[~lost])
    for point, reason in there.reasons.items():
        given_up = f"given up after {ATTEMPTS} attempts: its worker ended"
        assert reason == (given_up if lost[point] else here.reasons[point])


class Away(InlinePool):
    """A worker on another kind of processor than this process has."""

    def __init__(self, processor="A GPU"):
        super().__init__()
        self.processor = processor

    def run(self, function, argument):
        result = super().run(function, argument)
        return result._replace(device="cuda:0", worker={**result.worker, "processor": self.processor})


def test_what_workers_ran_on_is_kept_and_another_kind_is_not_mixed_in(plate, tmp_path):
    plan, file, lines = make_plan([parse_vary(plate, "drive.frequency=200:300:4")]), tmp_path / "a.h5", []

    def stop_after(points):
        def told(done, total, note):
            if done == points:
                raise Stop

        return told

    begun = start_sweep(plate, plan, "check")
    here = f"{begun.device} ({begun.processor})"
    with pytest.raises(Stop):
        run_sweep(begun, stop_after(1), SweepFile(file, math.inf), Away())
    half = load_sweep(file)
    assert (half.device, half.processor, half.earlier_devices) == ("cuda:0", "A GPU", "")
    assert half.progress == "1 of 4 points"
    with pytest.raises(SceneError, match=r"the sweep began on cuda:0 \(A GPU\), which this machine does not have"):
        resume_sweep(half)
    with pytest.raises(SceneError, match=r"cuda:0 \(A GPU\) and continues on cuda:0 \(Another\).* --device cuda$"):
        run_sweep(resume_sweep(half, ""), pool=Away("Another"))
    without = InlinePool()
    without.device = "cuda:99"
    with pytest.raises(SceneError, match="a worker: device = 'cuda:99': not on this machine"):
        run_sweep(begun, pool=without)
    # Whoever asks for it has it, and the file says so.
    kept = SweepFile(file, math.inf, resumes=True)
    with pytest.raises(Stop):
        run_sweep(resume_sweep(half, ""), stop_after(3), kept, Away("Another"), lines.append)
    assert len(lines) == 1
    assert lines[0].endswith("continues on cuda:0 (Another), which rounds differently: the result may differ")
    whole = run_sweep(resume_sweep(load_sweep(file), begun.device))
    assert load_sweep(save_sweep(whole, file)).devices_used == f"cuda:0 (A GPU), then cuda:0 (Another), then {here}"
    assert resume_sweep(whole, "cuda:99") is whole  # nothing is left to run anywhere
    # The same kind goes on without a word, and where nobody has said his kind there is nothing to differ from.
    assert run_sweep(resume_sweep(half, ""), pool=Away()).devices_used == "cuda:0 (A GPU)"
    assert run_sweep(begun, pool=Killing(np.random.default_rng(0), 200.0)).devices_used == here


@pytest.mark.parametrize("error", [RuntimeError("Failed to allocate 9 bytes\non device 'cuda:0'"), MemoryError("9")])
def test_a_point_without_memory_is_given_up_and_others_run(plate, monkeypatch, error):
    real = QUANTITIES["check"]

    def figures(scene, options):
        if scene.drive.frequency == 250:
            raise error
        return real.compute(scene, options)

    monkeypatch.setitem(QUANTITIES, "check", replace(real, compute=figures))
    for pool, attempts in ((None, ""), (InlinePool(), f" after {ATTEMPTS} attempts")):
        found = sweep(plate, ["drive.frequency=200:300:3"], "check", device="cpu", pool=pool)
        assert found.status.tolist() == [RUN, REFUSED, RUN]
        assert found.reasons == {1: f"given up{attempts}: out of memory ({' '.join(str(error).split())})"}
    error = RuntimeError("a fault of the program")
    with pytest.raises(RuntimeError, match="a fault of the program"):
        sweep(plate, ["drive.frequency=200:300:3"], "check", device="cpu")


def test_processes_give_the_same(plate):
    """Real ones, and every output; a worker that is killed at work is replaced."""
    plan = make_plan([parse_vary(plate, "drive.frequency=200:300:4"), parse_vary(plate, "plate.thickness=5e-4,0.1")])
    told = []
    with open_pool("cpu,cpu", None) as pool:

        def kill_one(done, total, note):
            told.append((done, total))
            if done == 1:
                os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)

        there = sweep(plate, plan, "simulate", device="cpu", on_progress=kill_one, pool=pool)
    here = sweep(plate, plan, "simulate", device="cpu")
    for name, values in here.values.items():
        np.testing.assert_array_equal(there.values[name], values)
    assert there.reasons == here.reasons
    assert told == [(done, len(plan)) for done in range(1, len(plan) + 1)]


def test_a_process_that_is_killed_leaves_a_file_that_goes_on(plate, tmp_path, random):
    """By the system, without a word, at any moment of its work."""
    (tmp_path / "panel.toml").write_text(dump_scene(plate), encoding="utf-8")
    command = [sys.executable, "-m", "warp_plate", "sweep", "panel.toml", "--vary", "plate.thickness=4e-4:9e-4:40"]
    options = ["--what", "modes", "--checkpoint-every", "0", "--no-pictures", "--device", "cpu"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([*command, *options], cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    file = tmp_path / "panel-sweep.checkpoint.h5"
    while not file.exists() and process.poll() is None:
        time.sleep(0.005)
    time.sleep(0.2 * random.random())
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = load_sweep(file)
    found = run_sweep(resume_sweep(left))
    whole = sweep(plate, ["plate.thickness=4e-4:9e-4:40"], "modes", device="cpu")
    np.testing.assert_array_equal(found.values["frequency"], whole.values["frequency"])
    np.testing.assert_array_equal(
        left.values["frequency"][left.status == RUN], whole.values["frequency"][left.status == RUN]
    )
    assert np.isnan(left.values["frequency"][left.status == NOT_RUN]).all()


def test_a_file_that_the_scene_names_must_be_the_same(scene, tmp_path):
    (tmp_path / "thick.csv").write_text("1.0,1.1\n", encoding="utf-8")
    varied = scene(effects={"variation": {"thickness": "thick.csv"}}).in_folder(tmp_path)
    begun = start_sweep(varied, make_plan([parse_vary(varied, "drive.frequency=200,300")]), "check", "cpu")
    found = run_sweep(begun)
    assert (found.status == RUN).all()
    (tmp_path / "thick.csv").write_text("1.0,1.2\n", encoding="utf-8")
    with pytest.raises(SceneError, match="has changed since the sweep began"):
        resume_sweep(begun)


def test_no_file_of_another_question_is_replaced(plate, scene, tmp_path):
    """Two sweeps that begin at once with one name each keep a file; a result takes the place of its like alone."""
    plan = make_plan([parse_vary(plate, "drive.frequency=200,300")])
    found, file, lines = sweep(plate, plan, "check", device="cpu"), tmp_path / "a.checkpoint.h5", []
    first, second = SweepFile(file, warn=lines.append), SweepFile(file, warn=lines.append)
    first(found, True)
    second(replace(found, seconds=9.0), True)
    assert lines == [f"{file} is of another sweep by now; this one is kept in {second.path}"]
    assert second.path.name == "a-2.checkpoint.h5"
    assert (load_sweep(file).seconds, load_sweep(second.path).seconds) == (found.seconds, 9.0)
    second.remove()
    assert [path.name for path in tmp_path.iterdir()] == ["a.checkpoint.h5"]
    SweepFile(file).remove()  # which has written nothing
    assert file.exists()
    check_replaceable(file, replace(found, seconds=9.0, device="cuda:0"))
    check_replaceable(tmp_path / "none.h5", found)
    others = {
        "another scene": start_sweep(scene(damping=80.0), plan, "check"),
        "--what check": start_sweep(plate, plan, "simulate"),
        r"other points \(2 points, drive.frequency": start_sweep(
            plate, make_plan([parse_vary(plate, "drive.frequency=200,301")]), "check"
        ),
        "--count 6": start_sweep(plate, plan, "check", count=5),
    }
    for words, other in others.items():
        with pytest.raises(SceneError, match=rf"h5: holds a sweep of {words}.*; name another file by --out"):
            check_replaceable(file, other)
