"""Plates that differ in frequencies, places and delays, each against the scene with its values, on every path; and
energies of displacements."""

import numpy as np
import pytest

from support.oracle import (
    FOUR_EDGES,
    LINEAR,
    TOLERANCE,
    bending_load,
    check_run,
    reference,
    run_on_a_block,
    with_all_effects,
)
from warp_plate import PlateSolver, SceneError
from warp_plate.kernels import plans
from warp_plate.plate.designs import Designs, PerPlate
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import region_weights

# A scene for each kernel: of a warp, of a block (row by row on a CPU), of fourth order, with effects.
KINDS = {
    "small": {"nodes": (16, 13), "size": (0.2, 0.17)},
    "block": {"nodes": (97, 89), "size": (0.096, 0.088)},
    "fourth order": {"nodes": (16, 13), "size": (0.2, 0.17), "order": 4, "load": "moments"},
    "general": {"nodes": (9, 13), "size": (0.2, 0.17), "load": "moments", "effects": LINEAR},
}
ALL = PerPlate(frequency=True, delay=True, centre=True)
# Everything on every kernel, and quantities alone; tests of waves have frequencies alone.
CASES = [
    ("small", ALL, "float32"),
    ("block", ALL, "float32"),
    ("fourth order", ALL, "float64"),
    ("general", PerPlate(frequency=True, delay=True, centre=True, per_actuator=True), "float64"),
    ("general", PerPlate(delay=True), "float32"),
    ("small", PerPlate(centre=True), "float32"),
]
REPEATED = [("small", "float32"), ("fourth order", "float64"), ("general", "float32")]
STEPS = 90


@pytest.fixture
def burst_scene(scene):
    """A factory of scenes of STEPS steps under a burst."""

    def make(precision="float64", damping=30.0, drive=(), **tables):
        if "effects" not in tables:
            tables["damping"] = damping
        step = 0.8 * make_scheme(scene(**tables)).limit
        end = STEPS * step
        burst = {"start": 0.1 * end, "duration": 0.6 * end, "ramp": 0.1 * end}
        return scene(
            precision=precision, time_step=step, window=(end / 3, end),
            drive={"frequency": 0.03 / step, "burst": burst, **dict(drive)}, **tables,
        )  # fmt: skip

    return make


@pytest.fixture
def draw(random, phasors):
    """A factory of random designs of a scene for ``per_plate``."""

    def make(made, per_plate, plates):
        count, step, end = len(made.actuators), made.grid.time_step, made.window.end
        columns = count if per_plate.per_actuator else 1
        frequency = np.tile(random.uniform(0.01, 0.1, (plates, columns)) / step, count // columns)
        delay = np.tile(random.uniform(0, 0.3, (plates, columns)) * end, count // columns)
        half = half_sides(made)
        centre = half + random.uniform(0, 1, (plates, count, 2)) * (np.array(made.plate.size) - 2 * half)
        centre[0, :, 0], centre[-1, 0] = half[:, 0], np.array(made.plate.size) - half[0]  # flush with the edges
        return Designs(
            phasors(plates, count),
            frequency if per_plate.frequency else None,
            centre if per_plate.centre else None,
            delay if per_plate.delay else None,
        )

    return make


def half_sides(made):
    """Return (actuators, 2) half the sides of the patches [m]."""
    areas = np.array([actuator.area for actuator in made.actuators])
    return np.stack([areas[:, 1] - areas[:, 0], areas[:, 3] - areas[:, 2]], axis=1) / 2


def scene_of_plate(made, designs, plate):
    """Return the scene with one plate's values in it."""
    tables = made.model_dump(exclude_none=True)
    for index, (actuator, half) in enumerate(zip(tables["actuators"], half_sides(made), strict=True)):
        if designs.frequency is not None:
            actuator["frequency"] = designs.frequency[plate, index]
        if designs.centre is not None:
            (x, y), (width, height) = designs.centre[plate, index], half
            actuator["area"] = (x - width, x + width, y - height, y + height)
        if designs.delay is not None:
            actuator["delay"] = designs.delay[plate, index]
    return made.with_tables(**tables)


@pytest.mark.parametrize(("kind", "per_plate", "precision"), CASES)
def test_each_plate_is_its_own_scene(device, path, kind, per_plate, precision, burst_scene, draw, fitting_solver):
    """Against NumPy, with traces; values that are not given are the scene's."""
    made = burst_scene(precision, **KINDS[kind])
    designs, step = draw(made, per_plate, 2), made.grid.time_step
    points = [tuple(np.multiply((0.37, 0.6), made.plate.size))] if kind == "small" else []
    solver = fitting_solver(made, device, path, per_plate=per_plate)
    run = solver.run(designs, (20 * step, 75 * step), points)
    check_each(run, made, designs, points)
    plain = PlateSolver(made, device, path).run(designs.drives)
    np.testing.assert_allclose(solver.run(designs.drives).energy, plain.energy, rtol=TOLERANCE[precision])


def check_each(run, made, designs, points=()):
    """Compare a run of designs with the scenes of its plates."""
    alone = [reference(scene_of_plate(made, designs, k), designs.drives[k : k + 1]) for k in range(len(designs))]
    check_run(run, made, [np.concatenate(values) for values in zip(*alone, strict=True)], points)


HELD = (*plans.REGISTERS_FIRST, "membrane_curvature", "inverse_mass")


@pytest.mark.parametrize("planes", [(), pytest.param(HELD, marks=pytest.mark.slow)])
def test_the_kernel_of_blocks_on_cpu(planes, scene, draw, monkeypatch):
    """The CUDA kernel of the moment form in a block of one thread: with all effects, or few and planes in registers."""
    drive = {"frequency": 290.0, "burst": {"duration": 0.004, "ramp": 1e-3}}
    effects, nodes = {"damping": {"viscous": 50.0}, "stretching": {}}, (5, 5) if planes else (9, 8)  # loops unroll
    made = scene(nodes, (0.2, 0.2), FOUR_EDGES, window=(0.002, 0.005), drive=drive, effects=effects)
    made = made if planes else with_all_effects(made)
    per_plate = PerPlate(frequency=True, delay=True, per_actuator=True)
    made = made.with_tables(grid={**made.grid.model_dump(), "time_step": make_scheme(made).time_step})
    designs = draw(made, per_plate, 2)
    designs.drives[:] *= bending_load(made)
    run_on_a_block(monkeypatch, planes)
    points = [(0.06, 0.15)]
    run = PlateSolver(made, "cpu", "resident", per_plate=per_plate).run(designs, (0.002, 0.005), points)
    check_each(run, made, designs, points)


@pytest.mark.parametrize(("kind", "precision"), REPEATED)
def test_a_plate_does_not_depend_on_its_batch(device, path, kind, precision, burst_scene, draw, fitting_solver):
    """Alone, in chunks, beside a plate without a finite drive, after others, after NaN in memory: the same bits."""
    made = burst_scene(precision, **KINDS[kind])
    designs, solver = draw(made, ALL, 19), fitting_solver(made, device, path, per_plate=ALL)
    together = solver.run(designs).energy
    assert len(np.unique(together[:, 0])) == 19
    chunks = PlateSolver(made, device, path, chunk=7, per_plate=ALL)
    np.testing.assert_array_equal(chunks.run(designs).energy, together)
    plain = solver.run(designs.drives).energy
    assert not solver.run(np.full_like(designs.drives, np.nan)).finite.any()
    np.testing.assert_array_equal(solver.run(designs[3:4]).energy, together[3:4])
    np.testing.assert_array_equal(solver.run(designs.drives).energy, plain)
    designs.drives[5] = np.nan
    mixed = solver.run(designs)
    assert mixed.status[5] == "drive is not finite"
    np.testing.assert_array_equal(np.delete(mixed.energy, 5, axis=0), np.delete(together, 5, axis=0))


def test_patches_within_areas(device, path, burst_scene):
    """With moments, a patch loads two nodes beyond it on each side, also where areas confine it."""
    made = burst_scene(nodes=(16, 13), size=(0.2, 0.17), load="moments")
    old = np.array([actuator.area for actuator in made.actuators])
    areas = tuple(map(tuple, (old + 0.02 * np.array([-1, 1, -1, 1])).tolist()))
    centre = (old[:, [0, 2]] + old[:, [1, 3]]) / 2 + 0.02 * np.array([[1, 1], [-1, 1], [1, -1]])
    designs = Designs(np.array([[1.0, 0.5j, -0.7]]), centre=centre[None])
    run = PlateSolver(made, device, path, per_plate=PerPlate(centre=True, areas=areas)).run(designs)
    moved = PlateSolver(scene_of_plate(made, designs, 0), device, path).run(designs.drives)
    np.testing.assert_allclose(run.energy, moved.energy, rtol=1e-11)


DRIVES = {
    "tone": {"burst": None},
    "bursts": {"burst": {"duration": 0.002, "ramp": 0.0006, "period": 0.003}},
    "linear sweep": {"chirp": {"end_frequency": 400.0, "duration": 0.005}},
    "logarithmic sweep": {"chirp": {"end_frequency": 400.0, "duration": 0.005, "law": "logarithmic"}},
    "squares": {"electrostatic": {"gain": 2.0}},
    "biased squares": {"electrostatic": {"gain": 2.0, "bias": 3.0}},
}


@pytest.mark.parametrize(("name", "per_actuator"), [(name, index % 2 == 0) for index, name in enumerate(DRIVES)])
def test_waves_are_those_of_the_scene(name, per_actuator, scene, draw, pairs):
    """Computed on the host or on the device."""
    drive = {"frequency": 290.0, "burst": {"start": 0.001, "duration": 0.006, "ramp": 0.002}, **DRIVES[name]}
    made = scene((9, 9), time_step=8e-5, window=(0.002, 0.008), drive=drive)
    per_plate = PerPlate(frequency=True, delay=drive["burst"] is not None, per_actuator=per_actuator)
    designs = draw(made, per_plate, 2)
    for device in {device for device, _ in pairs}:
        check_each(PlateSolver(made, device, per_plate=per_plate).run(designs), made, designs)


@pytest.mark.parametrize(("kind", "precision"), REPEATED)
def test_energies_of_displacements(device, path, kind, precision, burst_scene, draw, fitting_solver):
    """Against the displacement of every step in the window, of plain drives and of designs."""
    made, tolerance = burst_scene(precision, **KINDS[kind]), TOLERANCE[precision]
    designs, scheme = draw(made, ALL, 2), make_scheme(made)
    solver = fitting_solver(made, device, path, per_plate=ALL, quantity="displacement")
    for asked in (designs.drives, designs):
        run = solver.run(asked)
        for plate in range(2):
            one = scene_of_plate(made, designs, plate) if asked is designs else made
            _, history = reference(one, designs.drives[plate : plate + 1])
            squares = (history[0, scheme.window[0] + 1 : scheme.window[1] + 1] ** 2).mean(axis=0)
            mass = scheme.spacing[0] * scheme.spacing[1] * region_weights(one)
            mass = mass * (scheme.surface_density if scheme.bending is None else scheme.bending.mass)
            expected = np.einsum("ryx,yx->r", mass, squares)
            np.testing.assert_allclose(run.energy[plate], expected / 2, rtol=tolerance)
            np.testing.assert_allclose(run.masses, mass.sum(axis=(1, 2)), rtol=tolerance)


def refuses(message, call, *arguments, **options):
    with pytest.raises(SceneError, match=message):
        call(*arguments, **options)


def test_bad_designs_are_refused(burst_scene, draw):
    made = burst_scene(nodes=(9, 9), size=(0.2, 0.17))
    designs, solver = draw(made, ALL, 3), PlateSolver(made, "cpu", per_plate=ALL)
    plain = PlateSolver(made, "cpu", quantity="displacement")
    kept = PerPlate(centre=True, areas=tuple(actuator.area for actuator in made.actuators))
    centres = Designs(designs.drives, centre=designs.centre)
    refuses(r"designs\.frequency.*PerPlate\(frequency=True\)", plain.run, designs)
    refuses("times, points", plain.run, designs.drives, times=(0.0,))
    refuses("designs.centre: shape", solver.run, Designs(designs.drives, centre=designs.centre[:2]))
    refuses("'0' on plate 0", PlateSolver(made, "cpu", per_plate=kept).run, centres)
    for name, value, message in (
        ("centre", (0.001, 0.08), "must be a place"),
        ("centre", np.nan, "must be a place"),
        ("frequency", 0.6 / made.grid.time_step, "must be 0 ... "),
        ("frequency", -1.0, "must be 0 ... "),
        ("frequency", 200.0, r"must be one value .* PerPlate\(per_actuator=True\)"),
        ("delay", made.window.end, "must be 0 ... "),
    ):
        values = getattr(designs, name).copy()
        values[2, 1] = value
        refuses(f"'1' on plate 2; {message}", solver.run, Designs(designs.drives, **{name: values}))


def test_bad_solvers_are_refused(scene):
    def solver(per_plate=None, quantity="velocity", **tables):
        PlateSolver(scene((9, 9), **tables), "cpu", per_plate=per_plate or PerPlate(), quantity=quantity)

    refuses("grid.load", solver, PerPlate(centre=True), load="nodes")
    refuses("drive.burst", solver, PerPlate(delay=True))
    refuses("drive.signal", solver, PerPlate(frequency=True), drive={"frequency": 290.0, "signal": {"file": "a.wav"}})
    refuses("per_plate.areas", solver, PerPlate(centre=True, areas=((0.0, 0.2, 0.0, 0.2),)))
    refuses("quantity = 'speed'", solver, quantity="speed")
    refuses("effects.stretching", solver, quantity="displacement", effects={"stretching": {}})
    refuses("grid.order = 4", solver, PerPlate(frequency=True, per_actuator=True), order=4)
