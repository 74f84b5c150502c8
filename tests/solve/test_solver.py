"""PlateSolver's promises: the paper's figures, linearity, determinism, no plate touching another, plain
errors."""

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import REGIONS

PLATE, TARGET = REGIONS.index("plate"), REGIONS.index("target")


def factors(run):
    return run.energy[:, TARGET] / run.energy[:, PLATE]


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-5), ("float64", 1e-12)])
@pytest.mark.parametrize("preset", ["paper", "paper-supported"])
def test_figures_of_the_paper(device, path, preset, precision, tolerance):
    """Equal drives give a quarter, for the scene is symmetric; one actuator the published 63.67 %."""
    scene = Scene.load(preset)
    scene = scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": precision})})
    shares = factors(PlateSolver(scene, device, path).run([[1, 1, 1, 1], [1, 0, 0, 0]]))
    assert shares[0] == pytest.approx(0.25, abs=tolerance)
    assert shares[1] == pytest.approx(0.6367, abs=0.0005)


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-5), ("float64", 1e-12)])
def test_linear_in_the_drives(device, path, precision, tolerance, scene, phasors):
    """u(a + 2b) = u(a) + 2u(b), and energy grows with the square; to rounding, some ε a step in the fast
    modes."""
    made = scene(damping=88.5, precision=precision)
    a, b = phasors(2, len(made.actuators))
    run = PlateSolver(made, device, path).run([a, b, a + 2 * b, 2 * a, -1j * b], times=(0.007, 0.012))
    u = run.displacement
    largest = np.abs(u).max()
    np.testing.assert_allclose(u[2], u[0] + 2 * u[1], rtol=0, atol=tolerance * largest)
    # Doubling is exact in binary numbers, and a plate is scaled by its own largest drive.
    np.testing.assert_allclose(run.energy[3], 4 * run.energy[0], rtol=1e-14)
    np.testing.assert_allclose(u[3], 2 * u[0], rtol=1e-14, atol=0)


def test_magnitude_and_phase_are_phasors(device, path, scene, random):
    """Phase is a lag: Z = magnitude · exp(−i·phase)."""
    made = scene()
    magnitude, phase = random.uniform(-2, 2, (2, 4, len(made.actuators)))
    solver = PlateSolver(made, device, path)
    pairs, complex_numbers = solver.run((magnitude, phase)), solver.run(magnitude * np.exp(-1j * phase))
    np.testing.assert_array_equal(pairs.energy, complex_numbers.energy)


def test_load_is_the_real_part_of_a_rotating_phasor(device, path, scene):
    """f = Re(Z exp(iωt)): from rest under cos ωt the plate moves with the first load, under sin ωt it does
    not."""
    made = scene(precision="float64")
    step = make_scheme(made).time_step
    run = PlateSolver(made, device, path).run([[1, 0, 0], [-1j, 0, 0]], times=(step, 2 * step))
    assert np.abs(run.displacement[0, 0]).max() > 0
    assert np.abs(run.displacement[1, 0]).max() == 0
    assert run.displacement[0, 0].min() >= 0
    assert run.displacement[1, 1].max() > 0


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_plate_does_not_depend_on_its_batch(device, path, precision, order, scene, phasors):
    """Alone, at any place of a batch, in chunks of any size: the same bits.

    The counts are enough for every way of putting plates side by side, and are no multiple of anything. A
    trace is asked for on CPU only, for on CUDA it would turn the resident path into the streaming one.
    """
    made = scene(damping=88.5, precision=precision, order=order)
    count, points = (71, ((0.05, 0.11),)) if device == "cpu" else (3571, ())
    drives = phasors(count, len(made.actuators))
    whole = PlateSolver(made, device, path).run(drives, (0.009,), points)
    alone = PlateSolver(made, device, path)
    for plate in (0, 7, 16, count - 1):
        check_same_plates(alone.run(drives[[plate]], (0.009,), points), whole, [plate])
    for chunk in (1, 5, 16, 33, 70) if device == "cpu" else (100, 2999):
        run = PlateSolver(made, device, path, chunk).run(drives, (0.009,), points)
        check_same_plates(run, whole, range(count))
    order = np.roll(np.arange(count)[::-1], 4)
    run = PlateSolver(made, device, path, 40 * count // 71).run(drives[order], (0.009,), points)
    check_same_plates(run, whole, order)


@pytest.mark.parametrize("nodes", [27, 41, 53])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_alone_or_in_a_group(nodes, precision, scene, phasors):
    """The CPU compiles different loops for a plate alone and for a group, and for each size: the same bits."""
    step = 0.9 * make_scheme(scene((nodes, nodes), order=4)).limit
    made = scene(
        (nodes, nodes), damping=88.5, order=4, load="moments", precision=precision, time_step=step,
        window=(40 * step, 120 * step),
    )  # fmt: skip
    drives = phasors(16, len(made.actuators))
    group = PlateSolver(made, "cpu", threads=1).run(drives, (90 * step,))
    alone = PlateSolver(made, "cpu", chunk=1, threads=1).run(drives, (90 * step,))
    check_same_plates(alone, group, range(16))


@pytest.mark.parametrize(
    ("nodes", "size", "plates"),
    [((13, 13), (0.2, 0.2), 40), ((97, 89), (0.096, 0.088), 1), ((97, 89), (0.096, 0.088), 4)],
    ids=["small plates", "one large plate", "large plates"],
)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_any_number_of_threads(nodes, size, plates, precision, scene, phasors):
    """Plates shared among threads, or threads sharing one plate, more of them than cores: the same bits."""
    step = 0.9 * make_scheme(scene(nodes, size)).limit
    made = scene(
        nodes, size, damping=88.5, precision=precision, window=(10 * step, 60 * step), time_step=step
    )
    drives = phasors(plates, len(made.actuators))
    points = [(0.3 * size[0], 0.4 * size[1])]
    alone = PlateSolver(made, "cpu", threads=1).run(drives, (30 * step,), points)
    assert alone.energy.min() > 0
    for threads in (2, 3, 5):
        run = PlateSolver(made, "cpu", threads=threads).run(drives, (30 * step,), points)
        check_same_plates(run, alone, range(plates))


def check_same_plates(run, whole, plates):
    for name in ("energy", "displacement", "trace"):
        np.testing.assert_array_equal(getattr(run, name), getattr(whole, name)[list(plates)])


def test_recording_does_not_change_energies(device, path, scene, phasors):
    made = scene(precision="float32")
    drives = phasors(6, len(made.actuators))
    solver = PlateSolver(made, device, path)
    plain = solver.run(drives)
    recorded = solver.run(drives, times=np.linspace(0, 0.012, 9), progress=lambda done, total: None)
    np.testing.assert_array_equal(plain.energy, recorded.energy)


def test_same_run_twice_same_bits(device, path, scene, phasors):
    made = scene(precision="float32")
    drives = phasors(11, len(made.actuators))
    solver = PlateSolver(made, device, path)
    first, again, other = solver.run(drives), solver.run(drives), PlateSolver(made, device, path).run(drives)
    np.testing.assert_array_equal(first.energy, again.energy)
    np.testing.assert_array_equal(first.energy, other.energy)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_any_size_of_drive(device, path, precision, scene, phasors):
    """From 1e-15 to 1e15 N/m²: the same shares, energies as the square; only the scaling itself is
    rounded."""
    made = scene(precision=precision)
    drive = phasors(1, len(made.actuators))
    sizes = 10.0 ** np.arange(-15, 16, 5)
    run = PlateSolver(made, device, path).run(drive * sizes[:, None], times=(0.012,))
    tolerance = 1e-5 if precision == "float32" else 1e-12
    reference = len(sizes) // 2
    np.testing.assert_allclose(factors(run), factors(run)[reference], rtol=tolerance)
    np.testing.assert_allclose(
        run.energy / sizes[:, None] ** 2, run.energy[[reference] * len(sizes)], rtol=tolerance
    )
    assert np.abs(run.displacement[-1]).max() == pytest.approx(
        1e15 * np.abs(run.displacement[reference]).max(), rel=1e-4
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, complex(0, np.nan), complex(np.inf, -np.inf)])
def test_a_bad_plate_touches_no_neighbour(device, path, bad, scene, phasors):
    """A drive that is no finite number spoils its own plate only, there and in later runs of the same
    solver."""
    made = scene(precision="float32")
    drives = phasors(7, len(made.actuators))
    solver = PlateSolver(made, device, path)
    healthy = solver.run(drives, (0.012,))
    spoiled = drives.copy()
    spoiled[3, 1] = bad
    run = solver.run(spoiled, (0.012,))
    others = [0, 1, 2, 4, 5, 6]
    assert run.finite.tolist() == [plate in others for plate in range(7)]
    np.testing.assert_array_equal(run.energy[others], healthy.energy[others])
    np.testing.assert_array_equal(run.displacement[others], healthy.displacement[others])
    np.testing.assert_array_equal(solver.run(drives).energy, healthy.energy)


def test_no_drive_no_movement(device, path, scene):
    run = PlateSolver(scene(damping=88.5), device, path).run([[0, 0, 0], [1, 0, 0]], (0.012,), ((0.1, 0.1),))
    assert run.energy[0].tolist() == [0, 0]
    assert not run.displacement[0].any()
    assert not run.trace[0].any()
    assert run.energy[1].min() > 0


def test_no_plates(device, path, scene):
    """A batch of none is a batch, with and without a chunk size."""
    for chunk in (None, 4):
        run = PlateSolver(scene(), device, path, chunk).run(np.empty((0, 3)), (0.012,))
        assert run.energy.shape == (0, 2)
        assert run.displacement.shape == (0, 1, 13, 13)
        assert run.node_steps == 0


def test_recorded_times_are_the_nearest_of_the_grid(device, path, scene, phasors):
    """In the order asked for, repeated ones too, the whole run covered: t = 0 is at rest."""
    made = scene()
    step = make_scheme(made).time_step
    asked = (0.012, 0.0, 7.4 * step, 6.6 * step, 0.012)
    run = PlateSolver(made, device, path).run(phasors(2, 3), asked)
    np.testing.assert_allclose(run.times, [0.012, 0, 7 * step, 7 * step, 0.012], rtol=1e-12)
    assert not run.displacement[:, 1].any()
    np.testing.assert_array_equal(run.displacement[:, 2], run.displacement[:, 3])
    np.testing.assert_array_equal(run.displacement[:, 0], run.displacement[:, 4])
    assert np.abs(run.displacement[:, 0] - run.displacement[:, 2]).max() > 0


def test_traces_are_bilinear(device, path, scene, phasors):
    """At a node its own displacement; between four nodes their mean, weighted; on the far corner, which is
    held, zero."""
    made = scene((13, 9), (0.2, 0.16))
    scheme = make_scheme(made)
    hx, hy = scheme.spacing
    points = [(4 * hx, 3 * hy), (4.25 * hx, 3.5 * hy), (0.2, 0.16), (12 * hx, 4 * hy)]
    steps = np.arange(1, scheme.steps + 1)
    run = PlateSolver(made, device, path).run(phasors(3, 3), steps * scheme.time_step, points)
    np.testing.assert_allclose(run.trace_times, steps * scheme.time_step, rtol=1e-12)
    u = run.displacement.transpose(0, 2, 3, 1)
    between = (0.75 * (u[:, 3, 4] + u[:, 4, 4]) + 0.25 * (u[:, 3, 5] + u[:, 4, 5])) / 2
    largest = np.abs(u).max()
    np.testing.assert_allclose(run.trace[:, 0], u[:, 3, 4], rtol=0, atol=1e-13 * largest)
    np.testing.assert_allclose(run.trace[:, 1], between, rtol=0, atol=1e-13 * largest)
    assert np.abs(run.trace[:, 2:]).max() == 0


@pytest.mark.parametrize(
    "drives",
    [
        [1, 0, 0],
        [[1, 0]],
        np.ones((2, 3, 1)),
        [["a", "b", "c"]],
        [[1, 0, 0], [1]],
        None,
        (np.ones((2, 3)), np.ones((2, 2))),
    ],
    ids=["one row", "two columns", "three axes", "words", "ragged", "None", "unlike pair"],
)
def test_drives_of_another_shape_are_refused(drives, scene):
    with pytest.raises(SceneError, match=r"^drives: .*") as caught:
        PlateSolver(scene(), "cpu").run(drives)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("point", [(0.21, 0.1), (0.1, -0.01), (float("nan"), 0.1)])
def test_points_off_the_plate_are_refused(point, scene):
    """Beyond the edge there is nothing to interpolate."""
    with pytest.raises(SceneError, match="points"):
        PlateSolver(scene(), "cpu").run([[1, 0, 0]], points=[(0.1, 0.1), point])


@pytest.mark.parametrize("time", [0.02, -0.001, float("nan")])
def test_times_outside_the_run_are_refused(time, scene):
    with pytest.raises(SceneError, match="times"):
        PlateSolver(scene(), "cpu").run([[1, 0, 0]], times=[0.01, time])


@pytest.mark.parametrize("name", ["gpu", "cuda:99", "", "cpu:1"])
def test_unknown_devices_are_refused(name, scene):
    with pytest.raises(SceneError, match="device") as caught:
        PlateSolver(scene(), name)
    assert "cpu" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_paths_are_refused(scene):
    with pytest.raises(SceneError, match="path = 'fast'") as caught:
        PlateSolver(scene(), "cpu", "fast")
    assert "streaming" in str(caught.value)


@pytest.mark.parametrize("chunk", [0, -3])
def test_chunks_hold_at_least_one_plate(chunk, scene):
    with pytest.raises(SceneError, match="chunk"):
        PlateSolver(scene(), "cpu", chunk=chunk).run([[1, 0, 0]])


def test_progress_reaches_the_whole(device, path, scene):
    """Node-steps: nodes that move × steps × plates; told in growing numbers, the last one the sum."""
    made = scene()
    told = []
    solver = PlateSolver(made, device, path, 2)
    run = solver.run(np.eye(3), progress=lambda done, total: told.append((done, total)))
    node_steps = 3 * 11 * 11 * make_scheme(made).steps
    assert run.node_steps == solver.node_steps == node_steps
    assert [total for _, total in told] == [node_steps] * len(told)
    done = [done for done, _ in told]
    assert done == sorted(done)
    assert done[-1] == node_steps
    assert len(set(done)) >= 2
