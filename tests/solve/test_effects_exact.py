"""Effects that are the same all over a supported plate, and stretching, against the exact motion of one mode.

A supported plate loaded in the shape sin(mπx/a) sin(nπy/b) of one mode moves in that mode alone, on the grid too:
its amplitude q is an oscillator's, with everything that is uniform over the plate in

    ρH q̈ + (c + τ B) q̇ + (B + T_x k_x² + T_y k_y² + k) q = Re(Z exp(iωt)),
    B = D_x k_x⁴ + 2(D_1 + 2D_xy) k_x² k_y² + D_y k_y⁴

k_x = mπ/a for the plate, k_x = 2/h_x · sin(mπh_x/2a) on the grid. With the grid's, what is left of the difference
to the exact motion is the error in time, (ωΔt)² in ω, or Δt τB/2ρH with the material's rate at the last half-step.
"""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.special

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.reference.series import damped_motion, grid_wavenumber_squared, mode_shape

SUPPORTED = ("supported",) * 4
NODES, SIZE = (13, 11), (0.2, 0.18)
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
STRETCH = {"stretching": {}}


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
    """Recovered from a run: two steps of the grid's oscillator make q⁺ − (1 + d − gλΔt²) q + d q⁻ = gΔt² Z_n/ρH, and
    the two unknowns found from its history are those of the formula to rounding."""
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


def duffing(mode, nodes, effects=STRETCH):
    """ρHω₀² [N/m³] and what Berger's tension adds to it for q², in [N/m⁵], for a mode on the grid.

    For q sin sin the integral of u_x² + κu_y² is K q² ab/4, K = k_x² + κk_y², so N K q = 6D_x/(H²ab) · K² q³ ab/4, with
    κ² = D_y/D_x, which is one for an isotropic plate.
    """
    along_x, along_y = squares_of(mode, SIZE, nodes)
    stiffness, _ = oscillator_of(effects, mode, (along_x, along_y))
    own = effects.get("orthotropic", {"Dx": RIGIDITY, "Dy": RIGIDITY})
    pulled = along_x + math.sqrt(own["Dy"] / own["Dx"]) * along_y
    return stiffness, 1.5 * own["Dx"] * pulled**2 / THICKNESS**2


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
    limit = make_scheme(
        point_scene(NODES, SIZE, SUPPORTED, effects=STRETCH, frequency=CONSTANT, time_step=None)
    ).limit
    for part in (0.4, 0.2):
        step = end / math.ceil(end / (part * limit))  # as mode_run takes it
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
