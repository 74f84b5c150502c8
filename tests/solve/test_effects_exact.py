"""Effects against exact solutions: of one mode, of a rigid plate, Lévy's for edges, and of the laminate for layers.

A supported plate loaded in the shape sin(mπx/a) sin(nπy/b) of one mode moves in that mode alone, on the grid too. With
all effects that are uniform over the plate, its amplitude q obeys

    ρH q̈ + (c + τ B) q̇ + (B + T_x k_x² + T_y k_y² + k) q = Re(Z exp(iωt)),
    B = D_x k_x⁴ + 2(D_1 + 2D_xy) k_x² k_y² + D_y k_y⁴

with k_x = mπ/a for the plate and k_x = 2/h_x · sin(mπh_x/2a) on the grid. With the latter, the only difference from the
exact motion is the error in time: (ωΔt)² in ω, or Δt τB/2ρH with the material's rate at the last half-step.
"""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg

from support.scenes import point_scene
from support.series import grid_wavenumber_squared, mode_shape
from warp_plate import PlateSolver
from warp_plate.plate.bending import make_bending, system
from warp_plate.plate.scheme import make_scheme

SUPPORTED = ("supported",) * 4
NODES, SIZE, MODE = (13, 11), (0.2, 0.18), (2, 1)
YOUNG, RATIO, THICKNESS, DENSITY = 1e9, 0.33, 5e-4, 0.5  # of the plate of scenes.py; density per area
RIGIDITY = YOUNG * THICKNESS**3 / 12 / (1 - RATIO**2)
ORTHOTROPIC = {"Dx": 0.02, "Dy": 0.008, "D1": 0.003, "Dxy": 0.004}
# So low a frequency that the load is constant to 1e-12.
CONSTANT = 1e-5
UNIFORM = {
    "damping": {"viscous": 20.0},
    "tension": {"x": 15.0, "y": 6.0},
    "foundation": {"stiffness": 2e5, "damping": 30.0},
    "material_damping": {"time": 5e-6},
    "orthotropic": ORTHOTROPIC,
}
# Compression along x, and a cross rigidity that is negative.
NEGATIVE = {
    **UNIFORM,
    "tension": {"x": -1.5, "y": 3.0},
    "orthotropic": {"Dx": 0.02, "Dy": 0.018, "D1": -0.017, "Dxy": 0.002},
}


def oscillator_of(effects, squares):
    """Return stiffness [N/m³] and damping [N·s/m³] of a mode with squares k_x², k_y² [1/m²]."""
    (x, y), plate, tension, bed = squares, effects["orthotropic"], effects["tension"], effects["foundation"]
    bending = plate["Dx"] * x**2 + 2 * (plate["D1"] + 2 * plate["Dxy"]) * x * y + plate["Dy"] * y**2
    loss = effects["damping"]["viscous"] + bed["damping"] + effects["material_damping"]["time"] * bending
    return bending + tension["x"] * x + tension["y"] * y + bed["stiffness"], loss


def squares_of_mode():
    """Return k_x², k_y² [1/m²] of MODE on the grid."""
    spacing = [length / (count - 1) for length, count in zip(SIZE, NODES, strict=True)]
    along_x = grid_wavenumber_squared((MODE[0], 0), SIZE, spacing)
    return along_x, grid_wavenumber_squared(MODE, SIZE, spacing) - along_x


def mode_run(effects, pressure, frequency, end, part=0.5):
    """Return times and amplitudes of a supported plate under Re(Z exp(iωt)) in the shape of MODE."""
    trial = point_scene(NODES, SIZE, SUPPORTED, effects=effects, frequency=CONSTANT, time_step=None)
    step = end / math.ceil(end / (part * make_scheme(trial).limit))
    made = point_scene(NODES, SIZE, SUPPORTED, effects=effects, frequency=frequency, time_step=step, window=(0.0, end))
    shape = mode_shape(MODE, SIZE, *map(np.linspace, (0, 0), SIZE, NODES))
    times = step * np.arange(make_scheme(made).steps + 1)
    moved = PlateSolver(made, "cpu").run(pressure * shape[1:-1, 1:-1].reshape(1, -1), times).displacement[0]
    amplitude = np.einsum("tyx,yx->t", moved, shape) / (shape**2).sum()
    # Only this mode moves.
    np.testing.assert_allclose(moved, amplitude[:, None, None] * shape, atol=1e-9 * np.abs(moved).max())
    return times, amplitude


@pytest.mark.parametrize("effects", [UNIFORM, NEGATIVE])
def test_natural_frequency_and_decay_of_a_mode(effects):
    """The grid's oscillator obeys q⁺ − (1 + d − gλΔt²) q + d q⁻ = gΔt² Z_n/ρH; its two unknowns are fitted to a run."""
    stiffness, loss = oscillator_of(effects, squares_of_mode())
    late = loss - effects["damping"]["viscous"] - effects["foundation"]["damping"]
    natural = math.sqrt(stiffness / DENSITY) / (2 * math.pi)
    times, q = mode_run(effects, 1.0, 0.6 * natural, 5 / natural)
    step = times[1]
    gain = 1 / (1 + (loss - late) * step / (2 * DENSITY))
    force = gain * step**2 / DENSITY * np.cos(2 * math.pi * 0.6 * natural * times[1:-1])
    unknowns = np.stack([q[1:-1], -q[:-2]], axis=1)
    turn, decay = np.linalg.lstsq(unknowns, q[2:] - force, rcond=None)[0]
    assert decay == pytest.approx(gain * (1 - (loss + late) * step / (2 * DENSITY)), rel=1e-9)
    assert (1 + decay - turn) / (gain * step**2) == pytest.approx(stiffness / DENSITY, rel=1e-7)


def test_large_forced_vibration_of_a_mode():
    """Duffing's equation with damping and load, by a Runge–Kutta method of eighth order.

    For q sin sin the integral of u_x² + κu_y² is K q² ab/4, K = k_x² + κk_y², so Berger's tension adds
    6D_x/(H²ab) · K² q³ ab/4, with κ² = D_y/D_x.
    """
    plate = UNIFORM["orthotropic"]
    along_x, along_y = squares_of_mode()
    stiffness, loss = oscillator_of(UNIFORM, (along_x, along_y))
    cubic = 1.5 * plate["Dx"] * (along_x + math.sqrt(plate["Dy"] / plate["Dx"]) * along_y) ** 2 / THICKNESS**2
    omega = 0.9 * math.sqrt(stiffness / DENSITY)
    pressure = 0.35 * stiffness * THICKNESS * np.exp(0.4j)

    def rates(t, state):
        load = (pressure * np.exp(1j * omega * t)).real
        return [state[1], (load - loss * state[1] - stiffness * state[0] - cubic * state[0] ** 3) / DENSITY]

    errors = []
    for part in (0.4, 0.2):
        times, q = mode_run({**UNIFORM, "stretching": {}}, pressure, omega / (2 * math.pi), 40 / omega, part)
        exact = scipy.integrate.solve_ivp(rates, (0, times[-1]), (0, 0), "DOP853", times, rtol=1e-10, atol=1e-16).y[0]
        errors.append(np.abs(q - exact).max() / np.abs(exact).max())
    assert np.abs(exact).max() > 0.8 * THICKNESS
    assert errors[0] < 0.02
    assert errors[1] < 0.55 * errors[0]


@pytest.mark.parametrize(("mass", "damping"), [(0.006, 0.0), (0.006, 2.0), (0.0, 2.0)])
def test_oscillator_under_a_rigid_plate(scene, mass, damping):
    """A free plate on a bed, evenly loaded, with an oscillator over all of it, stays flat: two degrees of freedom (one
    if the spring stands on the ground), solved by the matrix exponential."""
    whole, area, end = (0.0, SIZE[0], 0.0, SIZE[1]), SIZE[0] * SIZE[1], 0.05
    plate, stiffness, bed = DENSITY * area, 900.0, 5e4
    force, omega = 3.0 * area, 2 * math.pi * 55.0
    oscillator = {"area": whole, "mass": mass, "stiffness": stiffness, "damping": damping}
    effects = {"foundation": {"stiffness": bed}, "oscillators": [oscillator]}
    hung = 1 / mass if mass else 0.0
    # u, u̇, z, ż, cos ωt, sin ωt
    motion = np.zeros((6, 6))
    motion[0, 1] = motion[2, 3] = 1
    motion[1] = np.array([-(bed * area + stiffness), -damping, stiffness, damping, force, 0]) / plate
    motion[3] = np.array([stiffness, damping, -stiffness, -damping, 0, 0]) * hung
    if not mass:
        motion[:, 2:4] = 0
    motion[4, 5], motion[5, 4] = -omega, omega
    asked = {"effects": effects, "actuators": [whole], "window": (0.0, end), "frequency": 55.0}
    limit, errors = make_scheme(scene(NODES, SIZE, ("free",) * 4, **asked)).limit, []
    for part in (0.3, 0.15):
        steps = math.ceil(end / (part * limit))
        made = scene(NODES, SIZE, ("free",) * 4, time_step=end / steps, **asked)
        points = ((0.07, 0.05), (0.2, 0.18), (0.0, 0.09))
        traces = PlateSolver(made, "cpu").run([[3.0]], (), points).trace[0]
        np.testing.assert_allclose(traces, traces[0] * np.ones((3, 1)), atol=1e-9 * np.abs(traces).max())
        turn, state, exact = scipy.linalg.expm(motion * end / steps), np.array([0, 0, 0, 0, 1.0, 0]), []
        for _ in range(steps):
            state = turn @ state
            exact.append(state[0])
        errors.append(np.abs(traces[0] - exact).max() / np.abs(exact).max())
    assert errors[0] < (0.03 if damping else 0.003)
    assert errors[1] < errors[0] * (0.55 if damping else 0.27)


LAYER = {"thickness": 3e-4, "young_modulus": 4e9, "density": 1800.0}
# Springs (translation, rotation) at x = 0 and a of a plate whose other sides are supported, and effects.
LEVY = {
    "free": (0.0, 0.0, {"tension": {"x": 8.0, "y": 5.0}}),
    "rotation alone": (0.0, 0.2, {}),
    "translation alone": (2e4, 0.0, {}),
    "orthotropic on springs": (1e4, 0.1, {"orthotropic": ORTHOTROPIC, "foundation": {"stiffness": 5e4}}),
}


def lowest_frequency(scene):
    """Return the lowest natural frequency ω [rad/s] of the plate on its grid, as the paths step it."""
    stiffness, masses = system(make_bending(scene))
    root = scipy.sparse.diags_array(1 / np.sqrt(masses))
    matrix = root @ stiffness @ root
    value = scipy.sparse.linalg.eigsh(matrix, k=1, sigma=-1.0, which="LM", return_eigenvectors=False)
    return math.sqrt(value[0])


def root_near(determinant, near):
    """Return the root ω of a determinant closest to ``near``, found by its first change of sign."""
    for part in np.linspace(0.0, 0.3, 301):
        low, high = near * (1 - part), near * (1 + part)
        if determinant(low) * determinant(high) < 0:
            return scipy.optimize.brentq(determinant, low, high, xtol=1e-12 * near)
    raise AssertionError("no frequency near the grid's")


@pytest.mark.parametrize("name", LEVY)
def test_edges_on_springs_and_free_ones_by_levys_solution(scene, name):
    """u = X(x) sin(ky), k = π/b: D_x X⁗ − (2(D_1 + 2D_xy)k² + T_x) X″ + (D_y k⁴ + T_y k² + k_f − ρHω²) X = 0, even
    about the middle, and at x = a/2 the moment against the rotation and the shear against the translation:
    D_x X″ − D_1k² X = −r X′, D_x X‴ − ((D_1 + 4D_xy)k² + T_x) X′ = t X. Second order: halving the spacing divides the
    error by about four."""
    translation, rotation, effects = LEVY[name]
    isotropic = {"Dx": RIGIDITY, "Dy": RIGIDITY, "D1": RATIO * RIGIDITY, "Dxy": (1 - RATIO) / 2 * RIGIDITY}
    plate = effects.get("orthotropic", isotropic)
    tension, bed = effects.get("tension", {"x": 0.0, "y": 0.0}), effects.get("foundation", {"stiffness": 0.0})
    k, half = math.pi / SIZE[1], SIZE[0] / 2
    middle = 2 * (plate["D1"] + 2 * plate["Dxy"]) * k**2 + tension["x"]

    def determinant(omega):
        rest = plate["Dy"] * k**4 + tension["y"] * k**2 + bed["stiffness"] - DENSITY * omega**2
        root = np.sqrt(complex(middle**2 - 4 * plate["Dx"] * rest))
        columns = []
        for square in (middle + root, middle - root):
            s = np.sqrt(square / (2 * plate["Dx"]))
            even, odd = np.cosh(s * half), np.sinh(s * half)
            columns.append(
                [
                    (plate["Dx"] * s**2 - plate["D1"] * k**2) * even + rotation * s * odd,
                    (plate["Dx"] * s**3 - ((plate["D1"] + 4 * plate["Dxy"]) * k**2 + tension["x"]) * s) * odd
                    - translation * even,
                ]
            )
        return (np.linalg.det(np.array(columns)) / root).real

    side = {"translation": translation, "rotation": rotation} if translation or rotation else "free"
    edges = (side, "supported", side, "supported")
    # An extra node along x, so that no cell is square.
    errors = []
    for count in (17, 33):
        tables = {"effects": {"foundation": {"stiffness": 0.0}, **effects}}
        found = lowest_frequency(scene((count + 1, count), SIZE, edges, **tables))
        errors.append(found / root_near(determinant, found) - 1)
    assert abs(errors[0]) < 0.01
    assert abs(errors[1]) < max(0.3 * abs(errors[0]), 1e-5)


def test_layer_on_a_strip_of_the_plate_by_levys_solution(scene):
    """The strip 0 … 0.615 a of a supported plate is thickened on both faces: X has other exponents on either side of
    the step, where X, X′, moment and shear are continuous. Second order, for a step within a cell."""
    plane, thin = 1 - RATIO**2, LAYER["thickness"]
    lever = (THICKNESS + thin) / 2
    thick = RIGIDITY + 2 * LAYER["young_modulus"] / plane * (thin**3 / 12 + thin * lever**2)
    cut, k = 0.615 * SIZE[0], math.pi / SIZE[1]
    sides = ((thick, DENSITY + 2 * LAYER["density"] * thin, cut), (RIGIDITY, DENSITY, SIZE[0] - cut))

    def determinant(omega):
        """Rows X, X′, M, V at the step; columns sinh and sin from each supported side."""
        columns = []
        for sign, (rigidity, mass, wide) in zip((1, -1), sides, strict=True):
            turn = math.sqrt(mass / rigidity) * omega
            for square in (k**2 + turn, k**2 - turn):
                s = np.sqrt(complex(square))
                odd, even = np.sinh(s * wide) / s, np.cosh(s * wide)
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

    errors = []
    for nodes in ((65, 57), (129, 113)):
        layer = {"area": (0.0, cut, 0.0, SIZE[1]), "both": True, **LAYER}
        found = lowest_frequency(scene(nodes, SIZE, SUPPORTED, effects={"layers": [layer]}))
        errors.append(found / root_near(determinant, found) - 1)
    assert abs(errors[0]) < 0.01
    assert abs(errors[1]) < 0.3 * abs(errors[0])
