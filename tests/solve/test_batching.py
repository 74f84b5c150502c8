"""Plates under way: steps taken by hand, parts of large batches, little memory, and interrupted runs."""

import itertools

import numpy as np
import pytest

from warp_plate import PlateSolver, SceneError
from warp_plate.solve.state import State

EFFECTS = {
    "damping": {"viscous": 30.0},
    "tension": {"x": 3.0, "y": 1.0},
    "oscillators": [{"area": (0.0, 0.1, 0.0, 0.08), "mass": 0.003, "stiffness": 300.0, "damping": 0.1}],
    "moving_load": {"force": 0.01, "start": (0.05, 0.1), "velocity": (5.0, 0.0), "size": 0.01},
}
SCENES = {
    "plain": {"nodes": (13, 11), "damping": 60.0, "precision": "float32"},
    "fourth order": {"nodes": (13, 11), "damping": 60.0, "order": 4, "load": "moments"},
    "moment form": {"nodes": (9, 9), "effects": EFFECTS, "edges": ("clamped", "free", "supported", "clamped")},
    "large": {"nodes": (97, 89), "size": (0.096, 0.088), "precision": "float32"},
}


@pytest.mark.parametrize("name", SCENES)
def test_single_steps_are_the_run(name, device, path, scene, phasors, fitting_solver):
    """Displacements, and on CPU energies, to the last bit, with another run in between; velocities by differences."""
    made = scene(**SCENES[name], **({"window": (0.0002, 0.0004)} if name == "large" else {"window": (0.001, 0.004)}))
    solver, drives = fitting_solver(made, device, path), phasors(3, 3)
    scheme = solver.discretization.scheme
    dt, stops = scheme.time_step, (1, 2, 7, scheme.steps // 2, scheme.steps)
    run = solver.run(drives, dt * np.array(stops))
    solver.setup(drives)
    assert not solver.displacement.any()
    steps, fields = 0, []
    for stop in stops:
        while steps < stop:
            before, steps = solver.displacement, steps + 1
            solver.step()
        if stop == 7:
            solver.run(phasors(5, 3))
        fields.append(solver.displacement)
        change = (fields[-1] - before) / dt
        np.testing.assert_allclose(solver.velocity, change, rtol=0, atol=2e-3 * np.abs(change).max())
        assert solver.time == pytest.approx(stop * dt)
    np.testing.assert_array_equal(np.stack(fields, axis=1), run.displacement)
    # A launch of CUDA adds its sum of squares in registers to the sum so far: steps by hand add in another order.
    rounding = 0.0 if device == "cpu" else 1e-6
    np.testing.assert_allclose(solver.energy, run.energy, rtol=rounding)
    solver.step(10)  # beyond the end
    np.testing.assert_allclose(solver.energy, run.energy, rtol=rounding)


def test_energy_of_a_run_under_way(scene):
    """Nothing before the window, then a growing share of the run's energy."""
    solver = PlateSolver(scene((9, 9), damping=60.0), "cpu")
    solver.setup(([[1.0, 1.0, 1.0]], 0.0))
    first, last = solver.discretization.scheme.window
    solver.step(first)
    assert not solver.energy.any()
    solver.step((last - first) // 2)
    half = solver.energy
    solver.step(last)
    assert (half > 0).all()
    assert (half < solver.energy).all()


def test_nothing_to_step(scene):
    solver = PlateSolver(scene((9, 9)), "cpu")
    with pytest.raises(SceneError, match="setup"):
        solver.step()
    with pytest.raises(SceneError, match="drives: shape"):
        solver.setup([[1.0]])
    with pytest.raises(SceneError, match="displacement"):
        PlateSolver(scene((9, 9)), "cpu", quantity="displacement").setup([[1.0, 0.0, 0.0]])


@pytest.mark.parametrize("name", ["plain", "moment form"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_parts_that_take_turns_change_no_bit(count, name, device, path, scene, phasors, monkeypatch):
    """Parts of five plates on ``count`` states, with bad plates; cut short, and then once more."""
    made, drives = scene(**SCENES[name], window=(0.002, 0.004)), phasors(37, 3)
    drives[[1, 6, 20, 36], 0] = np.nan
    whole = PlateSolver(made, device, path).run(drives, (0.003,))
    solver = PlateSolver(made, device, path)
    states = [State(solver.specialized, 5) for _ in range(count)]
    monkeypatch.setattr(solver, "_states_for", lambda plates, corners: (states, 5))
    calls = itertools.count()

    def interrupt(done, total):
        if next(calls) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solver.run(drives, (0.003,), progress=interrupt)
    reports = []
    run = solver.run(drives, (0.003,), progress=lambda *report: reports.append(report))
    np.testing.assert_array_equal(run.energy, whole.energy)
    np.testing.assert_array_equal(run.displacement, whole.displacement)
    assert run.faults.keys() == whole.faults.keys() == {1, 6, 20, 36}
    assert reports[-1] == (whole.node_steps, whole.node_steps)


def test_little_memory(device, path, scene, phasors):
    """One plate at a time."""
    made, drives = scene((9, 9), window=(0.002, 0.004)), phasors(5, 3)
    right = PlateSolver(made, device, path).run(drives).energy
    if device == "cpu":
        poor = PlateSolver(made, device, path, memory_share=1e-9)
        np.testing.assert_array_equal(poor.run(drives).energy, right)
        assert [state.capacity for state in poor.states] == [1]
    else:
        with pytest.raises(SceneError, match=r"grid\.nodes .* may be taken"):
            PlateSolver(made, device, path, memory_share=1e-9).run(drives)


def test_a_large_batch_takes_turns_on_a_gpu(device, path, scene, phasors, monkeypatch):
    if device == "cpu":
        pytest.skip("parts take turns on CUDA alone")
    made, drives = scene((9, 9), window=(0.002, 0.004)), phasors(60, 3)
    right = PlateSolver(made, device, path).run(drives).energy
    solver = PlateSolver(made, device, path)
    monkeypatch.setattr("warp_plate.solve.batching.PART_NODE_STEPS", 20 * solver.node_steps_per_plate)
    np.testing.assert_array_equal(solver.run(drives).energy, right)
    assert [state.capacity for state in solver.states] == [20, 20]
