"""Plates under way: steps taken by hand, parts of large batches, little memory, interrupted and recorded runs."""

import itertools

import numpy as np
import pytest

from support.oracle import LINEAR, check_same, with_all_effects
from support.scenes import scene_of
from warp_plate import PlateSolver, SceneError
from warp_plate.plate.designs import Designs, PerPlate
from warp_plate.solve.state import State

SCENES = {
    "plain": {"nodes": (16, 13), "damping": 60.0, "precision": "float32"},
    "fourth order": {"nodes": (16, 13), "damping": 60.0, "order": 4, "load": "moments"},
    "moment form": {"nodes": (16, 13)},
    "large": {"nodes": (97, 89), "size": (0.096, 0.088), "damping": 60.0, "precision": "float32"},
}


def make(name):
    """Return one of the SCENES."""
    made = scene_of(**SCENES[name], window=(0.0002, 0.0004) if name == "large" else (0.001, 0.003))
    return with_all_effects(made) if name == "moment form" else made


@pytest.mark.parametrize(
    "name", [name if name != "large" else pytest.param(name, marks=pytest.mark.slow) for name in SCENES]
)
def test_single_steps_are_the_run(name, device, path, phasors, fitting_solver):
    """Displacements and energies to the last bit, with another run in between; velocities by differences."""
    solver, drives = fitting_solver(make(name), device, path), phasors(3, 3)
    scheme = solver.discretization.scheme
    dt, stops = scheme.time_step, sorted({1, 2, 7, scheme.steps // 2, scheme.window[0] + 1, scheme.steps})
    run = solver.run(drives, dt * np.array(stops))
    with pytest.raises(SceneError, match="setup"):
        solver.step()
    solver.setup(drives)
    assert not solver.displacement.any()
    steps, fields, energies = 0, [], [np.zeros((3, 2))]
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
        # Nothing before the window, then a growing share of the run's energy.
        assert (solver.energy > energies[-1]).all() == (stop > scheme.window[0])
        energies.append(solver.energy)
    np.testing.assert_array_equal(np.stack(fields, axis=1), run.displacement)
    solver.step(10)  # beyond the end
    np.testing.assert_array_equal(solver.energy, run.energy)


def test_plates_that_cannot_be_set_up(scene):
    with pytest.raises(SceneError, match="drives: shape"):
        PlateSolver(scene(), "cpu").setup([[1.0]])
    with pytest.raises(SceneError, match="displacement"):
        PlateSolver(scene(), "cpu", quantity="displacement").setup([[1.0, 0.0, 0.0]])


@pytest.mark.parametrize(("name", "count"), [("plain", 1), ("moment form", 2), ("plain", 3)])
def test_parts_that_take_turns_change_no_bit(count, name, device, path, phasors):
    """Parts of five plates on ``count`` states, with bad plates; cut short, and then once more."""
    drives = phasors(37, 3)
    drives[[1, 6, 20, 36], 0] = np.nan
    whole = PlateSolver(make(name), device, path).run(drives, (0.003,))

    class InTurns(PlateSolver):
        def _states_for(self, plates, corners):
            return states

    solver = InTurns(make(name), device, path)
    states = [State(solver.specialized, 5) for _ in range(count)]
    calls = itertools.count()

    def interrupt(done, total):
        if next(calls) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solver.run(drives, (0.003,), progress=interrupt)
    reports = []
    run = solver.run(drives, (0.003,), progress=lambda *report: reports.append(report))
    check_same(run, whole)
    assert run.faults.keys() == whole.faults.keys() == {1, 6, 20, 36}
    assert reports[-1] == (whole.node_steps, whole.node_steps)


def test_little_memory(device, path, phasors):
    """A CPU takes one plate at a time; a GPU may have other users, and says what it lacks."""
    plain, drives = make("plain"), phasors(5, 3)
    poor = PlateSolver(plain, device, path, memory_share=1e-9)
    if device == "cpu":
        np.testing.assert_array_equal(poor.run(drives).energy, PlateSolver(plain, device, path).run(drives).energy)
        assert [state.capacity for state in poor.states] == [1]
    else:
        with pytest.raises(SceneError, match=r"grid\.nodes .* may be taken"):
            poor.run(drives)


@pytest.mark.parametrize("tables", [{"order": 4}, {"effects": {**LINEAR, "stretching": {}}}])
def test_a_run_does_not_depend_on_recorded_launches(tables, pairs, scene, random):
    """Shared waves and waves per plate, fewer plates and more, traced and not: on one solver, and each on a new one."""
    made = scene((9, 9), time_step=5e-5, window=(0.001, 0.0042), drive={"frequency": 290.0}, **tables)
    drives = random.uniform(-1, 1, (7, len(made.actuators), 2)) @ [1, 1j]
    frequency = np.tile(random.uniform(200, 400, (7, 1)), drives.shape[1])
    runs = [
        (drives, []),
        (drives, []),  # with CUDA's buffers in the other turn
        (Designs(drives[:3], frequency[:3]), []),
        (Designs(drives, frequency), []),
        (drives, [(0.05, 0.11)]),
        (Designs(drives[2:], frequency[2:]), [(0.05, 0.11)]),
        (drives, []),
    ]
    for device in {device for device, _ in pairs}:
        path = "resident" if made.effects.stretches else "streaming"
        solver = PlateSolver(made, device, path, per_plate=PerPlate(frequency=True))
        for plates, points in runs:
            run, new = solver.run(plates, points=points), PlateSolver(solver.discretization, device, path)
            assert (run.energy > 0).all()
            check_same(run, new.run(plates, points=points))
