"""The explorer: its unit responses and live model show at once what plates do when they are run; its picture as data;
refusals."""

import asyncio
import copy
import math
import pickle
import threading
import time
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
import pytest

from support.commands import error_of, until
from warp_plate import PlateSolver, Scene, SceneError, localize, sound, specify
from warp_plate.analysis.motion import last_period, steady_motions
from warp_plate.explore.live_model import CHOICES, VISCOUS, LiveModel, changed_scene, slider_ranges
from warp_plate.explore.unit_responses import live_solver, unit_responses
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.result.motion import QUADRANTS, SwarmSnapshot, quadrants
from warp_plate.viz import explorer_page
from warp_plate.viz.explorer_view import LEAST_SHARE, PERIOD, ExplorerView
from warp_plate.viz.pictures import make_plotter

# Damped so strongly that the motion is steady when the run ends, and not so strongly that low modes creep.
DAMPING = 120.0
SEARCH = {"particles": 12, "iterations": 15}
SIDES = ("left", "right", "bottom", "top")
PATHS = {"auto": ["modal"], "resident": ["resident"]}


@pytest.fixture
def explored_panel(scene):
    """Three actuators, steady at the end."""
    return scene(damping=DAMPING, window=(0.08, 0.1), search=SEARCH)


@pytest.fixture
def live():
    """A factory of live models on the CPU, which are closed at the end."""
    with ExitStack() as models:
        yield lambda scene, path="auto", **how: models.enter_context(closing(LiveModel(scene, "cpu", path, **how)))


@pytest.fixture
def model(live, explored_panel):
    return live(explored_panel)


@pytest.fixture
def view(model, drawing):
    with closing(make_plotter((900, 800), off_screen=True, shape=(2, 1))) as plotter:
        made = ExplorerView(plotter, model, 16)
        made.plotter = plotter
        yield made


def test_models_are_neither_pickled_nor_copied(model):
    for duplicate in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="LiveModel: make it again from its scene"):
            duplicate(model)


def after(model, **changes):
    """The reading after changes, such as frequency=250.0, damping=50.0 or choice="equal"."""
    take = {"choice": model.choose, "frequency": model.set_frequency}
    take["damping"] = lambda value: model.set_number(VISCOUS, value)
    for name, value in changes.items():
        take[name](value)
    model.wait()
    return model.read()


def test_harmonic_motion_is_fitted_exactly(random, explored_panel, phasors):
    """A field A cos ωt − B sin ωt has the amplitude A + iB; a constant, as of a slow decay, is residual."""
    solver = PlateSolver(explored_panel, "cpu")
    run = solver.run(phasors(1, 3), last_period(explored_panel, solver.specialized.scheme.time_step))
    amplitude = random.normal(size=(4, 5)) + 1j * random.normal(size=(4, 5))
    angles = explored_panel.drive.angular_frequency * run.times
    fields = np.real(amplitude * np.exp(1j * angles)[:, None, None])
    for constant in (0.0, 0.5):
        (motion,) = steady_motions(replace(run, displacement=fields[None] + constant), explored_panel)
        np.testing.assert_allclose(motion.amplitude, amplitude, atol=1e-10)
        residual = constant * math.sqrt(fields.size / ((fields + constant) ** 2).sum())
        assert motion.residual == pytest.approx(residual, rel=1e-9, abs=1e-10)
        np.testing.assert_allclose(motion.at(angles[7]), fields[7], atol=1e-9)
    largest = max(np.abs(motion.at(angle)).max() for angle in np.linspace(0, 7, 2000))
    assert motion.peak() == pytest.approx(largest, rel=1e-4)


@pytest.mark.parametrize("path", ["auto", "modal"])
@pytest.mark.parametrize("steady", [True, False])
def test_any_drive_equals_its_run(steady, path, scene, phasors):
    """Energies agree to rounding with a run in float64, and amplitudes too, even if start-up motion persists."""
    tables = {"damping": DAMPING, "window": (0.08, 0.1)} if steady else {}
    made = scene(precision="float32", **tables)
    drive = phasors(1, 3)
    reading = unit_responses(made, "cpu", path).read(drive[0])
    assert (reading.sound_level is None) == (path == "auto")
    exact = made.model_copy(update={"grid": made.grid.model_copy(update={"precision": "float64"})})
    time_step = PlateSolver(exact, "cpu").specialized.scheme.time_step
    run = live_solver(exact, "cpu", path).run(drive, last_period(exact, time_step))
    assert run.regions == ("plate", "target", *QUADRANTS)
    np.testing.assert_allclose(list(reading.energy.values()), run.energy[0], rtol=1e-9)
    assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
    assert sum(reading.share(name) for name in QUADRANTS) == pytest.approx(1, rel=1e-12)
    assert reading.share("lower left") == pytest.approx(reading.localization_factor, rel=1e-9)
    (direct,) = steady_motions(run, made)
    largest = np.abs(run.displacement).max()
    np.testing.assert_allclose(reading.motion.amplitude, direct.amplitude, rtol=0, atol=1e-9 * largest)
    assert (reading.motion.residual < 0.01) == steady
    if steady:
        shown = [reading.motion.at(made.drive.angular_frequency * when) for when in run.times]
        np.testing.assert_allclose(shown, run.displacement[0], rtol=0, atol=1e-4 * largest)


def test_quadrants_are_summed_beside_any_target(scene):
    made = scene(damping=DAMPING, target={"area": (0.05, 0.15, 0.02, 0.2)}, size=(0.2, 0.24))
    alone = PlateSolver(made, "cpu").run(np.ones((1, 3)))
    run = PlateSolver(made, "cpu", areas=quadrants(made.plate.size)).run(np.ones((1, 3)))
    np.testing.assert_array_equal(run.energy[:, :2], alone.energy)
    assert run.energy[0, 2:].sum() == pytest.approx(run.energy[0, 0], rel=1e-12)
    upper = made.model_copy(update={"target": made.target.model_copy(update={"area": (0.0, 0.1, 0.12, 0.24)})})
    assert run.energy[0, 4] == pytest.approx(PlateSolver(upper, "cpu").run(np.ones((1, 3))).energy[0, 1], rel=1e-12)


@pytest.mark.parametrize("path", ["auto", "resident"])
def test_frequency_and_damping_are_simulated_again(explored_panel, live, path):
    """The model uses modes, or time steps if a path is requested."""
    model = live(explored_panel, path)
    assert model.by_modes == (path == "auto")
    for frequency, damping in ((240.0, DAMPING), (290.0, 500.0), (290.0, 0.0)):
        reading = after(model, frequency=frequency, damping=damping)
        run = live_solver(changed_scene(explored_panel, frequency, {VISCOUS: damping}), "cpu", *PATHS[path]).run(
            np.ones((1, 3))
        )
        assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
        assert (reading.scene.drive.frequency, reading.scene.effects.damping.viscous) == (frequency, damping)


def test_a_reading_does_not_wait_for_a_simulation(explored_panel, live):
    """While the worker simulates, the old responses stay and drives still move; then the latest frequency is shown."""
    go_on = threading.Event()
    go_on.set()

    def slow(*arguments):
        assert go_on.wait(60)
        return unit_responses(*arguments)

    model = live(explored_panel, respond=slow)
    go_on.clear()
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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_what_cannot_be_simulated_is_reported_and_the_rest_goes_on(scene, live):
    """A damping that makes the given step, taken backward, unstable; an error, as of a device out of memory."""

    def respond(changed, *arguments):
        if changed.drive.frequency == 200.0:
            raise RuntimeError("out of memory")
        return unit_responses(changed, *arguments)

    with pytest.raises(SceneError, match="above the stability limit"):
        live(scene(time_step=1e-3), "resident")
    with pytest.raises(SceneError, match=r"^effects.stretching: what is explored is linear in the drives"):
        live(scene(effects={"stretching": {}}))
    model = live(scene(damping=10.0, scheme="backward", time_step=1.2e-4), "resident", respond=respond)
    before = model.read()
    assert after(model, damping=1e5).scene is before.scene
    assert "above the stability limit" in model.status()
    assert after(model, damping=20.0).scene.effects.damping.viscous == 20.0
    assert "limit" not in model.status()
    assert after(model, frequency=200.0).scene.drive.frequency == 290.0
    assert model.status().startswith("the simulation has failed")


def test_slider_ranges_are_within_what_the_run_can_carry(explored_panel, scene):
    ranges = slider_ranges(explored_panel)
    assert (ranges.magnitude, ranges.numbers) == (2.0, {VISCOUS: (0.0, 5 * DAMPING)})
    assert ranges.frequency == pytest.approx((58, 580))
    short = scene(window=(0.0, 0.005), time_step=8e-4, nodes=(7, 7))
    assert slider_ranges(short).frequency == pytest.approx((200, 312.5))
    # A loss factor of 0.5 where the scene has no damping: 0.5 ωρH.
    assert slider_ranges(short).numbers[VISCOUS][1] == pytest.approx(0.5 * short.drive.angular_frequency * 0.5)


def test_levels_and_sliders_of_the_console_are_those_of_its_specification(live):
    """Its forces are newtons; its loss factor and its gasket, one number of four edges, have sliders."""
    made = Scene.load("console").replace("edges", {side: {"translation": 2e6} for side in SIDES})
    made = made.replace("specification.frequency", 250.0).replace("grid", {"nodes": (17, 9), "modal_density": 0.6})
    answer = specify(made, tolerances=False)
    model = live(answer.driven_scene())
    eta = "effects.loss_factor.eta"
    assert model.ranges.numbers == {eta: (0.0, pytest.approx(0.1)), "gasket": (4e5, 4e6)}
    assert [model.number_label(key) for key in model.ranges.numbers] == ["loss factor eta", "gasket [N/m²]"]
    levels = {row.name: (row.weakest, row.worst) for row in answer.levels}
    assert levels.keys() == {"target", "elsewhere"}
    heard = sound(answer.driven_scene())
    level = (heard.power_level + heard.weighting)[heard.at_drive]
    assert model.read().sound_level == pytest.approx(level, abs=0.01)
    for name, (weakest, worst) in model.read().levels.items():
        assert weakest == pytest.approx(levels[name][0], rel=0.01, abs=0.01)
        assert worst == pytest.approx(levels[name][1], rel=0.01)
    for key, value in ((eta, 0.05), ("gasket", 3e6)):
        model.set_number(key, value)
    model.wait()
    changed = model.read().scene
    assert (changed.effects.loss_factor.eta, changed.edges.left.translation, changed.edges.top.translation) == (
        0.05,
        3e6,
        3e6,
    )
    (target, _), tables = model.read().levels.values(), answer.driven_scene().replace("gasket", 3e6)
    expected = unit_responses(tables.replace(eta, 0.05), "cpu", "modal").read(scene_phasors(tables))
    assert target == pytest.approx(expected.levels["target"], rel=1e-9)
    assert target[0] != pytest.approx(levels["target"][0], rel=0.05)


def test_choices_are_what_localize_means_by_them(explored_panel, model):
    result = localize(explored_panel, device="cpu", evaluator="modal", estimate=False)
    for choice in ("equal", "single"):
        expected = result.cases[choice].localization_factor
        assert after(model, choice=choice).localization_factor == pytest.approx(expected, rel=1e-6)
    exact = after(model, choice="exact")
    assert exact.localization_factor == pytest.approx(exact.bound, rel=1e-9) == pytest.approx(result.bound, rel=1e-9)
    first, second = (after(model, choice="random").phasors for _ in range(2))
    assert np.abs(first - second).min() > 0
    np.testing.assert_allclose(after(model, choice="scene").phasors, [1, 1, 1])
    for choice in CHOICES:
        after(model, choice=choice)
        assert max(model.settings.magnitude) <= model.ranges.magnitude * (1 + 1e-12)
        assert all(0 <= phase < 2 * math.pi for phase in model.settings.phase)
    with pytest.raises(ValueError, match="'best': there are: scene, equal"):
        model.choose("best")


def test_one_actuator_and_damping_where_the_scene_has_none(scene, live):
    model = live(scene(actuators=[(0.03, 0.06, 0.04, 0.07)]))
    model.set_number(VISCOUS, DAMPING)
    assert all(after(model, choice=choice).localization_factor > 0 for choice in CHOICES)
    assert model.read().scene.effects.damping.viscous == DAMPING
    assert model.swarm() is None


def test_a_search_is_watched(explored_panel, model):
    """Particles and best at each iteration; the plate is that of the best, as localize finds it."""
    model.choose("found", seconds=0.02)
    seen = {}
    while (swarm := model.swarm()) is None or swarm.best.size < swarm.iterations:
        if swarm is not None:
            seen[swarm.best.size] = swarm
        time.sleep(0.002)
    model.wait()
    last, largest = model.swarm(), max(model.settings.magnitude)
    assert len(seen) > 5
    assert (last.best.size, last.iterations) == (15, 15)
    assert np.all(np.diff(last.best) >= 0)
    for swarm in seen.values():
        assert swarm.phasors.shape == (12, 3)
        np.testing.assert_array_equal(swarm.phasors[:, 0], 1)
    assert last.factors.max() <= last.best[-1] <= model.read().bound
    assert model.read().localization_factor == pytest.approx(last.best[-1], rel=1e-12)
    history = localize(explored_panel, device="cpu", evaluator="modal", estimate=False).history["best"]
    np.testing.assert_allclose(last.best, history, rtol=1e-6)
    model.choose("exact")
    model.wait()
    assert max(model.settings.magnitude) == pytest.approx(largest)
    # A search ends when a slider is moved: what it finds after that is not taken.
    model.choose("found", seconds=0.02)
    until(lambda: model.swarm() is not None)
    model.set_actuator(0, magnitude=0.25)
    assert model.swarm() is None
    time.sleep(0.05)
    assert model.read().phasors[0] == pytest.approx(0.25 * np.exp(-1j * model.settings.phase[0]))
    # Its drives are those of another frequency.
    for frequency in (200.0, 220.0):
        assert after(model, choice="found", frequency=frequency).scene.drive.frequency == frequency
        assert model.settings.frequency == frequency


def test_the_plate_follows_the_model(view, model):
    pictures = []
    for seconds in (0.0, 0.1, 0.4):
        assert view.advance(seconds)
        surface = view.plate.meshes.surface
        heights = view.plate.scale.height_factor * model.read().motion.at(view.angle).ravel()
        np.testing.assert_allclose(surface.points[:, 2], heights, rtol=1e-5, atol=1e-9)
        view.plotter.render_window.Render()
        pictures.append(np.asarray(view.plotter.screenshot(return_img=True)).astype(int))
    assert view.angle == pytest.approx(2 * math.pi * 0.5 / PERIOD)
    assert (pictures[0] != pictures[2]).any()
    assert (np.ptp(pictures[0], axis=2) > 60).mean() > 0.01
    # A paused plate changes only with the model.
    view.playing = False
    assert not view.advance(0.2)
    model.set_actuator(1, magnitude=0.5)
    for change in ({}, {"frequency": 250.0}, {"choice": "found"}):
        after(model, **change)
        assert view.advance(0.2)
        assert not view.advance(0.2)


def test_caption_and_scale_follow(view, model):
    """Half the drive is drawn half as high in the same scale; twice the drive needs another one."""
    view.angle = 0.7
    view.advance(0)
    first, height = view.plate.scale, np.abs(view.plate.meshes.surface.points[:, 2]).max()

    def drive(magnitude):
        for index in range(3):
            model.set_actuator(index, magnitude=magnitude)
        view.advance(0)
        return view.plate.scale.limit, model.read().motion.peak()

    drive(0.5)
    assert view.plate.scale == first
    assert np.abs(view.plate.meshes.surface.points[:, 2]).max() == pytest.approx(height / 2, rel=1e-4)
    limit, peak = drive(2.0)
    assert limit >= peak > first.limit
    limit, peak = drive(0.1 * LEAST_SHARE)
    assert LEAST_SHARE * limit <= peak <= limit
    after(model, frequency=250.0, choice="exact")
    view.advance(0)
    text, bound = view.plate.caption.GetInput(), f"{100 * model.read().bound:.2f} %"
    assert text.startswith("250 Hz")
    assert f"localization factor {bound}, bound {bound}" in text


def test_the_swarm_is_drawn(view, model):
    charts = view.search
    assert not charts.history.visible
    assert charts.hint.GetVisibility()
    after(model, choice="found")
    view.advance(0)
    swarm = model.swarm()
    assert charts.history.visible
    assert not charts.hint.GetVisibility()
    bound, best, factors, *rest = [
        np.column_stack([plot.x, plot.y])
        for plot in (*charts.history.plots("line"), *charts.history.plots("scatter"), *charts.plane.plots("scatter"))
    ]
    np.testing.assert_allclose(best, np.column_stack([np.arange(1, 16), swarm.best]))
    np.testing.assert_allclose(factors, np.column_stack([np.full(12, 15), swarm.factors]))
    np.testing.assert_allclose(bound[:, 1], model.read().bound)
    for index, (drawn, mark) in enumerate(zip(rest[::2], rest[1::2], strict=True), start=1):
        phasors, found = swarm.phasors[:, index], swarm.best_phasors[index]
        np.testing.assert_allclose(drawn, np.column_stack([phasors.real, phasors.imag]))
        np.testing.assert_allclose(mark, [[found.real, found.imag]])
    model.set_actuator(0, magnitude=0.5)
    view.advance(0)
    assert not charts.history.visible
    # Without a finite loss and without a bound.
    nothing = np.full(4, np.nan)
    charts.show(SwarmSnapshot(np.ones((4, 3), complex), nothing, nothing[:1], None, iterations=5), None)
    assert [plot.visible for plot in charts.plane.plots("scatter")] == [True, False, True, False]
    assert not next(iter(charts.history.plots("line"))).visible


def test_a_server_that_stops_is_an_error(model, drawing):
    if explorer_page.missing_page():
        pytest.skip("the page cannot be served here")
    from trame.app import get_server

    def stop(address):
        asyncio.get_running_loop().create_task(get_server(explorer_page.TITLE).stop())

    with pytest.raises(SceneError, match="the page's server has stopped"):
        explorer_page.serve_page(model, "127.0.0.1", 0, stop)


def test_refusals_name_the_library_the_port_or_the_device(write_scene, monkeypatch, command, drawing):
    write_scene(damping=120.0)
    if explorer_page.missing_page():
        pytest.skip("the page cannot be served here")
    for option, value in (("--device", "cuda:99"), ("--port", -1), ("--port", 70000)):
        assert str(value) in error_of(command("explore", "panel.toml", "--web", option, value))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "pip install 'warp-plate[web]'" in error_of(command("explore", "panel.toml"))
