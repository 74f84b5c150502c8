"""Motion and energies under any drive from unit responses equal those of a run of that drive."""

import math
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.analysis.superposition import (
    LINEAR_ORDERS,
    SimulatedResponses,
    last_period,
    live_solver,
    motions_of,
    unit_responses,
)
from warp_plate.plate.weights import localization_factor
from warp_plate.result.motion import QUADRANTS, SteadyMotion, quadrants

# The motion is steady at the end of the run, and low modes are underdamped.
DAMPING = 120.0


def times_of(scene, samples):
    """Return the times that the motion is fitted to."""
    return last_period(scene, PlateSolver(scene, "cpu").specialized.scheme.time_step, samples)


def fit(scene, fields, times, orders):
    """Return the motion that is fitted to the fields (times, ny, nx) of a run at these times [s]."""
    run = PlateSolver(scene, "cpu").run(np.ones((1, 3)), times.tolist())
    (motion,) = motions_of(replace(run, displacement=fields[None]), scene, orders)
    return motion


def test_harmonic_motion_is_fitted_exactly(random, scene):
    """Fields A cos kωt − B sin kωt have the amplitudes A + iB; a constant, as of a slow decay, is residual."""
    made, orders = scene(damping=DAMPING, window=(0.08, 0.1)), np.array([1, 3])
    amplitudes = random.normal(size=(2, 4, 5)) + 1j * random.normal(size=(2, 4, 5))
    times = np.array(times_of(made, 32))
    turned = np.exp(1j * made.drive_angular_frequency * np.outer(orders, times))
    fields = np.real(np.einsum("kji,kt->tji", amplitudes, turned))
    motion = fit(made, fields, times, orders)
    np.testing.assert_allclose(motion.amplitudes, amplitudes, atol=1e-10)
    assert motion.residual < 1e-10
    for index in (0, 7, 20):
        angle = made.drive_angular_frequency * times[index]
        np.testing.assert_allclose(motion.at(angle), fields[index], atol=1e-9)
    largest = max(np.abs(motion.at(angle)).max() for angle in np.linspace(0, 7, 2000))
    assert motion.peak() == pytest.approx(largest, rel=0.02)
    moved = fit(made, fields + 0.5, times, orders)
    np.testing.assert_allclose(moved.amplitudes, amplitudes, atol=1e-10)
    assert moved.residual == pytest.approx(math.sqrt(0.25 * fields.size / ((fields + 0.5) ** 2).sum()), rel=1e-9)
    assert SteadyMotion(np.array([1]), np.array([[[3 + 4j, 1.0]]])).peak() == 5


@pytest.mark.parametrize("path", ["auto", "modal"])
@pytest.mark.parametrize("steady", [True, False])
def test_any_drive_equals_its_run(steady, path, scene, phasors):
    """Energies agree to rounding with a run in float64, and amplitudes too, even if start-up motion persists."""
    tables = {"damping": DAMPING, "window": (0.08, 0.1)} if steady else {}
    made = scene(precision="float32", **tables)
    drive = phasors(1, 3)
    reading = unit_responses(made, "cpu", path).read(drive[0])
    exact = made.model_copy(update={"grid": made.grid.model_copy(update={"precision": "float64"})})
    run = live_solver(exact, "cpu", path).run(drive, times_of(exact, 12))
    assert run.regions == ("plate", "target", *QUADRANTS)
    np.testing.assert_allclose(list(reading.energy.values()), run.energy[0], rtol=1e-9)
    assert reading.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-9)
    assert sum(reading.share(name) for name in QUADRANTS) == pytest.approx(1, rel=1e-12)
    assert reading.share("lower left") == pytest.approx(reading.localization_factor, rel=1e-9)
    (direct,) = motions_of(run, made, LINEAR_ORDERS)
    largest = np.abs(run.displacement).max()
    np.testing.assert_allclose(reading.motion.amplitudes, direct.amplitudes, rtol=0, atol=1e-9 * largest)
    assert (reading.motion.residual < 0.01) == steady
    if steady:
        shown = [reading.motion.at(made.drive_angular_frequency * when) for when in run.times]
        np.testing.assert_allclose(shown, run.displacement[0], rtol=0, atol=1e-4 * largest)


class Busy:
    """A solver whose runs take a while, and that counts those at a time."""

    def __init__(self, solver, running, most):
        self.solver, self.running, self.most, self.discretization = solver, running, most, solver.discretization

    def run(self, *given):
        self.running.append(self)
        self.most.append(len(self.running))
        time.sleep(0.05)
        self.running.remove(self)
        return self.solver.run(*given)


def test_simulations_do_not_overlap(scene):
    """Two settings in several threads: the last swarm of an ended search, and the current picture."""
    made = scene(nodes=(9, 9), window=(0.002, 0.004), effects={"stretching": {}})
    running, most, both = [], [], [SimulatedResponses(made, "cpu", "resident") for _ in range(2)]
    for one in both:
        one.solver = Busy(one.solver, running, most)
    threads = [threading.Thread(target=one.energies, args=(np.ones((1, 3)),)) for one in both]
    for thread in threads:
        thread.start()
    both[0].read(np.ones(3))
    for thread in threads:
        thread.join()
    assert most == [1, 1, 1]


def test_quadrants_are_summed_beside_any_target(scene):
    made = scene(damping=DAMPING, target={"area": (0.05, 0.15, 0.02, 0.2)}, size=(0.2, 0.24))
    alone = PlateSolver(made, "cpu").run(np.ones((1, 3)))
    run = PlateSolver(made, "cpu", areas=quadrants(made.plate.size)).run(np.ones((1, 3)))
    np.testing.assert_array_equal(run.energy[:, :2], alone.energy)
    assert run.energy[0, 2:].sum() == pytest.approx(run.energy[0, 0], rel=1e-12)
    upper = made.model_copy(update={"target": made.target.model_copy(update={"area": (0.0, 0.1, 0.12, 0.24)})})
    assert run.energy[0, 4] == pytest.approx(PlateSolver(upper, "cpu").run(np.ones((1, 3))).energy[0, 1], rel=1e-12)
