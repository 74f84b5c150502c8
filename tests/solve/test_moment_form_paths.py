"""The moment-form paths against ``reference.numpy_moment_form``: random mixes of effects and edges on every device.

Tolerances are relative to the largest number of the run. Both sides round a few times ε a step, in another order; near
the stability limit and with dampers a few hundred steps gather some hundred ε.
"""

import dataclasses

import numpy as np
import pytest
from test_paths import bilinear

from warp_plate import PlateSolver, SceneError
from warp_plate.kernels import moment_form_plan
from warp_plate.plate.scheme import make_scheme
from warp_plate.reference.numpy_moment_form import run_moment_form
from warp_plate.solve import moment_form, paths

TOLERANCE = {"float32": 3e-4, "float64": 1e-11}
# Nodes and sides [m]: odd, even, oblong, and the smallest; cells are square in the first alone.
GRIDS = {
    "smallest": ((5, 5), (0.2, 0.2)),
    "odd": ((13, 11), (0.2, 0.18)),
    "even": ((12, 14), (0.21, 0.2)),
    "wide": ((33, 7), (0.24, 0.06)),
    "high": ((6, 26), (0.05, 0.3)),
}
MIXES = 20
STEPS = 220


def random_edge(random):
    """Draw one of the four kinds; springs from soft to nearly rigid, either of which may be absent."""
    springs = {"translation": 10 ** random.uniform(2, 6), "rotation": 10 ** random.uniform(-3, 2)}
    if random.random() < 0.3:
        springs.pop(("translation", "rotation")[random.integers(2)])
    return ("clamped", "supported", "free", springs)[random.integers(4)]


def random_area(random, size):
    """Draw a rectangle on the plate, of half its sides at most."""
    x0, y0 = random.uniform(0, 0.5, 2) * size
    x1, y1 = (x0, y0) + random.uniform(0.2, 0.5, 2) * size
    return (x0, x1, y0, y1)


def random_effects(random, size, stretching):
    """Draw each effect with even chance, of the size that it has on panels like the paper's; never none at all."""
    effects = {
        "damping": {"viscous": random.uniform(0, 100), "scheme": ("centred", "backward")[random.integers(2)]},
        "material_damping": {"time": 10 ** random.uniform(-7, -5)},
        "tension": {"x": random.uniform(0, 20), "y": random.uniform(0, 20)},
        "foundation": {"stiffness": 10 ** random.uniform(3, 6), "damping": random.uniform(0, 50)},
        "orthotropic": {"Dx": 0.02, "Dy": 0.008, "D1": random.uniform(-0.002, 0.006), "Dxy": 0.004},
        "variation": {
            "thickness": random.uniform(0.5, 1.5, (3, 2)).tolist(),
            "young_modulus": random.uniform(0.5, 2, (1, 4)).tolist(),
            "density": random.uniform(0.5, 2, (2, 1)).tolist(),
        },
        "layers": [
            {
                "area": random_area(random, size),
                "thickness": random.uniform(1e-4, 5e-4),
                "young_modulus": random.uniform(0, 9e9),
                "density": random.uniform(0, 3000),
                "both": bool(random.integers(2)),
            }
            for _ in range(random.integers(1, 4))
        ],
        "oscillators": [
            {
                "area": random_area(random, size),
                "mass": random.choice([0.0, 0.003]),
                "stiffness": random.uniform(50, 500),
                "damping": random.choice([0.0, 0.1]),
            }
            for _ in range(random.integers(1, 4))
        ],
        "moving_load": {
            "force": 10 ** random.uniform(-4, -1),
            "start": tuple(random.uniform(0, 1, 2) * size),
            "velocity": tuple(random.normal(size=2) * size * 100),
            "size": random.choice([0.0, 0.02, 0.05]),
        },
    }
    kept = {name: table for name, table in effects.items() if random.random() < 0.5}
    kept.setdefault("foundation", {"stiffness": 1e3})
    return {**kept, "stretching": {}} if stretching else kept


def random_drive(random, end, frequency):
    """Draw the [drive] table, with or without chirp, burst and squares, and the frequencies of three actuators."""
    drive = {"frequency": frequency}
    if random.random() < 0.4:
        drive["chirp"] = {"end_frequency": random.uniform(0.3, 1.5) * frequency, "duration": 0.7 * end}
    if random.random() < 0.4:
        drive["burst"] = {"start": 0.1 * end, "duration": 0.5 * end, "ramp": 0.1 * end}
    if random.random() < 0.4:
        drive["electrostatic"] = {"bias": random.choice([0.0, 2.0]), "gain": random.uniform(0.1, 2)}
    apart = random.random() < 0.5
    return drive, random.choice([frequency, 0.7 * frequency, 2 * frequency], 3) if apart else [None] * 3


@pytest.fixture
def mix(scene, random):
    """A factory of scenes with a random mix of effects and edges, a step near the limit, and a few drives."""

    def draw(nodes, size, precision="float64", stretching=False, plates=2):
        effects, edges = random_effects(random, size, stretching), [random_edge(random) for _ in range(4)]
        areas, load = [random_area(random, size) for _ in range(3)], ("overlap", "moments")[random.integers(2)]
        trial = scene(nodes, size, edges, actuators=areas, load=load, effects=effects)
        step = random.uniform(0.5, 0.9) * make_scheme(trial).limit
        drive, frequencies = random_drive(random, STEPS * step, random.uniform(0.005, 0.05) / step)
        if stretching:
            drive.pop("electrostatic", None)  # squares of these drives would be far too large
        made = scene(
            nodes, size, edges, precision=precision, window=(STEPS / 3 * step, STEPS * step), actuators=areas,
            load=load, time_step=step, drive=drive, effects=effects,
        )  # fmt: skip
        actuators = zip(made.model_dump()["actuators"], frequencies, strict=True)
        made = made.with_tables(actuators=[{**table, "frequency": own} for table, own in actuators])
        drives = random.normal(size=(plates, 3)) + 1j * random.normal(size=(plates, 3))
        return made, drives * bending_load(made) if stretching else drives

    return draw


def bending_load(scene):
    """Return a pressure [N/m²] that deflects the plate by about its thickness, so that stretching counts."""
    double = scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": "float64"})})
    linear = double.model_copy(update={"effects": double.effects.model_copy(update={"stretching": None})})
    drive = np.ones((1, len(scene.actuators)), dtype=complex)
    return scene.plate.thickness / np.abs(run_moment_form(linear, drive).displacement).max()


def check(run, scene, reference, points=()):
    """Compare energies, displacements and traces of a run."""
    tolerance, scheme = TOLERANCE[scene.grid.precision], make_scheme(scene)
    history = reference.displacement
    largest = np.abs(history).max(axis=(1, 2, 3))[:, None, None, None]
    assert (largest > 0).all()
    np.testing.assert_allclose(run.energy, reference.energy, rtol=0, atol=tolerance * reference.energy.max())
    steps = np.rint(run.times / scheme.time_step).astype(int)
    np.testing.assert_allclose(run.displacement / largest, history[:, steps] / largest, rtol=0, atol=tolerance)
    for trace, (x, y) in zip(run.trace.swapaxes(0, 1), points, strict=True):
        expected = bilinear(history[:, 1:], x / scheme.spacing[0], y / scheme.spacing[1])
        np.testing.assert_allclose(trace / largest[:, 0, 0], expected / largest[:, 0, 0], rtol=0, atol=tolerance)


@pytest.mark.parametrize("number", [n if n < 6 else pytest.param(n, marks=pytest.mark.slow) for n in range(MIXES)])
def test_random_mixes(device, path, number, mix, random):
    """Every grid in both precisions, with other effects each time; every third mix stretches."""
    nodes, size = list(GRIDS.values())[number % len(GRIDS)]
    precision = ("float64", "float32")[number % 2]
    made, drives = mix(nodes, size, precision, stretching=number % 3 == 2)
    times = np.sort(random.uniform(0, 1, 3)) * made.window.end
    points = [(0.0, 0.0), tuple(random.uniform(0, 1, 2) * size)]
    print(made.edges, made.effects, made.drive, made.actuators)
    solver, reference = PlateSolver(made, device, path), run_moment_form(made, drives)
    check(solver.run(drives, times), made, reference)
    check(solver.run(drives, times, points), made, reference, points)


def all_effects(made):
    """Return a scene with every effect, on edges of four kinds, under a burst of two frequencies."""
    (x0, x1, y0, y1), size = made.actuators[0].area, made.plate.size
    effects = {
        "damping": {"viscous": 30.0},
        "material_damping": {"time": 1e-6},
        "tension": {"x": 5.0, "y": 2.0},
        "foundation": {"stiffness": 1e4, "damping": 10.0},
        "orthotropic": {"Dx": 0.02, "Dy": 0.008, "D1": 0.003, "Dxy": 0.004},
        "layers": [{"area": (x0, x1, y0, y1), "thickness": 2e-4, "young_modulus": 3e9, "density": 2000.0}],
        "oscillators": [
            {"area": (0.0, size[0] / 3, 0.0, size[1]), "mass": 0.003, "stiffness": 300.0, "damping": 0.1},
            {"area": (size[0] / 2, size[0], 0.0, size[1] / 2), "stiffness": 200.0},
        ],
        "stretching": {},
        "moving_load": {"force": 0.3, "start": (x0, y0), "velocity": (20.0, 10.0), "size": 0.01},
    }
    edges = {"left": "clamped", "bottom": "supported", "right": "free", "top": {"translation": 1e4, "rotation": 0.1}}
    tables = made.model_dump(exclude_none=True)
    tables["grid"].pop("time_step", None)
    tables["drive"]["burst"] = {"duration": made.window.end, "ramp": 1e-3}
    tables["actuators"][1]["frequency"] = 170.0
    return made.with_tables(**{**tables, "edges": edges, "effects": effects})


@pytest.fixture
def full(scene, random):
    """A factory of scenes with all effects at once, and drives that stretch the plate."""

    def make(precision, plates, **grid):
        made = all_effects(scene((13, 11), (0.2, 0.18), precision=precision, window=(0.002, 0.006), **grid))
        drives = random.normal(size=(plates, 3)) + 1j * random.normal(size=(plates, 3))
        return made, drives * bending_load(made)

    return make


def check_same(run, other):
    """Compare all arrays of two runs bit for bit."""
    for field in dataclasses.fields(run):
        if isinstance(getattr(run, field.name), np.ndarray):
            np.testing.assert_array_equal(getattr(run, field.name), getattr(other, field.name))


@pytest.mark.parametrize("in_registers", [False, True])
def test_the_cuda_kernel_on_cpu(in_registers, mix, full, monkeypatch):
    """A block of one thread runs anywhere: with all numbers in memory, or all that can be in registers."""
    made, drives = mix(*GRIDS["smallest"], stretching=True) if in_registers else full("float64", 2)

    def one_thread(specialized):
        effects, (nx, ny) = specialized.effects, specialized.scheme.nodes
        material = moment_form_plan.material_planes(effects)
        names = (*moment_form_plan.REGISTERS_FIRST, "membrane_curvature", *material) if in_registers else ()
        planes = moment_form_plan.workspace_planes(effects, names)
        nodes = nx * ny + 1  # one beyond the plate
        return moment_form.block_path(specialized, moment_form_plan.BlockPlan(1, nodes, names, planes, False, 64))

    monkeypatch.setitem(paths.MOMENT_FORM, "resident", one_thread)
    points = [tuple(np.multiply((0.3, 0.9), made.plate.size))]
    run = PlateSolver(made, "cpu", "resident").run(drives, (made.window.end / 2,), points)
    check(run, made, run_moment_form(made, drives), points)


@pytest.mark.parametrize("precision", TOLERANCE)
def test_a_plate_does_not_depend_on_its_batch(device, path, precision, full):
    """All effects at once; alone, among others, in chunks, after NaN, and beside plates that are not finite."""
    made, drives = full(precision, 21)
    times = (0.0, 0.002, 0.0045, 0.006)
    solver, reference = PlateSolver(made, device, path), run_moment_form(made, drives)
    together = solver.run(drives, times)
    check(together, made, reference)
    assert np.abs(reference.displacement).max() > 0.3 * made.plate.thickness
    for plate in (0, 20):
        alone = solver.run(drives[plate : plate + 1], times)
        np.testing.assert_array_equal(alone.energy[0], together.energy[plate])
        np.testing.assert_array_equal(alone.displacement[0], together.displacement[plate])
    check_same(PlateSolver(made, device, path, chunk=4).run(drives, times), together)
    spoiled = solver.run(np.full_like(drives, np.nan), times)
    assert not spoiled.finite.any()
    check_same(solver.run(drives, times), together)
    drives[3], drives[18] = np.nan, 1e200 if precision == "float32" else 1e300
    mixed = solver.run(drives, times)
    good = np.isfinite(np.abs(drives)).all(axis=1) & (np.abs(drives).max(axis=1) < 1e100)
    assert not mixed.finite[3]
    assert good.sum() == 19
    np.testing.assert_array_equal(mixed.energy[good], together.energy[good])
    np.testing.assert_array_equal(mixed.displacement[good], together.displacement[good])


def test_what_the_reference_refuses(scene):
    """A plain plate has its own reference; a step above the limit has none."""
    with pytest.raises(ValueError, match="numpy_plate"):
        run_moment_form(scene(), np.ones((1, 3)))
    with pytest.raises(SceneError, match="stability limit"):
        run_moment_form(scene(time_step=1e-3, effects={"foundation": {"stiffness": 1e4}}), np.ones((1, 3)))
