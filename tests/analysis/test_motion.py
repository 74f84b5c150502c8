"""Frames of plates in motion: they are time steps of the result's run, with the energies of the result."""

import math

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate import Scene, SceneError
from warp_plate.analysis.motion import mode_motions, motions, usual_span
from warp_plate.modal.continuous_modes import continuous_modes
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import REGIONS, region_weights, weigh_region
from warp_plate.result.motion import Motion
from warp_plate.studies.simulate import simulate


@pytest.fixture(scope="module")
def settled_run():
    """A run whose start-up motion has decayed; a layer on a quarter of the plate makes the mass nonuniform."""
    layer = {"area": (0.1, 0.2, 0.0, 0.1), "thickness": 1e-4, "young_modulus": 1e9, "density": 3000.0}
    made = scene_of(window=(0.07, 0.07 + 10 / 290), effects={"damping": {"viscous": 400.0}, "layers": [layer]})
    return simulate(made, device="cpu", estimate=False)


def harmonic(size, lag, frequency=100.0, frames=24, jitter=0.0, offset=0.0):
    """Return the motion size·cos(ωt − lag) + offset over a period; fields (ny, nx)."""
    times = (np.arange(frames) + jitter) / frames / frequency
    angle = 2 * math.pi * frequency * times[:, None, None] - lag
    speed = -2 * math.pi * frequency * size * np.sin(angle)
    return Motion("drive", frequency, (0.0, 1 / frequency), times, size * np.cos(angle) + offset, speed, 0.5, 0.25)


def test_frames_are_steps_of_the_run(scene, pairs):
    """Frames are bit-identical to the displacement that the result recorded at that time, on every device."""
    made = scene(damping=400.0, window=(0.01, 0.02), precision="float32", record={"times": [0.0175]})
    step = make_scheme(made).time_step
    for device in sorted({device for device, _ in pairs}):
        result = simulate(made, device=device, estimate=False)
        case, moment = result.cases["drive"], float(result.times[0])
        (motion,) = motions(made, result.cases, span=(moment, made.window.end), device=device)
        assert motion.times[0] == pytest.approx(moment)
        np.testing.assert_array_equal(motion.displacement[0], case.displacement[0])
        np.testing.assert_allclose(motion.times / step, np.rint(motion.times / step), rtol=1e-12)
        assert motion.localization_factor == case.localization_factor


def test_a_plate_without_time_steps_moves_by_its_modes():
    """The frames repeat the displacement that the result recorded a whole number of periods before."""
    made = scene_of(window=(0.01, 0.05), effects={"loss_factor": {"eta": 0.05}}, record={"times": [0.04]})
    result = simulate(made, device="cpu", estimate=False)
    case, moment = result.cases["drive"], float(result.times[0])
    first = moment - 4 / 290
    (motion,) = motions(made, {"drive": case}, span=(first, first + 1 / 290), frames=30, device="cpu")
    lag = (motion.times[0] - first) * 2 * math.pi * 290
    assert abs(lag) < 0.3
    amplitude = np.abs(motion.displacement).max()
    assert amplitude > 0
    assert np.abs(motion.displacement[0] - case.displacement[0]).max() < 1.1 * abs(lag) * amplitude + 1e-5 * amplitude


def test_velocities_are_differences_of_displacements_and_have_the_results_energy(settled_run):
    (motion,) = motions(settled_run.scene, settled_run.cases, device="cpu")
    made, step = settled_run.scene, make_scheme(settled_run.scene).time_step
    np.testing.assert_allclose(np.diff(motion.times), step)  # all steps of a period are frames
    rate = np.diff(motion.displacement.astype(float), axis=0) / step
    np.testing.assert_allclose(rate, motion.velocity[:-1], atol=2e-6 * np.abs(motion.velocity).max())
    cell = math.prod(length / (count - 1) for length, count in zip(made.plate.size, made.grid.nodes, strict=True))
    average = 0.5 * motion.surface_density * motion.rms_velocity**2
    for region, weights in zip(REGIONS, region_weights(made), strict=True):
        assert (weights * average).sum() * cell == pytest.approx(settled_run.cases["drive"].energy[region], rel=1e-3)


def test_levels_are_relative_to_the_mean_of_the_drives_own_target(settled_run):
    """The second target's best drive is at 0 dB over the second target."""
    made, (first, second) = settled_run.scene.model_dump(), ((0.02, 0.08, 0.02, 0.08), (0.12, 0.18, 0.1, 0.18))
    targets = [{"name": "near", "area": first}, {"name": "far", "area": second}]
    scene = Scene.model_validate({key: made[key] for key in made if key != "target"} | {"targets": targets})
    drive = settled_run.cases["drive"]
    for motion, area in zip(
        motions(scene, {"best": drive, "best far": drive}, device="cpu"), (first, second), strict=True
    ):
        weights = weigh_region(scene, "target", area)
        assert (weights * 10 ** (motion.level / 10)).sum() / weights.sum() == pytest.approx(1)
        ratio = motion.rms_velocity[5, 6] / motion.rms_velocity[8, 9]
        assert motion.level[5, 6] - motion.level[8, 9] == pytest.approx(20 * math.log10(ratio), abs=1e-4)
        assert motion.level.min() == -200  # the clamped edges are at rest


def test_levels_need_a_target():
    with pytest.raises(SceneError, match="field = 'level': levels are relative to a target"):
        _ = harmonic(np.ones((4, 5)), 0.0).level


def test_root_mean_square_and_phase_of_a_harmonic_motion(random):
    size = random.uniform(1e-8, 1e-6, (4, 5))
    lag = random.uniform(-np.pi, np.pi, (4, 5))
    motion = harmonic(size, lag)
    np.testing.assert_allclose(motion.rms_velocity, 2 * np.pi * 100 * size / np.sqrt(2), rtol=1e-12)
    np.testing.assert_allclose(np.exp(1j * motion.phase), np.exp(1j * lag), atol=1e-9)
    np.testing.assert_allclose(motion.kinetic_energy, 0.25 * motion.velocity**2)
    # Frames at the nearest steps instead of even times, around a static deflection.
    uneven = harmonic(size, lag, jitter=random.uniform(-0.3, 0.3, 24), offset=3e-7)
    np.testing.assert_allclose(np.exp(1j * uneven.phase), np.exp(1j * lag), atol=1e-9)
    np.testing.assert_allclose(uneven.rms_velocity, motion.rms_velocity, rtol=0.02)


def test_nodes_at_rest_have_no_phase():
    size = np.array([[1e-7, 1e-12], [0.0, 1e-8]])
    assert np.isnan(harmonic(size, 0.3).phase).tolist() == [[False, True], [True, False]]
    assert np.isnan(harmonic(0 * size, 0.3).phase).all()
    burst = harmonic(np.full((2, 2), 1e-7), 0.3)
    burst.displacement[5, 0, 1] = np.inf
    assert np.isnan(burst.phase).tolist() == [[False, True], [False, False]]
    np.testing.assert_allclose(burst.phase[1], 0.3)


def test_modes_move_at_their_frequency(scene):
    made = scene()
    found = continuous_modes(made, 3, made.grid.nodes)
    for motion, index in zip(mode_motions(made, [1, 3]), (0, 2), strict=True):
        shape, frequency = found.shapes[index], found.frequencies[index]
        np.testing.assert_allclose(motion.displacement[0], shape, rtol=1e-6)
        half = len(motion.times) // 2
        np.testing.assert_allclose(motion.displacement[half], -shape, rtol=1e-6, atol=1e-7)
        assert motion.span[1] == pytest.approx(1 / frequency)
        assert f"{frequency:.4g} Hz" in motion.name
        np.testing.assert_allclose(
            motion.rms_velocity, 2 * np.pi * frequency * np.abs(shape) / np.sqrt(2), rtol=1e-5, atol=1e-3 * frequency
        )


def test_invalid_spans_frames_and_modes_are_refused(settled_run):
    scene, cases = settled_run.scene, settled_run.cases
    for options, message in (
        ({"span": (0.05, 0.2)}, "end = 0.2"),
        ({"span": (0.05, 0.04)}, "end = 0.04"),
        ({"frames": 1}, "frames = 1: must be from 2"),
        ({"span": (0.0501, 0.0501 + 1e-9)}, "two steps"),
        ({"frames": 10**9}, "frames = 1000000000: must be from 2"),
    ):
        with pytest.raises(SceneError, match=message):
            motions(scene, cases, device="cpu", **options)
    short = scene.model_copy(update={"drive": scene.drive.model_copy(update={"frequency": 1.0})})
    with pytest.raises(SceneError, match="shorter than a period"):
        motions(short, cases, device="cpu")
    for number, message in ((0, "mode 0"), (9999, "count = 9999")):
        with pytest.raises(SceneError, match=message):
            mode_motions(scene, [number])


@pytest.mark.parametrize(
    ("tables", "span"),
    [
        ({}, (0.1 - 1 / 290, 0.1)),
        ({"drive": {"frequency": 290.0, "burst": {"start": 0.01, "duration": 0.02, "period": 0.03}}}, (0.01, 0.03)),
        ({"drive": {"frequency": 290.0, "burst": {"start": 0.09, "duration": 0.02}}}, (0.09, 0.1)),
        ({"effects": {"moving_load": {"force": 1.0, "start": (0.1, 0.1)}}}, (0.06, 0.1)),
        # 600 frames show no more than 50 periods.
        ({"drive": {"frequency": 290.0, "chirp": {"end_frequency": 2900.0, "duration": 0.1}}}, (0.1 - 50 / 2900, 0.1)),
        ({"drive": {"frequency": 2900.0, "burst": {"start": 0.01, "duration": 0.08}}}, (0.01, 0.01 + 50 / 2900)),
    ],
)
def test_default_span_suits_the_drive(scene, tables, span):
    made = scene(window=(0.06, 0.1)).with_tables(**tables)
    assert usual_span(made, 0.1, 600) == pytest.approx(span)


def test_several_frequencies_show_the_window(scene):
    """Frames follow the highest frequency; if few are asked for, they show a shorter time."""
    made = scene(window=(0.06, 0.1))
    fast = made.actuators[0].model_copy(update={"frequency": 580.0})
    made = made.model_copy(update={"actuators": [fast, *made.actuators[1:]]})
    cases = simulate(made, device="cpu", estimate=False).cases
    (motion,) = motions(made, cases, device="cpu")
    step = make_scheme(made).time_step
    assert motion.times[[0, -1]] == pytest.approx([0.06, 0.1 - step], abs=step)
    np.testing.assert_allclose(np.diff(motion.times), step)  # fewer than 60 steps a period
    (few,) = motions(made, cases, frames=24, device="cpu")
    assert few.times[[0, -1]] == pytest.approx([0.1 - 2 / 580, 0.1 - step], abs=step)
    assert len(few.times) == 24
