"""The Ritz reference: natural frequencies, transients, localization factors, and their convergence."""

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial import legendre

from warp_plate import Scene, SceneError
from warp_plate.reference import forced, series
from warp_plate.reference.ritz import make_line, solve_modes
from warp_plate.reference.thin_plate import EDGES, ThinPlate, thin_plate
from warp_plate.scene.effects import Effects

TABLE = Path(__file__).parents[1] / "data" / "modes_square_plate.csv"
NAMES = {"C": "clamped", "S": "supported", "F": "free"}
SINGLE_AND_EQUAL = np.array([[1, 0, 0, 0], [1, 1, 1, 1]], dtype=complex)
# Steady localization factor of one actuator and the bound, of the source paper's plate.
LIMITS = {"paper": (88.5, 0.5872, 0.6545), "paper-supported": (112.0, 0.6233, 0.6374)}


def table_rows():
    with open(TABLE, encoding="utf-8") as lines:
        return list(csv.reader(line for line in lines if not line.startswith("#")))[1:]


def unit_square(held):
    """a = b = 1, D = ρH = 1, ν = 0.3; edges as in the table: x = 0, y = 0, x = a, y = a."""
    return ThinPlate((1.0, 1.0), tuple(NAMES[letter] for letter in held), 1.0, 0.3, 1.0)


def preset(name, viscous, **changes):
    effects = Effects.model_validate({"damping": {"viscous": viscous}})
    return Scene.load(name).model_copy(update={"effects": effects, **changes})


def uniformly_loaded(scene):
    whole = scene.actuators[0].model_copy(update={"area": (0.0, 0.2, 0.0, 0.2)})
    return scene.model_copy(update={"actuators": (whole,)})


@pytest.mark.parametrize(("held", "published"), [(row[0], row[1:]) for row in table_rows()])
def test_natural_frequencies(held, published):
    """Published frequencies within 2e-5: the table's last digit is worth up to 1.4e-5."""
    modes = solve_modes(unit_square(held[:4]), 24)
    assert modes.rigid == int(held.split("_")[2] if "_" in held else 0)
    found = modes.angular_frequencies[modes.rigid :][:6]
    np.testing.assert_allclose(found, np.array(published, dtype=float), rtol=2e-5)


def test_frequencies_of_a_supported_plate():
    """π²κ((m/a)² + (n/b)²), for unlike sides and a rigidity and density that are not one."""
    plate = ThinPlate((0.5, 0.3), ("supported",) * 4, 7.0, 0.33, 0.5)
    orders = np.arange(1, 9)
    squared = (orders * math.pi / 0.5) ** 2 + (orders[:, None] * math.pi / 0.3) ** 2
    exact = np.sort(math.sqrt(7 / 0.5) * squared.ravel())[:12]
    np.testing.assert_allclose(solve_modes(plate, (28, 20)).angular_frequencies[:12], exact, rtol=1e-8)


def test_frequencies_converge_from_above():
    counts = range(4, 16)
    found = np.array([solve_modes(unit_square("CCCC"), count).angular_frequencies[:4] for count in counts])
    assert (np.diff(found, axis=0) <= 1e-9 * found[1:]).all()
    changes = -np.diff(found[1::2, 0])
    assert (changes[1:] < changes[:-1] / 8).all()
    assert changes[-1] < 1e-6


@pytest.mark.parametrize(("low", "high"), list(zip(EDGES, EDGES[1:] + EDGES[:1], strict=True)))
def test_functions_of_a_line(low, high):
    """Orthonormal, with the geometric edge conditions, and with consistent derivatives and integrals."""
    line = make_line(0.4, low, high, 20)
    np.testing.assert_allclose(line.products(0, 0.4), np.eye(20), atol=1e-12)
    for end, edge in ((0.0, low), (0.4, high)):
        value, slope = line.values([end])[:, 0], line.values([end], 1)[:, 0]
        assert (np.abs(value).max() < 1e-11) == (edge != "free")
        assert (np.abs(slope).max() < 1e-7) == (edge == "clamped")
    x, h = np.linspace(0.05, 0.35, 7), 1e-5
    step = (line.values(x + h) - line.values(x - h)) / (2 * h)
    np.testing.assert_allclose(line.values(x, 1), step, atol=1e-4 * np.abs(step).max())
    parts = line.integrals(0, 0.13) + line.integrals(0.13, 0.4)
    np.testing.assert_allclose(parts, line.integrals(0, 0.4), atol=1e-12)


def test_shapes_are_orthonormal():
    """Overlaps over the whole plate are the identity, those of two parts add up to it, and shapes agree with them."""
    modes = solve_modes(ThinPlate((0.3, 0.2), ("clamped", "free", "supported", "free"), 1.0, 0.3, 1.0), 10)
    whole, left, right = (modes.overlaps((*x, 0.0, 0.2)) for x in ((0.0, 0.3), (0.0, 0.1), (0.1, 0.3)))
    np.testing.assert_allclose(whole, np.eye(100), atol=1e-11)
    np.testing.assert_allclose(left + right, whole, atol=1e-11)
    s, weights = legendre.leggauss(14)
    shapes = modes.shapes(0.05 + 0.05 * s, 0.1 + 0.1 * s)
    products = np.einsum("mji,nji,j,i->mn", shapes, shapes, 0.1 * weights, 0.05 * weights)
    np.testing.assert_allclose(products, left, atol=1e-11)


@pytest.mark.parametrize("viscous", [0.0, 75.4546326697, 4000.0])
def test_transient_is_the_series(viscous):
    """A uniform load on a supported plate: undamped, at the first mode's critical damping, and with creeping modes.

    The load sets in at once and excites modes beyond those that the functions follow; their error dies with them.
    """
    scene = uniformly_loaded(preset("paper-supported", viscous))
    modes, drive = solve_modes(thin_plate(scene), 36), np.array([0.8 - 0.6j])
    x, y, times = np.linspace(0, 0.2, 9), np.linspace(0, 0.2, 7), (0.0, 0.002, 0.03, 0.1)
    found = forced.displacement(modes, scene, drive, times, x, y)
    exact = series.displacement(scene, drive, times, x, y, terms=200)
    size = np.abs(exact).max()
    np.testing.assert_allclose(found, exact, atol=1e-4 * size)
    if viscous > 70:
        np.testing.assert_allclose(found[-1], exact[-1], atol=1e-6 * size)
    assert np.abs(found[0]).max() < 1e-9 * size


def test_patch_energies_are_those_of_the_series():
    scene = preset("paper-supported", 112.0)
    drive = np.array([1, 0.3 - 0.4j, 0, 0.2j])
    found = forced.transient_matrices(solve_modes(thin_plate(scene), 40), scene)
    plate, target = series.kinetic_energies(scene, drive, terms=32)
    assert forced.localization_factors(found, drive[None])[0] == pytest.approx(target / plate, abs=1e-6)
    z = np.concatenate([drive.real, -drive.imag])
    assert z @ found[0] @ z == pytest.approx(plate, rel=1e-6)


def test_window_averages():
    """The closed form of the energies against Gauss's rule, for unlike edges and a drive with phases."""
    scene = preset("paper", 88.5, window=Scene.load("paper").window.model_copy(update={"start": 0.001, "end": 0.004}))
    plate = ThinPlate((0.2, 0.2), ("clamped", "free", "supported", "free"), 0.0117, 0.33, 0.5, 88.5)
    modes, drive = solve_modes(plate, 8), np.array([0.5, -0.3j, 1 + 1j, 0.2])
    s, weights = legendre.leggauss(600)
    force = drive @ modes.patch_forces([actuator.area for actuator in scene.actuators])
    rates = (force * forced.motion_from_rest(modes, 290.0, 0.004).at(0.0025 + 0.0015 * s, derivative=1)).real
    z = np.concatenate([drive.real, -drive.imag])
    found = np.einsum("a,rab,b->r", z, forced.transient_matrices(modes, scene), z)
    for overlaps, energy in zip((np.eye(64), modes.overlaps(scene.target.area)), found, strict=True):
        average = 0.25 * np.einsum("t,tm,mn,tn->", weights / 2, rates, overlaps, rates)
        assert energy == pytest.approx(average, rel=1e-10)


def test_free_plate_moves_as_a_rigid_body():
    """Under a uniform load u = (1 − cos ωt) p/(ρHω²) without damping."""
    scene = uniformly_loaded(preset("paper", 0.0))
    modes = solve_modes(ThinPlate((0.2, 0.2), ("free",) * 4, 0.0117, 0.33, 0.5), 12)
    times, omega = np.array([0.001, 0.02, 0.1]), 2 * math.pi * 290
    found = forced.displacement(modes, scene, np.ones(1), times, [0.0, 0.07], [0.2])
    exact = (1 - np.cos(omega * times)) / (0.5 * omega**2)
    np.testing.assert_allclose(found, np.broadcast_to(exact[:, None, None], (3, 1, 2)), atol=1e-9 * exact.max())


@pytest.mark.parametrize("name", LIMITS)
def test_limits_of_the_paper_scene(name):
    """Of the steady vibration: a window of whole periods after the transient has died, exp(−88·1)."""
    viscous, single, best = LIMITS[name]
    window = Scene.load(name).window.model_copy(update={"start": 1.0, "end": 1.0 + 29 / 290})
    scene = preset(name, viscous, window=window)
    matrices = forced.transient_matrices(solve_modes(thin_plate(scene), 36), scene)
    found = forced.localization_factors(matrices, SINGLE_AND_EQUAL)
    np.testing.assert_allclose(found, [single, 0.25], atol=2e-4)
    assert found[1] == pytest.approx(0.25, abs=1e-9)
    assert forced.bound(matrices)[0] == pytest.approx(best, abs=2e-4)


def test_bound_is_reached_and_not_exceeded(random):
    scene = preset("paper", 88.5)
    matrices = forced.transient_matrices(solve_modes(thin_plate(scene), 13), scene)
    largest, best = forced.bound(matrices)
    assert forced.localization_factors(matrices, best[None])[0] == pytest.approx(largest, abs=1e-10)
    drives = random.normal(size=(1000, 4)) + 1j * random.normal(size=(1000, 4))
    assert forced.localization_factors(matrices, drives).max() <= largest + 1e-12
    assert forced.localization_factors(matrices, np.ones((1, 4)))[0] == pytest.approx(0.25, abs=1e-11)


def test_refusals():
    modes = solve_modes(unit_square("SFFF"), 6)
    resonant = replace(modes, angular_frequencies=modes.angular_frequencies.copy())
    resonant.angular_frequencies[3] = 2 * math.pi * 7
    with pytest.raises(ValueError, match="natural frequency"):
        forced.motion_from_rest(resonant, 7.0, 1.0)
    with pytest.raises(ValueError, match="at least 4"):
        solve_modes(unit_square("CCCC"), 3)
    scene = preset("paper", 88.5)
    edges = scene.edges.model_copy(update={"top": "sprung"})
    with pytest.raises(SceneError, match=r"edges\.top = sprung"):
        thin_plate(scene.model_copy(update={"edges": edges}))
