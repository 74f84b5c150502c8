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
