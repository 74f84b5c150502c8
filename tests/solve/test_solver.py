"""PlateSolver's promises: the paper's figures, linearity, determinism, independent plates, records, plain errors."""

from dataclasses import replace

import numpy as np
import pytest

from support.oracle import FOUR_EDGES, LINEAR, check_same
from warp_plate import PlateSolver, SceneError
from warp_plate.plate.scheme import discretize, make_scheme


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-5), ("float64", 1e-12)])
def test_drives_of_any_size(device, path, precision, tolerance, scene, phasors):
    """Energies go with the square, from 1e-15 to 1e15 N/m²; displacements with the drive."""
    made = scene(damping=88.5, precision=precision)
    sizes, drive = np.array([1.0, 2.0, *10.0 ** np.arange(-15, 16, 5)]), phasors(1, len(made.actuators))
    run = PlateSolver(made, device, path).run(drive * sizes[:, None], times=(0.007, 0.012))
    np.testing.assert_allclose(run.energy, run.energy[0] * sizes[:, None] ** 2, rtol=tolerance)
    # Doubling is exact in binary numbers, and a plate is scaled by its own largest drive.
    np.testing.assert_allclose(run.energy[1], 4 * run.energy[0], rtol=1e-14)
    np.testing.assert_allclose(run.displacement[1], 2 * run.displacement[0], rtol=1e-14, atol=0)


@pytest.mark.parametrize(("precision", "order"), [("float32", 2), ("float32", 4), ("float64", 4)])
def test_a_plate_does_not_depend_on_its_batch(device, path, precision, order, scene, phasors):
    """Alone, at any place of a batch, in groups or chunks of any size, again: the same bits.

    A trace is asked for on CPU only: on CUDA it would turn the resident path into the streaming one.
    """
    made = scene((16, 13), damping=88.5, precision=precision, order=order)
    count, points = (71, ((0.05, 0.11),)) if device == "cpu" else (3571, ())
    drives = phasors(count, len(made.actuators))
    whole, alone = PlateSolver(made, device, path).run(drives, (0.009,), points), PlateSolver(made, device, path)
    for plate in (0, 16, count - 1, 0):
        check_same(alone.run(drives[[plate]], (0.009,), points), whole, [plate])
    np.testing.assert_array_equal(alone.run(drives).energy, whole.energy)
    for chunk in (1, 16, 33) if device == "cpu" else (100, 2999):
        rolled = np.roll(np.arange(count)[::-1], chunk)
        check_same(PlateSolver(made, device, path, chunk).run(drives[rolled], (0.009,), points), whole, rolled)


@pytest.mark.parametrize(
    ("nodes", "size", "plates", "tables"),
    [
        ((16, 13), (0.2, 0.2), 40, {"damping": 88.5}),
        ((97, 89), (0.096, 0.088), 1, {"damping": 88.5}),
        ((97, 89), (0.096, 0.088), 4, {"damping": 88.5}),
        ((13, 13), (0.2, 0.2), 4, {"effects": LINEAR, "edges": FOUR_EDGES}),
    ],
    ids=["small plates", "one large plate", "large plates", "with effects"],
)
def test_any_number_of_threads(nodes, size, plates, tables, scene, phasors):
    """Plates shared among threads, or threads sharing one plate, more of them than cores: the same bits."""
    made = scene(nodes, size, **tables, precision="float32")
    step = make_scheme(made).time_step
    made = scene(nodes, size, **tables, precision="float32", window=(10 * step, 60 * step), time_step=step)
    drives, points, discretization = phasors(plates, 3), [(0.3 * size[0], 0.4 * size[1])], discretize(made)
    alone = PlateSolver(discretization, "cpu", threads=1).run(drives, (30 * step,), points)
    assert alone.energy.min() > 0
    for threads in (2, 5):
        solver = PlateSolver(discretization, "cpu", threads=threads)
        check_same(solver.run(drives, (30 * step,), points), alone)


def test_records_and_progress_change_no_energy(device, path, scene, phasors):
    """Times are the nearest of the grid, in the order asked for, with t = 0 at rest; progress grows to the whole."""
    made = scene(precision="float32")
    scheme, drives, reports = make_scheme(made), phasors(5, 3), []
    step = scheme.time_step
    asked = (0.012, 0.0, 7.4 * step, 6.6 * step, 0.012)
    solver = PlateSolver(made, device, path, 2)
    run = solver.run(drives, asked, progress=lambda *report: reports.append(report))
    np.testing.assert_array_equal(run.energy, PlateSolver(made, device, path).run(drives).energy)
    np.testing.assert_allclose(run.times, [0.012, 0, 7 * step, 7 * step, 0.012], rtol=1e-12)
    assert not run.displacement[:, 1].any()
    np.testing.assert_array_equal(run.displacement[:, 2], run.displacement[:, 3])
    np.testing.assert_array_equal(run.displacement[:, 0], run.displacement[:, 4])
    assert np.abs(run.displacement[:, 0] - run.displacement[:, 2]).max() > 0
    done, totals = zip(*reports, strict=True)
    assert run.node_steps == solver.node_steps == done[-1] == 5 * 11 * 11 * scheme.steps
    assert set(totals) == {run.node_steps}
    assert list(done) == sorted(done)
    assert len(set(done)) >= 3


def test_no_drive_and_no_plates(device, path, scene):
    run = PlateSolver(scene(damping=88.5), device, path).run([[0, 0, 0], [1, 0, 0]], (0.012,), ((0.1, 0.1), (0.2, 0.2)))
    assert run.energy[0].tolist() == [0, 0]
    assert not run.displacement[0].any()
    assert not run.trace[0].any()
    assert run.trace[1].any(axis=1).tolist() == [True, False]  # edges are held
    assert run.energy[1].min() > 0
    run = PlateSolver(scene(), device, path, 4).run(np.empty((0, 3)), (0.012,))
    assert (run.energy.shape, run.displacement.shape, run.node_steps) == ((0, 2), (0, 1, 13, 13), 0)


def test_one_discretization_serves_many_solvers(device, path, scene, phasors):
    made, drives = scene(), phasors(2, 3)
    first = PlateSolver(made, device, path)
    second = PlateSolver(first.discretization, device, path, areas={"left": (0.0, 0.1, 0.0, 0.2)})
    np.testing.assert_array_equal(second.run(drives).energy[:, :2], first.run(drives).energy)
    coarse = scene(precision="float32")
    found = PlateSolver(replace(first.discretization, scene=coarse), device, path).run(drives)
    np.testing.assert_array_equal(found.energy, PlateSolver(coarse, device, path).run(drives).energy)


def test_refused_solvers(scene):
    for options, message in (
        ({"device": "gpu"}, r"device = 'gpu': .*cpu"),
        ({"device": "cuda:99"}, "device = 'cuda:99'"),
        ({"device": "cpu", "path": "fast"}, "path = 'fast': .*streaming"),
        ({"device": "cpu", "chunk": 0}, "chunk = 0"),
    ):
        with pytest.raises(SceneError, match=message):
            PlateSolver(scene(), **options)
