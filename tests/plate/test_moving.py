"""A moving load: the force is conserved, its middle is where it should be, and its weights are an actuator's."""

import numpy as np
import pytest

from support.scenes import refused
from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.travelling import moving_weights
from warp_plate.plate.weights import moments, overlap

TIME_STEP, STEPS = 1e-3, 200
WIDTH, HEIGHT = 0.2, 0.1
TIMES = TIME_STEP * np.arange(STEPS)
SUPPORTED = ("supported",) * 4


@pytest.fixture
def loaded(scene):
    """A factory of scenes with a moving load on a plate of 13 × 9 nodes."""

    def make(load="overlap", **keys):
        table = {"force": 3.0, "start": (0.03, 0.04), **keys}
        return scene((13, 9), (WIDTH, HEIGHT), load=load, effects={"moving_load": table})

    return make


def forces(scene):
    """Return (steps,) total force [N], the first step made whole, and (steps, 2) the place where it acts [m]."""
    wave, along_x, along_y = moving_weights(scene, TIME_STEP, STEPS)
    assert (along_x.shape, along_y.shape) == ((STEPS, 13), (STEPS, 9))
    pressure = wave[:, None, None] * along_y[:, :, None] * along_x[:, None, :]
    force = pressure.sum(axis=(1, 2)) * WIDTH / 12 * HEIGHT / 8
    force[0] *= 2
    return force, np.stack([along_x @ np.linspace(0, WIDTH, 13), along_y @ np.linspace(0, HEIGHT, 9)], axis=1)


@pytest.mark.parametrize(
    ("load", "size"),
    [("overlap", 0.0), ("overlap", 0.004), ("overlap", 0.03), ("nodes", 0.03), ("moments", 1e-6), ("moments", 0.03)],
)
def test_force_and_place_are_kept(loaded, load, size):
    """The load moves from (0.03, 0.04) to (0.17, 0.06). Overlap of a patch of a cell or more may be off by that of a
    whole cell less that of a part, an eighth of a cell's square over the patch."""
    scene = loaded(load, size=size, velocity=(0.14 / TIMES[-1], 0.02 / TIMES[-1]))
    force, middle = forces(scene)
    np.testing.assert_allclose(force, 3.0, rtol=1e-9)
    path = np.linspace((0.03, 0.04), (0.17, 0.06), STEPS)
    spacing = np.array([WIDTH / 12, HEIGHT / 8])
    off = np.where(size >= spacing, spacing**2 / 8 / max(size, 1e-9), 0) if load != "moments" else 0
    assert (np.abs(middle - path) <= 1.0001 * off + 1e-9 * WIDTH).all()


@pytest.mark.parametrize(("load", "weigh"), [("overlap", overlap), ("moments", moments)])
def test_standing_load_is_an_actuator(loaded, load, weigh):
    """A load that does not move has the weights of the actuator on its square; one with a frequency is a cosine."""
    wave, along_x, along_y = moving_weights(loaded(load, size=0.03, frequency=40.0), TIME_STEP, STEPS)
    x = weigh(np.linspace(0, WIDTH, 13), 0.015, 0.045)
    y = weigh(np.linspace(0, HEIGHT, 9), 0.025, 0.055)
    cosine = np.cos(2 * np.pi * 40 * TIMES)
    cosine[0] /= 2
    wanted = 3.0 / 0.03**2 * cosine[:, None, None] * np.outer(y, x)
    np.testing.assert_allclose(wave[:, None, None] * along_y[:, :, None] * along_x[:, None, :], wanted, atol=1e-8)


@pytest.mark.parametrize(("load", "size"), [("overlap", 0.0), ("overlap", 0.03), ("moments", 0.004), ("moments", 0.03)])
def test_drives_on_and_off(loaded, load, size):
    """Over the left edge and out by the right one: the part of its force on the plate counts."""
    speed = 2.0
    force, _ = forces(loaded(load, size=size, start=(-0.05, 0.05), velocity=(speed, 0.0)))
    middle = -0.05 + speed * TIMES
    width = size or speed * TIME_STEP  # a point counts for the part of the step that it is there
    part = np.clip(np.minimum(middle + width / 2, WIDTH) - np.maximum(middle - width / 2, 0), 0, None) / width
    np.testing.assert_allclose(force, 3 * part, atol=1e-9)
    assert not force[middle > WIDTH + size].any()
    assert {0.0, 1.0} <= set(part)


@pytest.mark.parametrize("times", [(0.0, None), (0.0305, 0.0812), (0.0303, 0.0304)])
def test_impulse_and_place_go_by_its_time(loaded, times):
    """Σ force·Δt is force·(to − from), wherever between two steps it sets in and ends; the last step has its later half
    beyond the run, and the first only half. ``start`` is the place at ``from_time``."""
    scene = loaded(from_time=times[0], to_time=times[1], velocity=(0.5, 0.1))
    wave, _, _ = moving_weights(scene, TIME_STEP, STEPS)
    duration = (times[1] or (STEPS - 0.5) * TIME_STEP) - times[0]
    assert wave.sum() * TIME_STEP * WIDTH / 12 * HEIGHT / 8 == pytest.approx(3 * duration, rel=1e-9)
    assert not wave[(times[0] - 0.5001 * TIME_STEP) > TIMES].any()
    since = np.clip(TIMES, times[0], times[1]) - times[0]
    np.testing.assert_allclose(forces(scene)[1], np.array([0.03, 0.04]) + since[:, None] * [0.5, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"start": (-0.05, 0.05), "velocity": (-1.0, 0.0)}, "effects.moving_load.start = [-0.05, 0.05]: "),
        ({"from_time": 0.3}, "effects.moving_load.start = "),
        ({"force": 0.0}, "effects.moving_load.start = "),
    ],
)
def test_loads_without_effect_are_refused(loaded, keys, named):
    assert refused(moving_weights, loaded(**keys), TIME_STEP, STEPS).startswith(named)


def exact_middle(side, scheme, force, crossing, times):
    """Return (times,) displacement [m] in the middle of a supported square, over which a force [N] on a point goes
    along the mid-line within ``crossing`` [s]: L. Frýba, Vibration of Solids and Structures under Moving Loads."""
    orders = np.arange(1, 61, 2)  # the even ones are still in the middle
    m, n = orders[:, None, None], orders[None, :, None]
    natural = scheme.kappa * (m**2 + n**2) * (np.pi / side) ** 2
    passing = m * np.pi / crossing
    motion = (np.sin(passing * times) - passing / natural * np.sin(natural * times)) / (natural**2 - passing**2)
    shape = np.sin(m * np.pi / 2) * np.sin(n * np.pi / 2) ** 2
    return (4 * force / (scheme.surface_density * side**2) * shape * motion).sum(axis=(0, 1))


def test_crossing_of_a_supported_plate(device, path, scene):
    """Against the exact series; the error falls with the square of the spacing."""
    crossing, errors = 0.05, []
    for nodes in (17, 33):
        table = {"force": 0.4, "start": (0.0, 0.1), "velocity": (0.2 / crossing, 0.0)}
        made = scene((nodes, nodes), (0.2, 0.2), SUPPORTED, window=(0.0, crossing), effects={"moving_load": table})
        run = PlateSolver(made, device, path).run(np.zeros((1, 3)), points=[(0.1, 0.1)])
        exact = exact_middle(0.2, make_scheme(made), 0.4, crossing, run.trace_times)
        errors.append(np.linalg.norm(run.trace[0, 0] - exact) / np.linalg.norm(exact))
    assert errors[1] < 0.003
    assert errors[1] < 0.3 * errors[0]
