"""The largest displacement of a whole run, which warnings go by: of bursts, loads that pass, long and large runs."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.analysis.influence import measure_influence
from warp_plate.cli.main import main
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.scene.dump import dump_scene
from warp_plate.solve import peak
from warp_plate.solve.peak import record_times, run_with_peak, sample_times
from warp_plate.studies.localize import localize
from warp_plate.studies.simulate import simulate

BURST = {"frequency": 290.0, "burst": {"duration": 0.003, "ramp": 0.001}}


@pytest.fixture
def struck(scene):
    """A damped plate whose burst is long over when it is recorded, at the middle of the run and its end."""
    return scene(damping=200.0, window=(0.04, 0.06), drive=BURST)


def traced_peak(made):
    """Of every node and step, by traces."""
    nx, ny = made.grid.nodes
    width, height = made.plate.size
    points = [(x, y) for y in np.linspace(0, height, ny) for x in np.linspace(0, width, nx)]
    return np.abs(PlateSolver(made, "cpu").run(scene_phasors(made)[None], points=points).trace).max()


def test_a_burst_between_the_recorded_times_is_seen(struck):
    found = simulate(struck, device="cpu", estimate=False)
    case = found.cases["drive"]
    assert found.peak == pytest.approx(traced_peak(struck), rel=0.02)
    assert np.abs(case.displacement).max() < 0.5 * found.peak
    assert case.displacement.shape[0] == found.times.size == len(record_times(struck))


@pytest.mark.parametrize("path", ["resident", "streaming"])
@pytest.mark.parametrize(
    "effects", [{}, {"stretching": {}, "moving_load": {"force": 1e-3, "start": (0.1, 0.1), "velocity": (1.0, 0.0)}}]
)
def test_looks_change_nothing_of_the_run(struck, path, effects):
    """To the last bit: a plate that is looked at is stopped, copied and gone on with."""
    made = struck.with_tables(effects=effects, grid={"nodes": (17, 15), "precision": "float32"})
    solver, drives = PlateSolver(made, "cpu", path), np.stack([scene_phasors(made), 2j * scene_phasors(made)])
    plain = solver.run(drives, record_times(made))
    looked, _ = run_with_peak(solver, drives)
    np.testing.assert_array_equal(looked.energy, plain.energy)
    np.testing.assert_array_equal(looked.displacement, plain.displacement)
    np.testing.assert_array_equal(looked.times, plain.times)


def test_localize_and_effects_look_over_the_whole_run(struck):
    made = struck.with_tables(search={"particles": 2, "iterations": 1})
    found = localize(made, device="cpu", estimate=False)
    best = found.cases["best"].phasors
    run = PlateSolver(made, "cpu").run(best[None], sample_times(made, 3))
    assert found.peak == pytest.approx(np.abs(run.displacement).max(), rel=1e-6)
    assert measure_influence(struck, "cpu").peak == pytest.approx(traced_peak(struck), rel=0.02)


def test_few_looks_still_see_a_burst_and_a_passing_load(struck, monkeypatch):
    monkeypatch.setattr(peak, "MOST_SAMPLES", 32)
    late = struck.with_tables(
        drive={"frequency": 290.0, "burst": {"start": 0.011, "duration": 0.002}},
        effects={"moving_load": {"force": 1.0, "start": (0.1, 0.1), "from_time": 0.045, "to_time": 0.046}},
    )
    times = np.array(sample_times(late))
    assert times.size <= 32
    assert ((times >= 0.011) & (times <= 0.013)).sum() >= 10
    assert ((times >= 0.045) & (times <= 0.046)).sum() >= 10
    assert times.min() >= 0
    assert times.max() <= late.window.end


def test_looks_never_keep_in_step_with_the_drive(scene, monkeypatch):
    """Evenly spaced, 320 looks at 320 periods would all fall on the same phase."""
    made = scene(frequency=1000.0, window=(0.0, 0.32))
    phase = 2 * math.pi * 1000.0 * np.array(sample_times(made))
    assert phase.size == peak.MOST_SAMPLES
    assert np.cos(phase).max() > 0.99
    assert np.sin(phase).max() > 0.99
    assert abs(np.exp(1j * phase).mean()) < 0.1


def test_looks_take_no_more_memory_than_said(scene):
    large = scene((1025, 1025))
    assert len(sample_times(large, 3)) * 3 * 8 * 1025**2 <= peak.SAMPLES_BYTES
    assert len(sample_times(scene((8193, 8193)))) == peak.FEWEST_SAMPLES


@pytest.mark.parametrize("name", ["simulate", "effects"])
def test_commands_warn_of_a_burst_s_peak(struck, name, tmp_path, monkeypatch, capsys):
    """Driven to 0.3 thicknesses before the first recorded time, to less than half of that at it."""
    monkeypatch.chdir(tmp_path)
    loud = float(0.3 * struck.plate.thickness / traced_peak(struck))
    actuators = tuple(one.model_copy(update={"magnitude": loud}) for one in struck.actuators)
    Path("struck.toml").write_text(dump_scene(struck.model_copy(update={"actuators": actuators})), encoding="utf-8")
    more = ("--no-pictures", "--no-estimate") if name == "simulate" else ()
    main([name, "struck.toml", "--device", "cpu", "--json", *more])
    answer = json.loads(capsys.readouterr().out)
    assert answer["peak_displacement"] == pytest.approx(0.3 * struck.plate.thickness, rel=0.02)
    assert any("over the run is 0.3 of the thickness" in line for line in answer["warnings"])
