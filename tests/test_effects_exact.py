"""Each effect alone against an exact or an independent result, through ``PlateSolver`` wherever a run can show it.

A supported plate loaded in the shape sin(mπx/a) sin(nπy/b) of one mode moves in that mode alone, on the grid too:
its amplitude q is an oscillator's, with everything that is uniform over the plate in

    ρH q̈ + (c + τ B) q̇ + (B + T_x k_x² + T_y k_y² + k) q = Re(Z exp(iωt)),
    B = D_x k_x⁴ + 2(D_1 + 2D_xy) k_x² k_y² + D_y k_y⁴

k_x = mπ/a for the plate, k_x = 2/h_x · sin(mπh_x/2a) on the grid. With the grid's, what is left of the difference to the
exact motion is the error in time, (ωΔt)² in ω, or Δt τB/2ρH with the material's rate at the last half-step.
"""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg
import scipy.special

from warp_plate import PlateSolver
from warp_plate.plate.bending import make_bending, stiffness_matrix, system
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import overlap
from warp_plate.reference.series import damped_motion, grid_wavenumber_squared, mode_shape

SUPPORTED = ("supported",) * 4
NODES, SIZE = (13, 11), (0.2, 0.18)
AREA = SIZE[0] * SIZE[1]
YOUNG, RATIO, THICKNESS, DENSITY = 1e9, 0.33, 5e-4, 0.5  # the tests' plate; density: per area
RIGIDITY = YOUNG * THICKNESS**3 / 12 / (1 - RATIO**2)
ORTHOTROPIC = {"Dx": 0.02, "Dy": 0.008, "D1": 0.003, "Dxy": 0.004}
# A frequency so low that the load stays what it is at t = 0 to 1e-12.
CONSTANT = 1e-5
# What is uniform over the plate.
UNIFORM = {
    "tension": {"tension": {"x": 15.0, "y": 6.0}},
    "compression": {"tension": {"x": -1.5, "y": 3.0}},
    "foundation": {"foundation": {"stiffness": 2e5, "damping": 30.0}},
    "material damping": {"material_damping": {"time": 5e-6}},
    "orthotropic": {"orthotropic": ORTHOTROPIC},
    "negative D1": {"orthotropic": {"Dx": 0.02, "Dy": 0.018, "D1": -0.017, "Dxy": 0.002}},
    "all": {
        "damping": {"viscous": 20.0},
        "tension": {"x": 15.0, "y": 6.0},
        "foundation": {"stiffness": 2e5, "damping": 30.0},
        "material_damping": {"time": 5e-6},
        "orthotropic": ORTHOTROPIC,
    },
}


def oscillator_of(effects, mode, squares):
    """Stiffness [N/m³] and damping [N·s/m³] of a mode; squares: k_x², k_y² [1/m²]."""
    own = effects.get("orthotropic", {"Dx": RIGIDITY, "Dy": RIGIDITY, "D1": RIGIDITY, "Dxy": 0.0})
    (x, y), tension = squares, effects.get("tension", {"x": 0.0, "y": 0.0})
    bed = effects.get("foundation", {"stiffness": 0.0, "damping": 0.0})
    bent = own["Dx"] * x**2 + 2 * (own["D1"] + 2 * own["Dxy"]) * x * y + own["Dy"] * y**2
    loss = effects.get("damping", {"viscous": 0.0})["viscous"] + bed["damping"]
    loss += effects.get("material_damping", {"time": 0.0})["time"] * bent
    return bent + tension["x"] * x + tension["y"] * y + bed["stiffness"], loss


def squares_of(mode, size, nodes=None):
    """k_x², k_y² of a mode, of the plate or of its grid."""
    if nodes is None:
        return [(order * math.pi / length) ** 2 for order, length in zip(mode, size, strict=True)]
    spacing = [length / (count - 1) for length, count in zip(size, nodes, strict=True)]
    along_x = grid_wavenumber_squared((mode[0], 0), size, spacing)
    return along_x, grid_wavenumber_squared(mode, size, spacing) - along_x


@pytest.fixture
def mode_run(point_scene):
    """Runs a supported plate under Re(Z exp(iωt)) in the shape of a mode: (times, amplitudes) of all steps."""

    def run(effects, mode, pressure, frequency, end, part=0.5, nodes=NODES):
        trial = point_scene(nodes, SIZE, SUPPORTED, effects=effects, frequency=CONSTANT, time_step=None)
        step = end / math.ceil(end / (part * make_scheme(trial).limit))
        made = point_scene(
            nodes, SIZE, SUPPORTED, effects=effects, frequency=frequency, time_step=step, window=(0.0, end)
        )
        (nx, ny), steps = nodes, make_scheme(made).steps
        x, y = np.linspace(0, SIZE[0], nx), np.linspace(0, SIZE[1], ny)
        shape = mode_shape(mode, SIZE, x, y)
        times = step * np.arange(steps + 1)
        moved = PlateSolver(made, "cpu").run(pressure * shape[1:-1, 1:-1].reshape(1, -1), times).displacement[0]
        amplitude = np.einsum("tyx,yx->t", moved, shape) / (shape**2).sum()
        # Nothing but the mode moves.
        np.testing.assert_allclose(moved, amplitude[:, None, None] * shape, atol=1e-9 * np.abs(moved).max())
        return times, amplitude

    return run


@pytest.mark.parametrize("mode", [(1, 1), (3, 2)])
@pytest.mark.parametrize("name", UNIFORM)
def test_uniform_effects_by_the_motion_of_a_mode(mode_run, name, mode):
    """With the grid's wavenumbers, halving the step takes the error from the exact motion down by four, or by two
    where the material's rate is taken late."""
    effects, pressure = UNIFORM[name], 0.7 - 0.4j
    stiffness, loss = oscillator_of(effects, mode, squares_of(mode, SIZE, NODES))
    own = math.sqrt(stiffness / DENSITY) / (2 * math.pi)
    errors = []
    for part in (0.4, 0.2):
        times, found = mode_run(effects, mode, pressure, 0.6 * own, 6 / own, part)
        exact = damped_motion(times, stiffness, DENSITY, loss, pressure, 0.6 * own)
        errors.append(np.abs(found - exact).max() / np.abs(exact).max())
    late = "material_damping" in effects
    print(errors)
    assert errors[0] < (0.05 if late else 0.03)
    assert errors[1] < errors[0] * (0.55 if late else 0.27)


@pytest.mark.parametrize("name", UNIFORM)
def test_natural_frequency_and_decay_of_a_mode(mode_run, name):
    """Recovered from a run: two steps of the grid's oscillator make q⁺ − (1 + d − gλΔt²) q + d q⁻ = gΔt² Z_n/ρH, and the
    two unknowns found from its history are those of the formula to rounding."""
    effects, mode = UNIFORM[name], (2, 1)
    stiffness, loss = oscillator_of(effects, mode, squares_of(mode, SIZE, NODES))
    late = effects.get("material_damping", {"time": 0.0})["time"] * oscillator_of(
        {key: effects[key] for key in effects if key == "orthotropic"}, mode, squares_of(mode, SIZE, NODES)
    )[0]
    own = math.sqrt(stiffness / DENSITY) / (2 * math.pi)
    times, q = mode_run(effects, mode, 1.0, 0.6 * own, 5 / own)
    step = times[1]
    gain = 1 / (1 + (loss - late) * step / (2 * DENSITY))
    force = gain * step**2 / DENSITY * np.cos(2 * math.pi * 0.6 * own * times[1:-1])
    unknowns = np.stack([q[1:-1], -q[:-2]], axis=1)
    turn, decay = np.linalg.lstsq(unknowns, q[2:] - force, rcond=None)[0]
    assert decay == pytest.approx(gain * (1 - (loss + late) * step / (2 * DENSITY)), rel=1e-9)
    assert (1 + decay - turn) / (gain * step**2) == pytest.approx(stiffness / DENSITY, rel=1e-7)
    # Against the plate itself: its frequency to second order in the spacing.
    plate = math.sqrt(oscillator_of(effects, mode, squares_of(mode, SIZE))[0] / DENSITY) / (2 * math.pi)
    assert own == pytest.approx(plate, rel=0.03)


def test_orthotropic_with_the_isotropic_rigidities_is_the_isotropic_plate(scene):
    """Dx = Dy = D, D1 = νD, Dxy = (1 − ν)D/2, with edges of every kind."""
    edges = ("clamped", "free", "supported", {"translation": 1e4, "rotation": 0.05})
    alike = {"Dx": RIGIDITY, "Dy": RIGIDITY, "D1": RATIO * RIGIDITY, "Dxy": (1 - RATIO) / 2 * RIGIDITY}
    drives = np.array([[1, 0.3j, -0.5]])
    one, other = (
        PlateSolver(scene(NODES, SIZE, edges, effects=effects), "cpu").run(drives, (0.01,))
        for effects in ({}, {"orthotropic": alike})
    )
    np.testing.assert_allclose(one.displacement, other.displacement, atol=1e-11 * np.abs(one.displacement).max())


def test_moments_are_the_biharmonic_of_the_plain_plate(scene, edges, phasors):
    """A bed so soft that it does nothing sends a plain plate the general way; on all 16 edges both ways agree."""
    drives = phasors(1, 3)
    plain, general = (
        PlateSolver(scene(NODES, SIZE, edges, 40.0, time_step=2e-4, effects=effects), "cpu").run(drives, (0.01,))
        for effects in (
            {"damping": {"viscous": 40.0}},
            {"damping": {"viscous": 40.0}, "foundation": {"stiffness": 1e-9}},
        )
    )
    scale = np.abs(plain.displacement).max()
    np.testing.assert_allclose(general.displacement, plain.displacement, atol=1e-10 * scale)
    np.testing.assert_allclose(general.energy, plain.energy, rtol=1e-9)


LAYER = {"thickness": 3e-4, "young_modulus": 4e9, "density": 1800.0}


@pytest.mark.parametrize("both", [False, True], ids=["one face", "both faces"])
def test_layer_over_the_whole_plate_is_the_laminate(scene, both):
    """As a plate of that mass and rigidity. One face: the parts' own rigidities and, as springs in series, their
    stretching at the distance of their middles: D = D₁ + D₂ + d²/(1/A₁ + 1/A₂). Both: twice A₂d² instead."""
    plane, thin = 1 - RATIO**2, LAYER["thickness"]
    stretch, stretch_layer = YOUNG * THICKNESS / plane, LAYER["young_modulus"] * thin / plane
    middle, own = (THICKNESS + thin) / 2, LAYER["young_modulus"] * thin**3 / 12 / plane
    faces = 2 if both else 1
    lever = 2 * stretch_layer if both else stretch * stretch_layer / (stretch + stretch_layer)
    rigidity = RIGIDITY + faces * own + lever * middle**2
    mass = DENSITY + faces * LAYER["density"] * thin
    layered = scene(
        NODES, SIZE, SUPPORTED, 40.0, effects={"layers": [{"area": (0, SIZE[0], 0, SIZE[1]), "both": both, **LAYER}]}
    )
    same = scene(
        NODES, SIZE, SUPPORTED, time_step=make_scheme(layered).time_step, plate={
            "size": SIZE, "thickness": THICKNESS, "poisson_ratio": RATIO,
            "young_modulus": rigidity * 12 * plane / THICKNESS**3, "density": mass / THICKNESS,
        },
    )  # fmt: skip
    drives = np.array([[1, 0.3j, -0.5]])
    one, other = (PlateSolver(made, "cpu").run(drives, (0.004, 0.01)) for made in (layered, same))
    scale = np.abs(other.displacement).max()
    np.testing.assert_allclose(one.displacement, other.displacement, atol=1e-10 * scale)
    np.testing.assert_allclose(one.energy, other.energy, rtol=1e-9)


def slowest(scene):
    """Lowest natural frequency ω [rad/s] of the plate on its grid, which the paths step (see test_general_paths)."""
    stiffness, masses = system(scene, make_bending(scene))
    root = scipy.sparse.diags_array(1 / np.sqrt(masses))
    matrix = root @ stiffness @ root
    value = scipy.sparse.linalg.eigsh(matrix, k=1, sigma=-1.0, which="LM", return_eigenvectors=False)
    return math.sqrt(value[0])


def exact_strip(determinant, near):
    """The root ω of a determinant nearest below or above ``near``, by its first change of sign outwards."""
    for part in np.linspace(0.0, 0.3, 301):
        low, high = near * (1 - part), near * (1 + part)
        if determinant(low) * determinant(high) < 0:
            return scipy.optimize.brentq(determinant, low, high, xtol=1e-12 * near)
    raise AssertionError("no frequency near the grid's")


# What holds the sides x = 0 and a of a plate whose other sides are supported: translation, rotation, effects.
LEVY = {
    "free": (0.0, 0.0, {}),
    "soft": (2e3, 0.05, {}),
    "stiff": (5e4, 0.5, {}),
    "rotation alone": (0.0, 0.2, {}),
    "translation alone": (2e4, 0.0, {}),
    "orthotropic": (0.0, 0.0, {"orthotropic": ORTHOTROPIC}),
    "orthotropic on springs": (1e4, 0.1, {"orthotropic": ORTHOTROPIC, "foundation": {"stiffness": 5e4}}),
    "pulled": (0.0, 0.0, {"tension": {"x": 8.0, "y": 5.0}}),
    "pulled on springs": (5e3, 0.1, {"tension": {"x": 8.0, "y": 5.0}}),
}


@pytest.mark.parametrize("name", LEVY)
def test_edges_on_springs_and_free_ones_by_levys_solution(scene, name):
    """u = X(x) sin(ky), k = π/b: D_x X⁗ − (2(D_1 + 2D_xy)k² + T_x) X″ + (D_y k⁴ + T_y k² + k_f − ρHω²) X = 0, even about
    the middle, and at x = a/2 the moment against the rotation and the shear against the translation:
    D_x X″ − D_1k² X = −r X′, D_x X‴ − ((D_1 + 4D_xy)k² + T_x) X′ = t X. Second order: halving the spacing takes the
    error down by some four."""
    translation, rotation, effects = LEVY[name]
    isotropic = {"Dx": RIGIDITY, "Dy": RIGIDITY, "D1": RATIO * RIGIDITY, "Dxy": (1 - RATIO) / 2 * RIGIDITY}
    own = effects.get("orthotropic", isotropic)
    pull, bed = effects.get("tension", {"x": 0.0, "y": 0.0}), effects.get("foundation", {"stiffness": 0.0})
    k, half = math.pi / SIZE[1], SIZE[0] / 2
    middle = 2 * (own["D1"] + 2 * own["Dxy"]) * k**2 + pull["x"]

    def determinant(omega):
        rest = own["Dy"] * k**4 + pull["y"] * k**2 + bed["stiffness"] - DENSITY * omega**2
        root = np.sqrt(complex(middle**2 - 4 * own["Dx"] * rest))
        columns = []
        for square in (middle + root, middle - root):
            s = np.sqrt(square / (2 * own["Dx"]))
            even, odd = np.cosh(s * half), np.sinh(s * half)
            columns.append(
                [
                    (own["Dx"] * s**2 - own["D1"] * k**2) * even + rotation * s * odd,
                    (own["Dx"] * s**3 - ((own["D1"] + 4 * own["Dxy"]) * k**2 + pull["x"]) * s) * odd
                    - translation * even,
                ]
            )
        return (np.linalg.det(np.array(columns)) / root).real

    side = {"translation": translation, "rotation": rotation} if translation or rotation else "free"
    edges = (side, "supported", side, "supported")
    # One node more along x, so that no cell is square.
    errors = []
    for count in (17, 33):
        found = slowest(scene((count + 1, count), SIZE, edges, effects={"foundation": {"stiffness": 0.0}, **effects}))
        errors.append(found / exact_strip(determinant, found) - 1)
    print(errors)
    assert abs(errors[0]) < 0.01
    assert abs(errors[1]) < max(0.3 * abs(errors[0]), 1e-5)


# Halved spacings; the middle of the plate lies between two nodes, or on one.
BETWEEN_NODES = ((18, 15), (34, 29))
ON_A_NODE = ((65, 57), (129, 113))


def test_layer_on_half_the_plate_by_levys_solution(scene):
    """A strip 0 ... a/2 of a supported plate thickened on both faces: X on both sides of the step has exponents of its
    own, and at the step X, X′, the moment and the shear agree. Second order where the step lies between two nodes;
    first where it lies on one, whose cell then has the mean of both moduli."""
    plane, thin = 1 - RATIO**2, LAYER["thickness"]
    lever = (THICKNESS + thin) / 2
    thick = RIGIDITY + 2 * LAYER["young_modulus"] / plane * (thin**3 / 12 + thin * lever**2)
    sides = ((thick, DENSITY + 2 * LAYER["density"] * thin), (RIGIDITY, DENSITY))
    k, half = math.pi / SIZE[1], SIZE[0] / 2

    def determinant(omega):
        """Rows X, X′, M, V at the step; columns sinh and sin from each supported side, x counted from there."""
        columns = []
        for sign, (rigidity, mass) in zip((1, -1), sides, strict=True):
            turn = math.sqrt(mass / rigidity) * omega
            for square in (k**2 + turn, k**2 - turn):
                s = np.sqrt(complex(square))
                odd, even = np.sinh(s * half) / s, np.cosh(s * half)
                columns.append(
                    [
                        sign * odd,
                        even,
                        sign * rigidity * (square - RATIO * k**2) * odd,
                        rigidity * (square - (2 - RATIO) * k**2) * even,
                    ]
                )
        scaled = np.array(columns).T
        return np.linalg.det(scaled / np.abs(scaled).max(axis=1, keepdims=True)).real

    def error(nodes):
        layer = {"area": (0.0, half, 0.0, SIZE[1]), "both": True, **LAYER}
        found = slowest(scene(nodes, SIZE, SUPPORTED, effects={"layers": [layer]}))
        return found / exact_strip(determinant, found) - 1

    between, on = ([error(nodes) for nodes in grids] for grids in (BETWEEN_NODES, ON_A_NODE))
    print(between, on)
    assert abs(between[0]) < 0.01
    assert abs(between[1]) < 0.3 * abs(between[0])
    assert abs(on[0]) < 0.01
    assert abs(on[1]) < 0.6 * abs(on[0])


@pytest.fixture
def whole_scene(scene):
    """A scene with one actuator over the whole plate, undamped and long enough for ``end``."""

    def make(edges, effects, end, frequency, part=0.5, nodes=NODES, start=0.0, **changes):
        area = [(0.0, SIZE[0], 0.0, SIZE[1])]
        asked = {"effects": effects, "actuators": area, **changes}
        limit = make_scheme(scene(nodes, SIZE, edges, frequency=CONSTANT, **asked)).limit
        step = end / math.ceil(end / (part * limit))
        return scene(nodes, SIZE, edges, window=(start, end), frequency=frequency, time_step=step, **asked)

    return make


def drawn(made, pressure, points=((0.07, 0.05),)):
    """(times, traces (steps + 1, points)) of a run, the start at rest included."""
    run = PlateSolver(made, "cpu").run([[pressure]], (), points)
    return np.append(0, run.trace_times), np.append(np.zeros((1, len(points))), run.trace[0].T, axis=0)


FREE = ("free",) * 4


def test_rigid_motions_of_a_free_plate_bend_nothing(scene):
    """1, x and y, also with layers, orthotropic rigidities and edges on springs of zero."""
    x, y = np.meshgrid(np.linspace(0, SIZE[0], NODES[0]), np.linspace(0, SIZE[1], NODES[1]))
    layer = {"area": (0.03, 0.09, 0.05, 0.18), **LAYER}
    for edges in (FREE, ({"translation": 0.0, "rotation": 0.0},) * 4):
        bending = make_bending(scene(NODES, SIZE, edges, effects={"orthotropic": ORTHOTROPIC, "layers": [layer]}))
        matrix = stiffness_matrix(bending)
        for motion in (np.ones_like(x), x, y):
            assert np.abs(matrix @ motion.ravel()).max() < 1e-12 * abs(matrix).max() * np.abs(motion).max()
        twisted = (x * y).ravel()
        # xy has no curvature but a twist of one: ½ · 4D_xy times the area, with the layer's share (1 − ν)/2 of D.
        energy = 0.5 * twisted @ (matrix @ twisted)
        assert energy == pytest.approx(0.5 * bending.twist.sum() * np.prod(bending.spacing), rel=1e-9)


@pytest.mark.parametrize("damping", [0.0, 2.0])
@pytest.mark.parametrize("mass", [0.006, 0.0])
def test_oscillator_under_a_rigid_plate(whole_scene, damping, mass):
    """A free plate on a bed, loaded evenly, with an oscillator that holds all of it, moves as one mass: two degrees of
    freedom (one where the spring stands on the ground), by the matrix exponential; the plate stays flat."""
    plate, stiffness, bed = DENSITY * AREA, 900.0, 5e4
    force, omega = 3.0 * AREA, 2 * math.pi * 55.0
    oscillator = {"area": (0, SIZE[0], 0, SIZE[1]), "mass": mass, "stiffness": stiffness, "damping": damping}
    effects = {"foundation": {"stiffness": bed}, "oscillators": [oscillator]}
    hung = 1 / mass if mass else 0.0
    # u, u̇, z, ż, cos ωt, sin ωt
    motion = np.zeros((6, 6))
    motion[0, 1] = motion[2, 3] = 1
    motion[1] = np.array([-(bed * AREA + stiffness), -damping, stiffness, damping, force, 0]) / plate
    motion[3] = np.array([stiffness, damping, -stiffness, -damping, 0, 0]) * hung
    if not mass:
        motion[:, 2:4] = 0
    motion[4, 5], motion[5, 4] = -omega, omega
    errors = []
    for part in (0.3, 0.15):
        made = whole_scene(FREE, effects, 0.05, 55.0, part)
        times, traces = drawn(made, 3.0, ((0.07, 0.05), (0.2, 0.18), (0.0, 0.09)))
        np.testing.assert_allclose(traces, traces[:, :1] * np.ones(3), atol=1e-9 * np.abs(traces).max())
        turn, state = scipy.linalg.expm(motion * times[1]), np.array([0, 0, 0, 0, 1.0, 0])
        exact = [0.0]
        for _ in times[1:]:
            state = turn @ state
            exact.append(state[0])
        errors.append(np.abs(traces[:, 0] - exact).max() / np.abs(exact).max())
    print(errors)
    assert errors[0] < (0.03 if damping else 0.003)
    assert errors[1] < errors[0] * (0.55 if damping else 0.27)


def test_oscillator_holds_its_patch_at_its_own_frequency(scene):
    """The anti-resonance of a tuned absorber: undamped and driven at ω with 2(1 − cos ωΔt)/Δt² = k/m, its patch comes to
    rest on average while the plate around it moves on."""
    area, stiffness, mass, end = (0.06, 0.11, 0.05, 0.12), 400.0, 0.002, 1.2
    free = {"damping": {"viscous": 60.0}}
    with_it = {**free, "oscillators": [{"area": area, "mass": mass, "stiffness": stiffness}]}
    drive = {"actuators": [(0.1, 0.19, 0.02, 0.09)], "load": "overlap"}
    step = end / math.ceil(end / (0.6 * make_scheme(scene(NODES, SIZE, SUPPORTED, effects=with_it, **drive)).limit))
    tuned = math.acos(1 - stiffness / mass * step**2 / 2) / step / (2 * math.pi)
    x, y = np.linspace(0, SIZE[0], NODES[0]), np.linspace(0, SIZE[1], NODES[1])
    patch = np.outer(overlap(y, *area[2:]), overlap(x, *area[:2]))
    last = end - step * np.arange(math.ceil(1 / (tuned * step)))
    means = []
    for effects in (with_it, free):
        made = scene(
            NODES, SIZE, SUPPORTED, effects=effects, frequency=tuned, time_step=step, window=(0.9 * end, end), **drive
        )
        moved = PlateSolver(made, "cpu").run([[1.0]], last).displacement[0]
        means.append(np.abs(np.einsum("tyx,yx->t", moved, patch) / patch.sum()).max() / np.abs(moved).max())
    print(means)
    assert means[0] < 1e-6
    assert means[1] > 0.05


def test_spring_on_the_ground_by_superposition(scene):
    """At rest under a load, the mean deflection of the spring's patch is w/(1 + k δ), with w that without the spring and
    δ that under a force of one spread over the patch: three damped runs to rest. The spring alone is also that of a
    sine series (Navier)."""
    area, stiffness, end = (0.06, 0.11, 0.05, 0.12), 300.0, 0.4
    spring = {"area": area, "stiffness": stiffness}
    mean_of = []
    x, y = np.linspace(0, SIZE[0], NODES[0]), np.linspace(0, SIZE[1], NODES[1])
    patch = np.outer(overlap(y, *area[2:]), overlap(x, *area[:2]))
    for oscillators, drive in (((spring,), (2.0, 0)), ((), (2.0, 0)), ((), (0, 1.0))):
        made = scene(
            NODES, SIZE, SUPPORTED, window=(0, end), frequency=CONSTANT, actuators=[(0.1, 0.19, 0.02, 0.09), area],
            effects={"damping": {"viscous": 84.0}, "foundation": {"stiffness": 0.0}, "oscillators": oscillators},
        )  # fmt: skip
        rest = PlateSolver(made, "cpu").run([drive], (end,)).displacement[0, 0]
        mean_of.append((rest * patch).sum() / patch.sum())
    held, loose, under_pressure = mean_of
    width, height = area[1] - area[0], area[3] - area[2]
    compliance = under_pressure / (width * height)
    assert stiffness * compliance > 0.3
    assert held == pytest.approx(loose / (1 + stiffness * compliance), rel=1e-8)
    series = 0.0
    for m, n in np.ndindex(60, 60):
        kx, ky = (m + 1) * math.pi / SIZE[0], (n + 1) * math.pi / SIZE[1]
        along = (math.cos(kx * area[0]) - math.cos(kx * area[1])) / kx / width
        across = (math.cos(ky * area[2]) - math.cos(ky * area[3])) / ky / height
        series += 4 / AREA * (along * across) ** 2 / (RIGIDITY * (kx**2 + ky**2) ** 2)
    assert compliance == pytest.approx(series, rel=0.02)


STRETCH = {"stretching": {}}


def duffing(mode, nodes, effects=STRETCH):
    """ρHω₀² [N/m³] and what Berger's tension adds to it for q², in [N/m⁵], for a mode on the grid.

    For q sin sin the integral of |∇u|² is k² q² ab/4, so N k² q = 6D/(H²ab) · k⁴ q³ ab/4.
    """
    along_x, along_y = squares_of(mode, SIZE, nodes)
    stiffness, _ = oscillator_of(effects, mode, (along_x, along_y))
    return stiffness, 1.5 * RIGIDITY * (along_x + along_y) ** 2 / THICKNESS**2


@pytest.mark.parametrize("throw", [0.5, 1.0, 2.0])
def test_frequency_of_a_large_free_vibration(mode_run, point_scene, throw):
    """Berger's plate in one mode is Duffing's oscillator, q̈ + ω₀²q + αq³ = 0, whose frequency at amplitude A is exactly
    π √(ω₀² + αA²) / 2K(m), m = αA²/2(ω₀² + αA²).

    The load can't be taken away, but sin ωt with four steps a period gives a blow at the start and from then on shakes
    the plate between the even steps only, by Δt·ω₀ of the amplitude; the even steps see a free vibration."""
    mode = (1, 1)
    stiffness, cubic = duffing(mode, NODES)
    natural, alpha = stiffness / DENSITY, cubic / DENSITY
    amplitude = throw * THICKNESS
    strong = natural + alpha * amplitude**2
    ratio = alpha * amplitude**2 / (2 * strong)
    exact = math.pi * math.sqrt(strong) / (2 * scipy.special.ellipk(ratio))
    speed = math.sqrt(natural * amplitude**2 + alpha * amplitude**4 / 2)
    end, errors = 5.2 * 2 * math.pi / exact, []
    for part in (0.4, 0.2):
        step = part * make_scheme(point_scene(NODES, SIZE, SUPPORTED, effects=STRETCH, frequency=CONSTANT, time_step=None)).limit
        step = end / math.ceil(end / step)
        # The blow: the plate's mean velocity after it is half a step of the load.
        pressure = -1j * 2 * DENSITY * speed / step
        times, q = mode_run(STRETCH, mode, pressure, 0.25 / step, end, part)
        times, q = times[::2], q[::2]
        up = np.flatnonzero((q[:-1] < 0) & (q[1:] >= 0))
        crossings = times[up] - q[up] * (times[up + 1] - times[up]) / (q[up + 1] - q[up])
        found = 2 * math.pi * (len(crossings) - 1) / (crossings[-1] - crossings[0])
        assert np.abs(q).max() == pytest.approx(amplitude, rel=0.01)
        errors.append(found / exact - 1)
    print(errors, exact / math.sqrt(natural))
    assert exact > 1.05 * math.sqrt(natural)
    assert abs(errors[0]) < 2e-3
    assert abs(errors[1]) < max(0.3 * abs(errors[0]), 2e-5)


@pytest.mark.parametrize("effects", ["stretching", "stretching and everything uniform"])
def test_large_forced_vibration_of_a_mode(mode_run, effects):
    """Duffing's equation with damping and load, by a Runge-Kutta solver of eighth order."""
    effects = {**(UNIFORM["all"] if effects != "stretching" else {"damping": {"viscous": 5.0}}), **STRETCH}
    mode = (2, 1)
    stiffness, cubic = duffing(mode, NODES, effects)
    _, loss = oscillator_of(effects, mode, squares_of(mode, SIZE, NODES))
    omega = 0.9 * math.sqrt(stiffness / DENSITY)
    pressure = 0.35 * stiffness * THICKNESS * np.exp(0.4j)

    def rates(t, state):
        load = (pressure * np.exp(1j * omega * t)).real
        return [state[1], (load - loss * state[1] - stiffness * state[0] - cubic * state[0] ** 3) / DENSITY]

    errors = []
    for part in (0.4, 0.2):
        times, q = mode_run(effects, mode, pressure, omega / (2 * math.pi), 40 / omega, part)
        exact = scipy.integrate.solve_ivp(
            rates, (0, times[-1]), (0, 0), "DOP853", times, rtol=1e-10, atol=1e-16
        ).y[0]
        errors.append(np.abs(q - exact).max() / np.abs(exact).max())
    print(errors, np.abs(exact).max() / THICKNESS)
    assert np.abs(exact).max() > 0.8 * THICKNESS
    assert errors[0] < 0.02
    assert errors[1] < 0.55 * errors[0]


def test_large_static_deflection_of_a_mode(mode_run):
    """Run to rest: the root of Dk⁴ q (1 + 3q²/2H²) = Z, to the rounding of the run."""
    stiffness, cubic = duffing((1, 1), NODES)
    viscous = {"damping": {"viscous": 3 * math.sqrt(stiffness * DENSITY)}}
    pressure = 4 * stiffness * THICKNESS
    _, q = mode_run({**viscous, **STRETCH}, (1, 1), pressure, CONSTANT, 0.6)
    assert stiffness * q[-1] + cubic * q[-1] ** 3 == pytest.approx(pressure, rel=1e-8)
    assert q[-1] > 1.2 * THICKNESS


def test_large_static_deflection_under_an_even_load(scene):
    """All modes: a linear plate under the tension N that its own slopes cause, by sine series; N by bisection. Second
    order in the spacing."""
    pressure, orders = 20 * RIGIDITY * THICKNESS / (SIZE[0] / 4) ** 4, np.arange(1, 80, 2)
    along, across = (orders * math.pi / SIZE[0]) ** 2, (orders * math.pi / SIZE[1]) ** 2
    squared = along + across[:, None]
    loads = 16 * pressure / math.pi**2 / np.outer(orders, orders)

    def deflection(tension):
        return loads / (RIGIDITY * squared**2 + tension * squared)

    def excess(tension):
        return 6 * RIGIDITY / THICKNESS**2 / 4 * (squared * deflection(tension) ** 2).sum() - tension

    tension = scipy.optimize.brentq(excess, 0, excess(0.0), xtol=1e-12)
    signs = np.sin(orders * math.pi / 2)
    exact = signs @ deflection(tension) @ signs
    errors = []
    for nodes in ((13, 11), (25, 21)):
        made = scene(
            nodes, SIZE, SUPPORTED, window=(0, 0.5), frequency=CONSTANT, actuators=[(0, SIZE[0], 0, SIZE[1])],
            effects={"damping": {"viscous": 150.0}, **STRETCH},
        )  # fmt: skip
        rest = PlateSolver(made, "cpu").run([[pressure]], (0.5,)).displacement[0, 0]
        errors.append(rest[nodes[1] // 2, nodes[0] // 2] / exact - 1)
    print(errors, exact / THICKNESS, tension)
    assert exact > 1.2 * THICKNESS
    assert abs(errors[0]) < 0.002
    assert abs(errors[1]) < 0.4 * abs(errors[0])
