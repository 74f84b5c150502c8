"""The live model: what it shows at once is what plates do when they are run."""

import math
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest

from warp_plate import PlateSolver, SceneError, localize
from warp_plate.analysis.superposition import ORDERS, last_period
from warp_plate.explore import live_model
from warp_plate.explore.live_model import CHOICES, LiveModel
from warp_plate.explore.settings import changed_scene, slider_ranges
from warp_plate.plate.weights import localization_factor

# Damped so strongly that the motion is steady when the run ends, and not so strongly that low modes creep.
DAMPING = 120.0
SEARCH = {"particles": 12, "iterations": 15}


@pytest.fixture
def panel(scene):
    """Three actuators, steady at the end."""
    return scene(damping=DAMPING, window=(0.08, 0.1), search=SEARCH)


@pytest.fixture
def live():
    """A factory of live models on the CPU, which are closed at the end."""
    with ExitStack() as closing:

        def make(scene):
            model = LiveModel(scene, "cpu")
            closing.callback(model.close)
            return model

        yield make


def until(condition):
    """Wait for something that a thread does."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def chosen(model, choice):
    """The reading under one of the choices."""
    model.choose(choice)
    model.wait()
    return model.read()


def test_frequency_and_damping_are_simulated_again(panel, live):
    model = live(panel)
    for frequency, damping in ((240.0, DAMPING), (290.0, 500.0), (290.0, 0.0)):
        model.set_frequency(frequency)
        model.set_damping(damping)
        model.wait()
        reading = model.read()
        run = PlateSolver(changed_scene(panel, frequency, damping), "cpu").run(np.ones((1, 3)))
        assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
        assert (reading.scene.drive.frequency, reading.scene.effects.damping.viscous) == (frequency, damping)


def test_a_reading_does_not_wait_for_a_simulation(panel, live, monkeypatch):
    """While the worker simulates, the old responses stay and drives still move; then the latest frequency is shown."""
    model = live(panel)
    real, go_on = live_model.unit_responses, threading.Event()

    def slow(*arguments):
        assert go_on.wait(60)
        return real(*arguments)

    monkeypatch.setattr(live_model, "unit_responses", slow)
    for frequency in np.linspace(150, 200, 20):
        model.set_frequency(frequency)
    assert model.status() == "simulating ..."
    model.set_actuator(0, magnitude=0.5)
    model.set_actuator(1, phase=math.pi / 2)
    for frequency in (290.0, 200.0):
        assert model.read().scene.drive.frequency == frequency
        # The lag is φ as in cos(ωt − φ).
        np.testing.assert_allclose(model.read().phasors, [0.5, -1j, 1], atol=1e-15)
        go_on.set()
        model.wait()
    assert model.status() == ""


def test_what_cannot_be_simulated_is_reported_and_the_rest_goes_on(scene, live):
    """A damping that makes the given step, taken backward, unstable."""
    with pytest.raises(SceneError, match="above the stability limit"):
        live(scene(time_step=1e-3))
    model = live(scene(damping=10.0, scheme="backward", time_step=1.2e-4))
    before = model.read()
    model.set_damping(1e5)
    model.wait()
    assert "above the stability limit" in model.status()
    assert model.read().scene is before.scene
    model.set_damping(20.0)
    model.wait()
    assert "limit" not in model.status()
    assert model.read().scene.effects.damping.viscous == 20.0


def test_slider_ranges_are_within_what_the_run_can_carry(panel, scene):
    ranges = slider_ranges(panel)
    assert (ranges.magnitude, ranges.damping) == (2.0, 5 * DAMPING)
    assert ranges.frequency == pytest.approx((58, 580))
    short = scene(window=(0.0, 0.005), time_step=8e-4, nodes=(7, 7))
    assert slider_ranges(short).frequency == pytest.approx((200, 312.5))
    # A loss factor of 0.5 where the scene has no damping: 0.5 ωρH.
    assert slider_ranges(short).damping == pytest.approx(0.5 * short.drive_angular_frequency * 0.5)


def test_choices_are_what_localize_means_by_them(panel, live):
    model, result = live(panel), localize(panel, device="cpu", estimate=False)
    for choice, case in (("equal", "equal"), ("single", "single"), ("found", "best")):
        # A run in float64 against one in the scene's precision.
        expected = result.cases[case].localization_factor
        assert chosen(model, choice).localization_factor == pytest.approx(expected, rel=1e-6)
    exact = chosen(model, "exact")
    assert exact.localization_factor == pytest.approx(exact.bound, rel=1e-9) == pytest.approx(result.bound, rel=1e-9)
    first, second = chosen(model, "random").phasors, chosen(model, "random").phasors
    assert np.abs(first - second).min() > 0
    np.testing.assert_allclose(chosen(model, "scene").phasors, [1, 1, 1])
    for choice in CHOICES:
        chosen(model, choice)
        assert max(model.settings.magnitude) <= model.ranges.magnitude * (1 + 1e-12)
        assert all(0 <= phase < 2 * math.pi for phase in model.settings.phase)
    with pytest.raises(ValueError, match="'best': there are: scene, equal"):
        model.choose("best")


def test_one_actuator_and_damping_where_the_scene_has_none(scene, live):
    model = live(scene(actuators=[(0.03, 0.06, 0.04, 0.07)]))
    model.set_damping(DAMPING)
    assert all(chosen(model, choice).localization_factor > 0 for choice in CHOICES)
    assert model.read().scene.effects.damping.viscous == DAMPING
    assert model.swarm() is None


def test_a_search_is_watched(panel, live):
    """Particles and best so far at each iteration; the plate is that of the best, as localize finds it."""
    model = live(panel)
    model.choose("found", seconds=0.02)
    seen = {}
    while (swarm := model.swarm()) is None or swarm.running:
        if swarm is not None:
            seen[swarm.best.size] = swarm
        time.sleep(0.002)
    model.wait()
    last = model.swarm()
    assert len(seen) > 5
    assert (last.running, last.best.size, last.iterations) == (False, 15, 15)
    assert np.all(np.diff(last.best) >= 0)
    for swarm in seen.values():
        assert swarm.phasors.shape == (12, 3)
        np.testing.assert_array_equal(swarm.phasors[:, 0], 1)
    assert last.factors.max() <= last.best[-1] <= model.read().bound
    assert model.read().localization_factor == pytest.approx(last.best[-1], rel=1e-12)
    history = localize(panel, device="cpu", evaluator="response", estimate=False).history["best"]
    np.testing.assert_allclose(last.best, history, rtol=1e-9)


def test_a_search_ends_when_a_slider_is_moved(panel, live):
    """What it finds after that is not taken."""
    model = live(panel)
    model.choose("found", seconds=0.02)
    until(lambda: model.swarm() is not None and model.swarm().running)
    model.set_actuator(0, magnitude=0.25)
    assert model.swarm() is None
    time.sleep(0.1)
    assert model.read().phasors[0] == pytest.approx(0.25 * np.exp(-1j * model.settings.phase[0]))
    # Its drives are those of another frequency.
    for frequency in (200.0, 220.0):
        model.choose("found")
        model.set_frequency(frequency)
        model.wait()
        assert model.settings.frequency == model.read().scene.drive.frequency == frequency


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_of_the_program_is_reported(panel, live, monkeypatch):
    """Such as a device that runs out of memory; what is shown stays."""
    model = live(panel)

    def fail(*_):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(live_model, "unit_responses", fail)
    model.set_frequency(200.0)
    model.wait()
    assert model.status().startswith("the simulation has failed")
    assert model.read().scene.drive.frequency == 290.0


def test_stretching_is_simulated_for_each_drive(scene, live):
    """Where the plate moves by its thickness and more, ten times the drive is not ten times the motion."""
    effects = {"stretching": {}, "damping": {"viscous": DAMPING}}
    film = scene(frequency=60.0, window=(0.08, 0.1), effects=effects, search=SEARCH)
    model, shown, solver = live(film), [], PlateSolver(film, "cpu")
    times = last_period(film, solver.specialized.scheme.time_step, 5)
    for magnitude in (10.0, 100.0):
        for index in range(3):
            model.set_actuator(index, magnitude=magnitude)
        model.wait()
        reading, run = model.read(), solver.run(np.full((1, 3), magnitude), times)
        assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
        assert reading.bound is None
        shown.append(reading.motion)
        field = run.displacement[0, 2]
        at = reading.motion.at(film.drive_angular_frequency * run.times[2])
        np.testing.assert_allclose(at, field, atol=0.02 * np.abs(field).max())
    np.testing.assert_array_equal(shown[0].orders, ORDERS)
    assert shown[1].peak() < 9.8 * shown[0].peak()
    # A swarm of simulated plates, no exact best, and a drive that no run survives.
    chosen(model, "found")
    assert model.read().localization_factor == pytest.approx(model.swarm().best[-1], rel=1e-6)
    before = model.settings
    chosen(model, "exact")
    assert model.status().startswith("exact best: effects.stretching is not linear")
    assert model.settings == before
    chosen(model, "equal")
    assert "stretching" not in model.status()
    model.set_actuator(0, magnitude=1e12)
    model.wait()
    assert "grew without bound" in model.status()
