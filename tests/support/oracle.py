"""The independent NumPy steppers as one reference for all runs, and scenes with random effects or all of them.

Tests that need no grid in particular take 13 nodes along y and 9 to 16 along x, with the effects LINEAR or all of
``with_all_effects``: they share compiled kernels.
"""

import numpy as np

from support.numpy_plate import run_moment_form, run_plate
from warp_plate.kernels import plans
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import make_signals
from warp_plate.plate.weights import patches, region_weights
from warp_plate.solve import compiled_scene, moment_form

# Relative to the largest number of a plate. Both sides round a few times ε a step, in another order; a few hundred
# steps near the stability limit gather some hundred ε.
TOLERANCE = {"float32": 3e-4, "float64": 1e-11}
LINEAR = {
    "damping": {"viscous": 60.0},
    "material_damping": {"time": 1e-6},
    "tension": {"x": 5.0, "y": 2.0},
    "foundation": {"stiffness": 1e4, "damping": 10.0},
    "layers": [{"area": (0.03, 0.08, 0.03, 0.08), "thickness": 1e-4, "young_modulus": 2e9, "density": 1500.0}],
    "oscillators": [
        {"area": (0.0, 0.07, 0.0, 0.16), "mass": 0.003, "stiffness": 300.0, "damping": 0.1},
        {"area": (0.1, 0.16, 0.0, 0.08), "stiffness": 200.0},
    ],
}
FOUR_EDGES = ("clamped", "supported", "free", {"translation": 1e4, "rotation": 0.1})


def reference(made, drives):
    """Return energies (plates, regions) and the displacements of all steps (plates, steps + 1, ny, nx)."""
    scheme, damping, drive = make_scheme(made), made.effects.damping, made.drive
    if scheme.bending is not None:
        history = run_moment_form(made, drives)
        return history.energy, history.displacement
    carrier = None
    if drive.burst or drive.chirp or drive.signal:
        carrier = make_signals(made, scheme.time_step, scheme.steps, made.folder).wave @ [1, 1j]
        carrier[0] *= 2  # halved by the reference itself
    edges, viscous = tuple(edge for _, edge in sides_of(made)), damping.viscous if damping else 0.0
    backward = damping is not None and damping.scheme == "backward"
    displacement, squares = run_plate(scheme, edges, viscous, backward, patches(made), drives, carrier)
    weights = 0.5 * scheme.surface_density * scheme.spacing[0] * scheme.spacing[1] * region_weights(made)
    return np.einsum("ryx,pyx->pr", weights, squares), displacement


def sides_of(made):
    return [(side, getattr(made.edges, side)) for side in ("left", "bottom", "right", "top")]


def check_run(run, made, exact, points=()):
    """Compare energies, displacements and traces of a run with :func:`reference`."""
    (energy, history), scheme, tolerance = exact, make_scheme(made), TOLERANCE[made.grid.precision]
    assert (energy > 0).all()
    if made.effects.stretches:  # rounding grows
        tolerance *= 10
    total = energy.max(axis=1)[:, None]
    np.testing.assert_allclose(run.energy / total, energy / total, rtol=0, atol=tolerance)
    largest = np.abs(history).max(axis=(1, 2, 3))[:, None]
    steps = np.rint(run.times / scheme.time_step).astype(int)
    shown = history[:, steps] / largest[..., None, None]
    np.testing.assert_allclose(run.displacement / largest[..., None, None], shown, rtol=0, atol=tolerance)
    for trace, (x, y) in zip(run.trace.swapaxes(0, 1), points, strict=True):
        expected = bilinear(history[:, 1:], x / scheme.spacing[0], y / scheme.spacing[1])
        np.testing.assert_allclose(trace / largest, expected / largest, rtol=0, atol=tolerance)


def bilinear(history, i, j):
    """Interpolate the displacement at i nodes from the left and j from below."""
    column, row = (min(int(at), count - 2) for at, count in zip((i, j), history.shape[:1:-1], strict=True))
    i, j = i - column, j - row
    corner = history[..., row : row + 2, column : column + 2]
    return np.einsum("...yx,y,x->...", corner, [1 - j, j], [1 - i, i])


def check_same(run, whole, plates=slice(None)):
    """Compare the numbers of a run with those of plates of another one bit for bit."""
    for name in ("energy", "displacement", "trace"):
        np.testing.assert_array_equal(getattr(run, name), getattr(whole, name)[plates])


def with_all_effects(made):
    """Return a scene with every effect, on edges of four kinds, under a burst of two frequencies."""
    x0, _, y0, _ = made.actuators[0].area
    tables = made.model_dump(exclude_none=True)
    tables["grid"].pop("time_step", None)
    tables["drive"]["burst"] = {"duration": made.window.end, "ramp": 1e-3}
    tables["actuators"][1]["frequency"] = 170.0
    tables["edges"] = {side: edge for (side, _), edge in zip(sides_of(made), FOUR_EDGES, strict=True)}
    tables["effects"] = {
        **LINEAR,
        "orthotropic": {"Dx": 0.02, "Dy": 0.008, "D1": 0.003, "Dxy": 0.004},
        "stretching": {},
        "moving_load": {"force": 0.3, "start": (x0, y0), "velocity": (20.0, 10.0), "size": 0.01},
    }
    return made.with_tables(**tables)


def bending_load(made):
    """Return a pressure [N/m²] that deflects the plate by about its thickness, so that stretching counts."""
    double = made.model_copy(update={"grid": made.grid.model_copy(update={"precision": "float64"})})
    linear = double.model_copy(update={"effects": double.effects.model_copy(update={"stretching": None})})
    drive = np.ones((1, len(made.actuators)), dtype=complex)
    return made.plate.thickness / np.abs(run_moment_form(linear, drive).displacement).max()


def run_on_a_block(monkeypatch, planes=()):
    """Let CPUs run the CUDA kernel of the moment form, in blocks of one thread with some planes in registers."""

    def path(specialized):
        effects, (nx, ny) = specialized.effects, specialized.scheme.nodes
        kept = plans.workspace_planes(effects, planes)
        nodes = nx * ny + 1  # one beyond the plate
        return moment_form.block_path(specialized, plans.BlockPlan(1, nodes, planes, kept, False, 64))

    monkeypatch.setitem(compiled_scene.MOMENT_FORM, "resident", path)


def random_edge(random):
    """Draw one of the four kinds; springs from soft to nearly rigid, either of which may be absent."""
    springs = {"translation": 10 ** random.uniform(2, 6), "rotation": 10 ** random.uniform(-3, 2)}
    if random.random() < 0.3:
        springs.pop(("translation", "rotation")[random.integers(2)])
    return ("clamped", "supported", "free", springs)[random.integers(4)]


def random_area(random, size, least=0.2):
    """Draw a rectangle on the plate, of half its sides at most."""
    x0, y0 = random.uniform(0, 0.5, 2) * size
    x1, y1 = (x0, y0) + random.uniform(least, 0.5, 2) * size
    return (x0, x1, y0, y1)


def random_effects(random, size, stretching, chance=0.5):
    """Draw each effect with a chance, of the size that it has on panels like the paper's; never none at all."""
    draw = random.uniform
    effects = {
        "damping": {"viscous": draw(0, 100), "scheme": ("centred", "backward")[random.integers(2)]},
        "material_damping": {"time": 10 ** draw(-7, -5)},
        "tension": {"x": draw(0, 20), "y": draw(0, 20)},
        "foundation": {"stiffness": 10 ** draw(3, 6), "damping": draw(0, 50)},
        "orthotropic": {"Dx": 0.02, "Dy": 0.008, "D1": draw(-0.002, 0.006), "Dxy": 0.004},
        "variation": {
            name: draw(0.5, 1.5, shape).tolist()
            for name, shape in (("thickness", (3, 2)), ("young_modulus", (1, 4)), ("density", (2, 1)))
        },
        "layers": [
            dict(zip(("thickness", "young_modulus", "density"), draw((1e-4, 0, 0), (5e-4, 9e9, 3000)), strict=True))
            | {"area": random_area(random, size), "both": bool(random.integers(2))}
            for _ in range(random.integers(1, 4))
        ],
        "oscillators": [
            {"area": random_area(random, size), "mass": mass, "stiffness": draw(50, 500), "damping": damping}
            for mass, damping in random.choice([0, 1], (random.integers(1, 4), 2)) * (0.003, 0.1)
        ],
        "moving_load": {
            "force": 10 ** draw(-4, -1),
            "start": tuple(draw(0, 1, 2) * size),
            "velocity": tuple(random.normal(size=2) * size * 100),
            "size": random.choice([0.0, 0.02, 0.05]),
        },
    }
    kept = {name: table for name, table in effects.items() if random.random() < chance}
    kept.setdefault("foundation", {"stiffness": 1e3})
    return {**kept, "stretching": {}} if stretching else kept
