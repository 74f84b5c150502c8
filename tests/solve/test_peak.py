"""The largest displacement of a whole run: of bursts, moving loads, and long and large runs."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.cli.main import main
from warp_plate.modal.motion import fields
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.signals import sample_times
from warp_plate.solve.run import run_with_peaks

BURST = {"frequency": 290.0, "burst": {"duration": 0.003, "ramp": 0.001}}
MOVING = {"stretching": {}, "moving_load": {"force": 1e-3, "start": (0.1, 0.1), "velocity": (1.0, 0.0)}}


@pytest.fixture
def struck(scene):
    """A damped plate whose burst is long over when it is recorded, at the middle of the run and its end."""
    return scene(damping=200.0, window=(0.04, 0.06), drive=BURST)


def traced_peak(made):
    """Return the largest displacement of all nodes and steps [m], by traces."""
    nx, ny = made.grid.nodes
    width, height = made.plate.size
    points = [(x, y) for y in np.linspace(0, height, ny) for x in np.linspace(0, width, nx)]
    return np.abs(PlateSolver(made, "cpu").run(scene_phasors(made)[None], points=points).trace).max()


@pytest.mark.parametrize("effects", [{}, MOVING])
def test_a_burst_between_the_recorded_times_is_seen(struck, effects):
    """And the run is the same to the last bit: a plate that is sampled is stopped, copied and continued."""
    made = struck.with_tables(effects=effects or struck.effects.model_dump(), grid={"nodes": (16, 13)})
    solver, drives = PlateSolver(made, "cpu"), np.stack([2j * scene_phasors(made), scene_phasors(made)])
    sampled, peaks = run_with_peaks(solver, drives)
    plain = solver.run(drives, sampled.times)
    np.testing.assert_array_equal(sampled.energy, plain.energy)
    np.testing.assert_array_equal(sampled.displacement, plain.displacement)
    np.testing.assert_array_equal(sampled.times, plain.times)
    peak = peaks[-1].max()
    assert peak == pytest.approx(traced_peak(made), rel=0.02)
    assert np.abs(sampled.displacement[1]).max() == pytest.approx(peak, rel=1e-9)  # the instant of it is recorded


def test_a_tone_is_recorded_a_quarter_period_apart(scene):
    """The later instant shows the largest displacement, and both the amplitude of every node."""
    made = scene(damping=2000.0, window=(0.02, 20 / 290))
    solver, drive = PlateSolver(made, "cpu"), scene_phasors(made)[None]
    run, _ = run_with_peaks(solver, drive)
    assert np.diff(run.times) == pytest.approx(0.25 / 290, abs=1.1 * solver.specialized.scheme.time_step)
    period = solver.run(drive, np.linspace(19 / 290, 20 / 290, 33)).displacement[0]
    assert np.abs(run.displacement[0, 1]).max() == pytest.approx(np.abs(period).max(), rel=0.02)
    both = np.hypot(*run.displacement[0][:, 6, 6])
    assert both == pytest.approx(np.abs(period[:, 6, 6]).max(), rel=0.05)
    written = PlateSolver(made.with_tables(record={"times": (0.01,)}), "cpu")
    assert run_with_peaks(written, drive)[0].times == pytest.approx([0.01], abs=written.specialized.scheme.time_step)


def test_few_samples_still_see_a_burst_and_a_passing_load(struck):
    late = struck.with_tables(
        window={"start": 1.0, "end": 30.0},
        drive={"frequency": 290.0, "burst": {"start": 0.011, "duration": 0.002}},
        effects={"moving_load": {"force": 1.0, "start": (0.1, 0.1), "from_time": 0.045, "to_time": 0.046}},
    )
    times = np.array(sample_times(late))
    assert times.size < 1000
    assert ((times >= 0.011) & (times <= 0.013)).sum() >= 90
    assert ((times >= 0.045) & (times <= 0.046)).sum() >= 90
    assert times.min() >= 0
    assert 29 < times.max() <= 30


def test_samples_never_keep_in_step_with_the_drive(scene):
    """Evenly spaced samples at whole periods would all fall on the same phase."""
    phase = 2 * math.pi * 1000.0 * np.array(sample_times(scene(frequency=1000.0, window=(0.0, 0.32))))
    assert np.cos(phase).max() > 0.99
    assert np.sin(phase).max() > 0.99
    assert abs(np.exp(1j * phase).mean()) < 0.1


def test_the_command_warns_of_a_burst_s_peak(struck, tmp_path, monkeypatch, capsys):
    """Driven to 0.3 thicknesses before the first recorded time, to less than half of that at it."""
    monkeypatch.chdir(tmp_path)
    loud = float(0.3 * struck.plate.thickness / traced_peak(struck))
    actuators = tuple(actuator.model_copy(update={"magnitude": loud}) for actuator in struck.actuators)
    Path("struck.toml").write_text(struck.model_copy(update={"actuators": actuators}).to_toml(), encoding="utf-8")
    main(["simulate", "struck.toml", "--device", "cpu", "--json", "--no-pictures", "--no-estimate"])
    answer = json.loads(capsys.readouterr().out)
    assert answer["peak_displacement"] == pytest.approx(0.3 * struck.plate.thickness, rel=0.02)
    assert any("0.3 of the thickness" in line for line in answer["warnings"])


@pytest.mark.parametrize(
    ("effects", "target"),
    [
        ({"loss_factor": {"eta": 0.02}}, {"area": (0.101, 0.149, 0.033, 0.083)}),
        ({"damping": {"viscous": 88.5}}, {"disc": (0.06, 0.11, 0.027)}),
    ],
)
def test_by_modes_the_largest_displacement_may_lie_on_the_outline_of_the_target(scene, target, effects):
    """Read at the nodes of the pictures alone it was 1.4 % off, beside an error bar of 0.08 %."""
    made = scene(effects=effects, target=target, nodes=(27, 27))
    solver = ModalSolver(made, "cpu")
    drives = scene_phasors(made)[None]
    peaks = run_with_peaks(solver, drives)[1][0]
    x, y = np.linspace(0, 0.2, 801), np.linspace(0, 0.2, 801)
    if "area" in target:
        x0, x1, y0, y1 = target["area"]
        within = ((x0 <= x) & (x <= x1)) & ((y0 <= y) & (y <= y1))[:, None]
    else:
        middle_x, middle_y, radius = target["disc"]
        within = (x - middle_x) ** 2 + (y - middle_y)[:, None] ** 2 <= radius**2
    if made.steady:
        amplitude = np.hypot(*fields(solver.plate, drives, np.array([0.0, 0.25 / made.drive.frequency]), x, y)[0])
    else:
        amplitude = np.zeros((801, 801))
        for time in np.array(sample_times(made)):
            np.maximum(amplitude, np.abs(fields(solver.plate, drives, np.array([time]), x, y)[0, 0]), out=amplitude)
    np.testing.assert_allclose(peaks, [amplitude[within].max(), amplitude[~within].max()], rtol=2e-3)
