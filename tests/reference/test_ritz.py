"""The Ritz reference: natural frequencies, static deflections, transients, localization factors, and how it
converges."""

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

DATA = Path(__file__).parents[1] / "data"
NAMES = {"C": "clamped", "S": "supported", "F": "free"}
SINGLE_AND_EQUAL = np.array([[1, 0, 0, 0], [1, 1, 1, 1]], dtype=complex)
# Steady localization factor of one actuator and the bound, of the source paper's plate.
LIMITS = {"paper": (88.5, 0.5872, 0.6545), "paper-supported": (112.0, 0.6233, 0.6374)}


def rows_of(name):
    """The rows of a table in the data folder, without its comments and its head."""
    with open(DATA / name, encoding="utf-8") as lines:
        return list(csv.reader(line for line in lines if not line.startswith("#")))[1:]


def unit_square(held):
    """a = b = 1, D = ρH = 1, ν = 0.3; held: edges as in the tables, x = 0, y = 0, x = a, y = a."""
    return ThinPlate((1.0, 1.0), tuple(NAMES[letter] for letter in held), 1.0, 0.3, 1.0)


def preset(name, viscous, **changes):
    """A preset with other damping."""
    effects = Effects.model_validate({"damping": {"viscous": viscous}})
    return Scene.load(name).model_copy(update={"effects": effects, **changes})


@pytest.mark.parametrize(("held", "published"), [(row[0], row[1:]) for row in rows_of("modes_square_plate.csv")])
def test_natural_frequencies(held, published):
    """All fourteen rows with 32 × 32 functions, within 2e-5: the table's last digit is worth up to 1.4e-5."""
    modes = solve_modes(unit_square(held[:4]))
    assert modes.rigid == int(held.split("_")[2] if "_" in held else 0)
    found = modes.angular_frequencies[modes.rigid :][:6]
    np.testing.assert_allclose(found, np.array(published, dtype=float), rtol=2e-5)


def test_frequencies_of_a_supported_plate():
    """π²κ((m/a)² + (n/b)²), for unlike sides and a rigidity and density that are not one."""
    plate = ThinPlate((0.5, 0.3), ("supported",) * 4, 7.0, 0.33, 0.5)
    orders = np.arange(1, 9)
    squared = (orders * math.pi / 0.5) ** 2 + (orders[:, None] * math.pi / 0.3) ** 2
    exact = np.sort(math.sqrt(7 / 0.5) * squared.ravel())[:12]
    for functions in (24, (28, 20)):
        np.testing.assert_allclose(solve_modes(plate, functions).angular_frequencies[:12], exact, rtol=1e-8)


def test_frequencies_come_from_above_and_converge():
    """A Ritz space that grows: no frequency rises. With two more functions the first of a clamped plate changes ten
    times less than with the two before."""
    counts = range(4, 16)
    found = np.array([solve_modes(unit_square("CCCC"), count).angular_frequencies[:4] for count in counts])
    assert (np.diff(found, axis=0) <= 1e-9 * found[1:]).all()
    changes = -np.diff(found[1::2, 0])
    assert (changes[1:] < changes[:-1] / 8).all()
    assert changes[-1] < 1e-6


@pytest.mark.parametrize(("held", "load", "coefficient"), rows_of("static_plate.csv"))
def test_static_deflection(held, load, coefficient):
    """At the centre. A point load converges as 1/functions², from below, and is extrapolated."""
    centre, found = np.array([0.5]), []
    for count in (24, 32):
        modes = solve_modes(unit_square(held), count)
        uniform = modes.patch_forces([(0.0, 1.0, 0.0, 1.0)])
        forces = uniform if load == "uniform" else modes.point_forces([(0.5, 0.5)])
        found.append(modes.static_deflection(forces, centre, centre)[0, 0, 0])
    coarse, fine = found
    exact = float(coefficient)
    if load == "uniform":
        assert fine == pytest.approx(exact, rel=2e-6)
    else:
        assert coarse < fine < exact
        assert (32**2 * fine - 24**2 * coarse) / (32**2 - 24**2) == pytest.approx(exact, rel=2e-4)


@pytest.mark.parametrize("low", EDGES)
@pytest.mark.parametrize("high", EDGES)
def test_functions_of_a_line(low, high):
    """Orthonormal, with the edge conditions, their derivatives and integrals right."""
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
    """Overlaps over the whole plate are one; over two halves they add up to it; shapes agree with them."""
    modes = solve_modes(ThinPlate((0.3, 0.2), ("clamped", "free", "supported", "free"), 1.0, 0.3, 1.0), 10)
    whole, left, right = (modes.overlaps((*x, 0.0, 0.2)) for x in ((0.0, 0.3), (0.0, 0.1), (0.1, 0.3)))
    np.testing.assert_allclose(whole, np.eye(100), atol=1e-11)
    np.testing.assert_allclose(left + right, whole, atol=1e-11)
    s, weights = legendre.leggauss(14)
    shapes = modes.shapes(0.05 + 0.05 * s, 0.1 + 0.1 * s)
    np.testing.assert_allclose(
        np.einsum("mji,nji,j,i->mn", shapes, shapes, 0.1 * weights, 0.05 * weights), left, atol=1e-11
    )


@pytest.mark.parametrize("viscous", [0.0, 40.0, 75.0, 75.4546326697, 112.0, 4000.0])
def test_transient_is_the_series(viscous):
    """A supported plate under a uniform load, from no damping through the first mode's critical damping (75.45...)
    to twenty modes that only creep: displacement and velocity against the sine series.

    The load sets in at once and excites modes beyond those that the functions follow: what is left of them is the
    error, which dies with them.
    """
    scene = preset("paper-supported", viscous)
    whole = scene.actuators[0].model_copy(update={"area": (0.0, 0.2, 0.0, 0.2)})
    scene = scene.model_copy(update={"actuators": (whole,)})
    modes, drive = solve_modes(thin_plate(scene), 36), np.array([0.8 - 0.6j])
    x, y, times = np.linspace(0, 0.2, 9), np.linspace(0, 0.2, 7), (0.0, 0.002, 0.03, 0.1)
    for name, early, late in (("displacement", 1e-4, 1e-6), ("velocity", 0.03, 1e-5)):
        found = getattr(forced, name)(modes, scene, drive, times, x, y)
        exact = getattr(series, name)(scene, drive, times, x, y, terms=200)
        size = np.abs(exact).max()
        np.testing.assert_allclose(found, exact, atol=early * size)
        if viscous > 70:
            np.testing.assert_allclose(found[-1], exact[-1], atol=late * size)
        assert np.abs(found[0]).max() < 1e-9 * size


def test_patch_energies_are_those_of_the_series():
    """The localization factor of a transient under patches, by the closed form and by the series: 1e-6."""
    scene = preset("paper-supported", 112.0)
    drive = np.array([1, 0.3 - 0.4j, 0, 0.2j])
    found = forced.transient_matrices(solve_modes(thin_plate(scene), 40), scene)
    plate, target = series.kinetic_energies(scene, drive, terms=32)
    assert forced.localization_factors(found, drive[None])[0] == pytest.approx(target / plate, abs=1e-6)
    z = np.concatenate([drive.real, -drive.imag])
    assert z @ found[0] @ z == pytest.approx(plate, rel=1e-6)


def test_window_averages():
    """The closed form of the energies against Gauss's rule over the window, edges all unlike, and one drive
    with phases."""
    scene = preset("paper", 88.5, window=Scene.load("paper").window.model_copy(update={"start": 0.001, "end": 0.004}))
    plate = ThinPlate((0.2, 0.2), ("clamped", "free", "supported", "free"), 0.0117, 0.33, 0.5, 88.5)
    modes, drive = solve_modes(plate, 8), np.array([0.5, -0.3j, 1 + 1j, 0.2])
    s, weights = legendre.leggauss(600)
    force = drive @ modes.patch_forces([actuator.area for actuator in scene.actuators])
    times = 0.0025 + 0.0015 * s
    rates = (force * forced.motion_from_rest(modes, 290.0, 0.004).at(times, derivative=1)).real
    z = np.concatenate([drive.real, -drive.imag])
    found = np.einsum("a,rab,b->r", z, forced.transient_matrices(modes, scene), z)
    for overlaps, energy in zip((np.eye(64), modes.overlaps(scene.target.area)), found, strict=True):
        average = 0.25 * np.einsum("t,tm,mn,tn->", weights / 2, rates, overlaps, rates)
        assert energy == pytest.approx(average, rel=1e-10)


def test_free_plate_moves_as_a_rigid_body():
    """Under a uniform load no mode but the rigid one moves: u = (1 − cos ωt) p/(ρHω²) without damping."""
    scene = preset("paper", 0.0)
    whole = scene.actuators[0].model_copy(update={"area": (0.0, 0.2, 0.0, 0.2)})
    scene = scene.model_copy(update={"actuators": (whole,)})
    modes = solve_modes(ThinPlate((0.2, 0.2), ("free",) * 4, 0.0117, 0.33, 0.5), 12)
    times, omega = np.array([0.001, 0.02, 0.1]), 2 * math.pi * 290
    found = forced.displacement(modes, scene, np.ones(1), times, [0.0, 0.07], [0.2])
    exact = (1 - np.cos(omega * times)) / (0.5 * omega**2)
    np.testing.assert_allclose(found, np.broadcast_to(exact[:, None, None], (3, 1, 2)), atol=1e-9 * exact.max())


@pytest.mark.parametrize("name", LIMITS)
def test_limits_of_the_paper_scene(name):
    """Steady localization factor of one actuator and its bound within 2e-4; a quarter when all press alike."""
    viscous, single, best = LIMITS[name]
    row = forced.converge(preset(name, viscous), SINGLE_AND_EQUAL, steady=True, counts=(36,))[0]
    np.testing.assert_allclose(row.localization_factors, [single, 0.25], atol=2e-4)
    assert row.localization_factors[1] == pytest.approx(0.25, abs=1e-11)
    assert row.bound == pytest.approx(best, abs=2e-4)


def test_convergence_and_its_estimate():
    """Clamped plate, steady part: to 1e-6 with 44 functions, and each row's estimate covers its distance from the
    last row."""
    rows = forced.converge(preset("paper", 88.5), SINGLE_AND_EQUAL[:1], steady=True, counts=(16, 24, 32, 40, 44, 48))
    values = np.array([[*row.localization_factors, row.bound] for row in rows])
    assert np.isnan([rows[0].error, rows[1].error]).all()
    for row, value in zip(rows[2:], values[2:], strict=True):
        assert np.abs(value - values[-1]).max() <= row.error
    assert rows[-1].error < 1e-6
    assert rows[-1].functions == 48


def test_symmetric_scene_equal_drive():
    """A quarter of the energy in the quadrant for the transient too, and at any number of functions."""
    matrices = forced.transient_matrices(solve_modes(thin_plate(preset("paper", 88.5)), 13), preset("paper", 88.5))
    assert forced.localization_factors(matrices, np.ones((1, 4)))[0] == pytest.approx(0.25, abs=1e-11)


def test_late_window_is_steady():
    """After the transient has died (exp(−88·1)), a window of whole periods averages the steady vibration."""
    scene = preset("paper", 88.5)
    late = scene.model_copy(update={"window": scene.window.model_copy(update={"start": 1.0, "end": 1.0 + 29 / 290})})
    modes = solve_modes(thin_plate(scene), 12)
    steady = forced.steady_matrices(modes, late)
    np.testing.assert_allclose(forced.transient_matrices(modes, late), steady, atol=1e-9 * np.abs(steady).max())


def test_bound_is_reached_and_not_passed(random):
    """By its own drive, and by none of a thousand others."""
    scene = preset("paper", 88.5)
    matrices = forced.transient_matrices(solve_modes(thin_plate(scene), 12), scene)
    largest, best = forced.bound(matrices)
    assert forced.localization_factors(matrices, best[None])[0] == pytest.approx(largest, abs=1e-10)
    drives = random.normal(size=(1000, 4)) + 1j * random.normal(size=(1000, 4))
    assert forced.localization_factors(matrices, drives).max() <= largest + 1e-12


def test_turned_plate_is_the_same_plate():
    """Edges, patches and target mirrored at the diagonal: x and y change places, nothing else."""
    scene = preset("paper", 60.0)

    def turned(area):
        return (area[2], area[3], area[0], area[1])

    def reflected(scene):
        actuators = tuple(one.model_copy(update={"area": turned(one.area)}) for one in scene.actuators)
        target = scene.target.model_copy(update={"area": turned(scene.target.area)})
        return scene.model_copy(update={"actuators": actuators, "target": target})

    scene = scene.model_copy(update={"target": scene.target.model_copy(update={"area": (0.02, 0.07, 0.1, 0.19)})})
    upright = ThinPlate((0.2, 0.25), ("clamped", "free", "supported", "clamped"), 0.0117, 0.4, 0.5, 60.0)
    lying = ThinPlate((0.25, 0.2), ("free", "clamped", "clamped", "supported"), 0.0117, 0.4, 0.5, 60.0)
    found = [
        forced.transient_matrices(solve_modes(plate, 9), made)
        for plate, made in ((upright, scene), (lying, reflected(scene)))
    ]
    np.testing.assert_allclose(found[0], found[1], atol=1e-9 * np.abs(found[0]).max())


def test_what_is_refused():
    """A static load that nothing carries, undamped resonance, too few functions, effects that are not known."""
    loose = solve_modes(unit_square("SFFF"), 6)
    with pytest.raises(ValueError, match="hold it somewhere"):
        loose.static_deflection(loose.point_forces([(0.5, 0.5)]), [0.5], [0.5])
    resonant = replace(loose, angular_frequencies=loose.angular_frequencies.copy())
    resonant.angular_frequencies[3] = 2 * math.pi * 7
    with pytest.raises(ValueError, match="one of its own frequencies"):
        forced.motion_from_rest(resonant, 7.0, 1.0)
    with pytest.raises(ValueError, match="at least 4"):
        solve_modes(unit_square("CCCC"), 3)
    scene = preset("paper", 88.5)
    edges = scene.edges.model_copy(update={"top": "sprung"})
    with pytest.raises(SceneError, match=r"edges\.top = sprung"):
        thin_plate(scene.model_copy(update={"edges": edges}))
