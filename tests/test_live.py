"""The live model: what it shows at once is what plates do when they are run."""

import math
import time

import numpy as np
import pytest

from warp_plate import PlateSolver, SceneError, localize
from warp_plate.plate.weights import localization_factor
from warp_plate.result.live import QUADRANTS, SteadyMotion, quadrants
from warp_plate.search.live import CHOICES, LiveModel, changed_scene, ranges_of
from warp_plate.search.superposition import LINEAR_ORDERS, ORDERS, last_period, live_solver, motions_of, unit_responses

# Damped so strongly that the motion is steady when the run ends, and not so strongly that low modes creep.
DAMPING = 120.0
SEARCH = {"particles": 12, "iterations": 15}


@pytest.fixture
def panel(scene):
    """Three actuators, steady at the end."""
    return scene(damping=DAMPING, window=(0.08, 0.1), search=SEARCH)


@pytest.fixture
def film(scene):
    """Large displacements, which are not linear in the drives."""
    return scene(
        frequency=60.0, window=(0.08, 0.1), effects={"stretching": {}, "damping": {"viscous": DAMPING}}, search=SEARCH
    )


@pytest.fixture
def live():
    """Makes live models on the CPU and ends their threads."""
    made = []

    def make(scene):
        made.append(LiveModel(scene, "cpu"))
        return made[-1]

    yield make
    for model in made:
        model.close()


def times_of(scene, samples):
    """The times that the live model looks at."""
    return last_period(scene, PlateSolver(scene, "cpu").specialized.scheme.time_step, samples)


# Motion -----------------------------------------------------------------------------------------------------


def test_a_harmonic_motion_is_found_exactly(random, panel):
    """Of fields A cos ωt − B sin ωt, and of their multiples, the amplitudes A + iB come back."""
    orders = np.array([1, 3])
    amplitudes = random.normal(size=(2, 4, 5)) + 1j * random.normal(size=(2, 4, 5))
    times = np.array(times_of(panel, 32))
    turned = np.exp(1j * panel.drive_angular_frequency * np.outer(orders, times))
    fields = np.real(np.einsum("kji,kt->tji", amplitudes, turned))
    run = PlateSolver(panel, "cpu").run(np.ones((1, 3)), times.tolist())
    made = type(run)(**{**vars(run), "displacement": fields[None], "times": times})
    (motion,) = motions_of(made, panel, orders)
    np.testing.assert_allclose(motion.amplitudes, amplitudes, atol=1e-10)
    assert motion.left_over < 1e-10
    for index in (0, 7, 20):
        angle = panel.drive_angular_frequency * times[index]
        np.testing.assert_allclose(motion.at(angle), fields[index], atol=1e-9)
    largest = max(np.abs(motion.at(angle)).max() for angle in np.linspace(0, 7, 2000))
    assert motion.peak() == pytest.approx(largest, rel=0.02)


def test_a_drift_beside_the_motion_is_told_and_left_out(panel):
    """A low mode that dies out slowly is a straight line over one period."""
    times = np.array(times_of(panel, 12))
    wave = np.cos(panel.drive_angular_frequency * times)
    run = PlateSolver(panel, "cpu").run(np.ones((1, 3)), times.tolist())
    made = type(run)(**{**vars(run), "displacement": (wave + 0.5)[None, :, None, None], "times": times})
    (motion,) = motions_of(made, panel, LINEAR_ORDERS)
    np.testing.assert_allclose(motion.amplitudes.ravel(), [1], atol=1e-10)
    assert motion.left_over == pytest.approx(math.sqrt(12 * 0.25 / ((wave + 0.5) ** 2).sum()), rel=1e-9)


def test_peak_of_one_order_is_the_largest_amplitude():
    assert SteadyMotion(np.array([1]), np.array([[[3 + 4j, 1.0]]])).peak() == 5


# Superposition ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_any_drive_is_a_plate_that_was_run(precision, scene, phasors):
    """Motion, localization factor, quadrants: to rounding of a run in float64, whose motion is steady to 1e-4."""
    made = scene(damping=DAMPING, window=(0.08, 0.1), precision=precision)
    responses = unit_responses(made, "cpu")
    drive = phasors(1, 3)
    reading = responses.read(drive[0])
    exact = made.model_copy(update={"grid": made.grid.model_copy(update={"precision": "float64"})})
    run = live_solver(exact, "cpu", "auto").run(drive, times_of(exact, 7))
    assert run.regions == ("plate", "target", *QUADRANTS)
    np.testing.assert_allclose(list(reading.energy.values()), run.energy[0], rtol=1e-9)
    assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
    assert sum(reading.share(name) for name in QUADRANTS) == pytest.approx(1, rel=1e-12)
    assert reading.share("lower left") == pytest.approx(reading.localization_factor, rel=1e-9)
    for when, field in zip(run.times, run.displacement[0], strict=True):
        shown = reading.motion.at(made.drive_angular_frequency * when)
        np.testing.assert_allclose(shown, field, atol=1e-4 * np.abs(field).max())


def test_a_motion_that_is_not_steady_is_superposed_exactly(scene, phasors):
    """Undamped, start-up motion never ends; the part at the drive's frequency is linear in the drives all the same."""
    made = scene(window=(0.004, 0.012))
    responses = unit_responses(made, "cpu")
    drive = phasors(1, 3)
    run = PlateSolver(made, "cpu").run(drive, times_of(made, 12))
    (direct,) = motions_of(run, made, LINEAR_ORDERS)
    shown = responses.read(drive[0]).motion
    np.testing.assert_allclose(shown.amplitudes, direct.amplitudes, atol=1e-10 * np.abs(direct.amplitudes).max())
    assert shown.left_over > 0.01


def test_quadrants_of_another_target(scene):
    """The four quarters are summed beside the target, whatever it is, on any device path of the solver."""
    made = scene(damping=DAMPING, target={"area": (0.05, 0.15, 0.02, 0.2)}, size=(0.2, 0.24))
    alone = PlateSolver(made, "cpu").run(np.ones((1, 3)))
    run = PlateSolver(made, "cpu", areas=quadrants(made.plate.size)).run(np.ones((1, 3)))
    np.testing.assert_array_equal(run.energy[:, :2], alone.energy)
    assert run.energy[0, 2:].sum() == pytest.approx(run.energy[0, 0], rel=1e-12)
    upper = made.model_copy(update={"target": made.target.model_copy(update={"area": (0.0, 0.1, 0.12, 0.24)})})
    assert run.energy[0, 4] == pytest.approx(PlateSolver(upper, "cpu").run(np.ones((1, 3))).energy[0, 1], rel=1e-12)


def test_bound_and_exact_best_are_those_of_localize(panel, live):
    model = live(panel)
    model.choose("exact")
    model.wait()
    assert model.read().bound == pytest.approx(localize(panel, device="cpu", estimate=False).bound, rel=1e-9)
    assert model.read().localization_factor == pytest.approx(model.read().bound, rel=1e-9)


# Settings ---------------------------------------------------------------------------------------------------


def test_sliders_move_the_reading(panel, live):
    """Magnitude and phase at once, without a simulation; lag φ as in cos(ωt − φ)."""
    model = live(panel)
    model.set_actuator(1, magnitude=2.0)
    model.set_actuator(1, phase=math.pi / 2)
    assert not model.busy()
    np.testing.assert_allclose(model.read().drive, [1, -2j, 1], atol=1e-15)


@pytest.mark.parametrize(("frequency", "damping"), [(240.0, DAMPING), (290.0, 500.0), (290.0, 0.0)])
def test_frequency_and_damping_are_simulated_again(frequency, damping, panel, live):
    model = live(panel)
    model.set_frequency(frequency)
    model.set_damping(damping)
    model.wait()
    reading, other = model.read(), changed_scene(panel, frequency, damping)
    run = PlateSolver(other, "cpu").run(np.ones((1, 3)))
    assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
    assert (reading.scene.drive.frequency, reading.scene.effects.damping.viscous) == (frequency, damping)


def test_reading_does_not_wait_for_a_simulation(panel, live, monkeypatch):
    """While the worker is at it, the old reading stays, drives still move it, and the status says so."""
    import warp_plate.search.live as module

    model = live(panel)
    slow = module.unit_responses

    def slowed(*arguments):
        time.sleep(0.3)
        return slow(*arguments)

    monkeypatch.setattr(module, "unit_responses", slowed)
    model.set_frequency(200.0)
    assert model.busy()
    assert model.status() == "simulating ..."
    model.set_actuator(0, magnitude=0.5)
    assert model.read().scene.drive.frequency == 290.0
    assert model.read().drive[0] == 0.5
    model.wait()
    assert model.read().scene.drive.frequency == 200.0
    assert model.read().drive[0] == 0.5
    assert not model.busy()


def test_the_latest_of_many_frequencies_wins(panel, live):
    model = live(panel)
    for frequency in np.linspace(150, 320, 60):
        model.set_frequency(frequency)
    model.wait()
    assert model.read().scene.drive.frequency == 320.0


def test_damping_where_the_scene_names_none(scene, live):
    made = scene()
    model = live(made)
    assert ranges_of(made).damping == pytest.approx(0.5 * made.drive_angular_frequency * 0.5)
    model.set_damping(100.0)
    model.wait()
    assert model.read().scene.effects.damping.viscous == 100.0


def test_what_cannot_be_simulated_is_told_and_the_rest_goes_on(scene, live):
    """A step that a stronger damping, taken backward, makes unstable."""
    made = scene(damping=10.0, scheme="backward", time_step=1.2e-4)
    model = live(made)
    before = model.read()
    model.set_damping(1e5)
    model.wait()
    assert "above the stability limit" in model.status()
    assert model.read().scene is before.scene
    model.set_damping(20.0)
    model.wait()
    assert "limit" not in model.status()
    assert model.read().scene.effects.damping.viscous == 20.0


def test_ranges(panel, scene):
    """Within what the run can carry."""
    ranges = ranges_of(panel)
    assert ranges.magnitude == 2.0
    assert ranges.damping == 5 * DAMPING
    assert ranges.frequency == pytest.approx((58, 580))
    short = ranges_of(scene(window=(0.0, 0.005), time_step=8e-4, nodes=(7, 7)))
    assert short.frequency == pytest.approx((200, 312.5))


# Choices ----------------------------------------------------------------------------------------------------


def test_choices(panel, live):
    """Each is what localize means by the name."""
    model, found = live(panel), localize(panel, device="cpu", estimate=False)
    for choice, case in (("equal", "equal"), ("single", "single"), ("found", "best")):
        model.choose(choice)
        model.wait()
        # A run in float64 against one in the scene's precision.
        assert model.read().localization_factor == pytest.approx(found.cases[case].localization_factor, rel=1e-6)
    model.choose("random")
    model.wait()
    first = model.read().drive
    model.choose("random")
    model.wait()
    assert np.abs(first - model.read().drive).min() > 0
    model.choose("scene")
    model.wait()
    np.testing.assert_allclose(model.read().drive, [1, 1, 1])
    with pytest.raises(ValueError, match="'best': there are: scene, equal"):
        model.choose("best")


def test_drives_found_fit_the_sliders(panel, live):
    model = live(panel)
    for choice in CHOICES:
        model.choose(choice)
        model.wait()
        assert max(model.settings.magnitude) <= model.ranges.magnitude * (1 + 1e-12)
        assert all(0 <= phase < 2 * math.pi for phase in model.settings.phase)


def test_one_actuator(scene, live):
    model = live(scene(damping=DAMPING, actuators=[(0.03, 0.06, 0.04, 0.07)]))
    for choice in CHOICES:
        model.choose(choice)
        model.wait()
        assert model.read().localization_factor > 0
    assert model.swarm() is None


# The swarm, watched -----------------------------------------------------------------------------------------


def test_a_search_is_watched(panel, live):
    """Particles and best so far at each iteration; the plate is that of the best, as localize finds it."""
    model = live(panel)
    model.choose("found", seconds=0.02)
    seen = {}
    while model.busy():
        swarm = model.swarm()
        if swarm is not None:
            seen[swarm.best.size] = swarm
        time.sleep(0.002)
    model.wait()
    last = model.swarm()
    assert len(seen) > 5
    assert not last.running
    assert (last.best.size, last.iterations) == (15, 15)
    assert np.all(np.diff(last.best) >= 0)
    for swarm in seen.values():
        assert swarm.drives.shape == (12, 3)
        np.testing.assert_array_equal(swarm.drives[:, 0], 1)
    assert last.factors.max() <= last.best[-1] <= model.read().bound
    assert model.read().localization_factor == pytest.approx(last.best[-1], rel=1e-12)
    history = localize(panel, device="cpu", evaluator="response", estimate=False).history["best"]
    np.testing.assert_allclose(last.best, history, rtol=1e-9)


def test_a_search_ends_when_it_is_told_or_the_drive_is_moved(panel, live):
    model = live(panel)
    model.choose("found", seconds=0.02)
    while model.swarm() is None:
        time.sleep(0.002)
    model.end_search()
    model.wait()
    assert not model.swarm().running
    assert model.swarm().best.size < 15
    model.choose("found", seconds=0.02)
    while model.swarm() is None or not model.swarm().running:
        time.sleep(0.002)
    model.set_actuator(0, magnitude=0.25)
    assert model.swarm() is None
    time.sleep(0.1)
    assert model.settings.magnitude[0] == 0.25


# Not linear -------------------------------------------------------------------------------------------------


def test_stretching_is_simulated_for_each_drive(film, live):
    """Where the plate moves by its thickness and more, ten times the drive is not ten times the motion."""
    model = live(film)
    shown = []
    for magnitude in (10.0, 100.0):
        for index in range(3):
            model.set_actuator(index, magnitude=magnitude)
        model.wait()
        reading = model.read()
        run = PlateSolver(film, "cpu").run(np.full((1, 3), magnitude), times_of(film, 5))
        assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
        assert reading.bound is None
        shown.append(reading.motion)
        field = run.displacement[0, 2]
        at = reading.motion.at(film.drive_angular_frequency * run.times[2])
        np.testing.assert_allclose(at, field, atol=0.02 * np.abs(field).max())
    np.testing.assert_array_equal(shown[0].orders, ORDERS)
    assert shown[1].peak() < 9.8 * shown[0].peak()


def test_no_exact_best_where_nothing_is_linear(film, live):
    model = live(film)
    before = model.settings
    model.choose("exact")
    model.wait()
    assert model.status().startswith("exact best: effects.stretching is not linear")
    assert model.settings == before
    model.choose("equal")
    model.wait()
    assert "stretching" not in model.status()


def test_a_swarm_of_plates_that_stretch(film, live):
    """Simulated, beside the plate that is shown."""
    model = live(film)
    model.choose("found")
    model.wait()
    assert model.read().localization_factor == pytest.approx(model.swarm().best[-1], rel=1e-6)


def test_a_drive_that_no_run_survives_is_told(film, live):
    model = live(film)
    model.set_actuator(0, magnitude=1e12)
    model.wait()
    assert model.status()


def test_a_scene_that_cannot_run_is_refused_at_once(scene):
    with pytest.raises(SceneError, match="above the stability limit"):
        LiveModel(scene(time_step=1e-3), "cpu")
