"""Piezo patches against exact plates: E. K. Dimitriadis, C. R. Fuller and C. A. Rogers (J. Vib. Acoust. 113, 1991) on
supported plates, S. Timoshenko's bimetal strip (J. Opt. Soc. Am. 11, 1925) for the stiffness of the patch."""

import math

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate import PlateSolver, Scene, SceneError, focus
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.weights import curvatures

SIZE, AREA = (0.2, 0.15), (0.03, 0.08, 0.04, 0.1)
CERAMIC = {"d31": -190e-12, "thickness": 1e-4, "young_modulus": 6e10}
PLATE = {"size": SIZE, "thickness": 5e-4, "young_modulus": 7e10, "poisson_ratio": 0.25, "density": 2500.0}
TONE = 150.0


def piezo_scene(area=AREA, **tables):
    patch = {"name": "patch", "area": area, "kind": "piezo", **CERAMIC, **tables.pop("patch", {})}
    return scene_of(**{"edges": ("supported",) * 4, "plate": PLATE, "actuators": [area], **tables}).with_tables(
        actuators=[patch]
    )


def dimitriadis(x, y, omega, terms=1000):
    """Return the displacement [m] under 1 V by the series of modes: M (γx² + γy²) over each mode's stiffness.

    The moment per length is E d31 / (1 − ν) times half the thickness of plate and patch.
    """
    moment = 6e10 * -190e-12 / 0.75 * (5e-4 + 1e-4) / 2
    rigidity, mass = 7e10 * 5e-4**3 / 12 / (1 - 0.25**2), 2500 * 5e-4
    kx, ky = (np.arange(1, terms + 1) * math.pi / side for side in SIZE)
    x0, x1, y0, y1 = AREA
    along = (np.cos(kx * x0) - np.cos(kx * x1)) / kx * np.sin(kx * x)
    across = (np.cos(ky * y0) - np.cos(ky * y1)) / ky * np.sin(ky * y)
    squares = np.add.outer(kx**2, ky**2)
    stiffness = rigidity * squares**2 - mass * omega**2
    return float(4 / math.prod(SIZE) * along @ (moment * squares / stiffness) @ across)


def test_modes_move_as_the_series_says():
    plate, frequencies = solve_modes(piezo_scene(), 1500.0, density=2.0), np.array([1e-3, TONE, 1200.0])
    amplitudes = plate.respond(frequencies, plate.actuator_forces())[:, :, 0].real
    for point in ((0.055, 0.07), (0.12, 0.1)):
        expected = [dimitriadis(*point, 2 * math.pi * frequency) for frequency in frequencies]
        assert (amplitudes @ plate.at_points([point]))[:, 0] == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("body", [False, True])
def test_a_covered_plate_bends_as_a_bimetal(body):
    """∇²u is the same everywhere, −(1 + ν) times the bimetal's curvature, so u is that of a membrane: .0736713 a²."""
    side, voltage = 0.2, 100.0
    patch = {"density": 7800.0} if body else {}
    scene = piezo_scene(area=(0.0, side, 0.0, side), plate={**PLATE, "size": (side, side)}, patch=patch)
    plate = solve_modes(scene, 2000.0)
    moved = plate.respond(np.array([1e-3]), plate.actuator_forces())[0, :, 0].real @ plate.at_points([(0.1, 0.1)])
    m, n, whole = 1e-4 / 5e-4, 6e10 / 7e10, 6e-4
    strain = -190e-12 / 1e-4  # per volt
    if body:
        curvature = 6 * strain * (1 + m) ** 2 / (whole * (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n))))
    else:
        curvature = 6 * strain * n * m * (1 + m) / 5e-4  # the strip alone resists
    assert voltage * moved[0] == pytest.approx(voltage * 0.0736713 * side**2 * 1.25 * curvature, rel=2e-3)


def test_loads_have_no_force_and_no_moment():
    """Every motion linear in x and y does no work, at free edges too; a bowl x² does that of its curvature."""
    x, y = np.linspace(0, 0.2, 21), np.linspace(0, 0.15, 17)
    for area in (AREA, (0.0, 0.013, 0.1, 0.15)):
        load = curvatures(x, y, area) * (x[1] * y[1])
        for motion in (np.ones((17, 21)), np.tile(x, (17, 1)), np.tile(y[:, None], (1, 21))):
            assert abs((load * motion).sum()) < 1e-12
        size = (area[1] - area[0]) * (area[3] - area[2])
        assert (load * x**2).sum() == pytest.approx(2 * size)


def test_free_plates_agree_by_modes_and_in_time_steps():
    """A patch at a corner of a plate with free edges, held along one side, in the steady state."""
    tables = {"edges": ("clamped", "free", "free", "free"), "window": (0.02, 0.0366), "damping": 1000.0}
    scene = piezo_scene(area=(0.15, 0.2, 0.1, 0.15), nodes=(41, 31), frequency=60.0, **tables)
    found = [solver(scene, "cpu").run(np.ones((1, 1))).energy for solver in (ModalSolver, PlateSolver)]
    np.testing.assert_allclose(found[1], found[0], rtol=0.03)


def test_electrical_energy_is_that_of_each_rise_of_the_voltage():
    """½ C V² at each change of sign of one-bit waveforms, and ∫ C V dV wherever |V| rises of others."""
    table = {"points": [(0.12, 0.1)], "highest": 1000.0, "time": 0.02, "rate": 16000}
    methods = focus(piezo_scene(damping=50.0, focus=table, patch={"capacitance": 2e-9})).methods
    signs = methods["one_bit"].waveforms[0, 0]
    assert methods["one_bit"].electrical_energy == pytest.approx(1e-9 * (1 + np.count_nonzero(np.diff(signs))))
    waveform = np.r_[0, methods["time_reversal"].waveforms[0, 0]]
    steps = np.arange(1000 * (waveform.size - 1) + 1) / 1000
    magnitude = np.abs(np.interp(steps, np.arange(waveform.size), waveform))
    rising = np.diff(magnitude) > 0
    expected = 2e-9 * (np.diff(magnitude) * (magnitude[1:] + magnitude[:-1]) / 2)[rising].sum()  # ∫ C V dV
    assert methods["time_reversal"].electrical_energy == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("patch", "words"),
    [
        ({"d31": None}, 'd31: missing; kind = "piezo" takes d31, thickness, young_modulus'),
        ({"force": 1.0}, "force: 1 N, but a piezo patch takes volts"),
        ({"thickness": 0.5}, r"actuators\[0\].thickness: 0.5 m is not thin"),
        ({"kind": "pressure"}, "d31: -1.9e-10, but the patch presses"),
        ({"kind": "magnet"}, "kind"),
        ({"d31": 0.0}, "d31"),
    ],
)
def test_wrong_patches_are_refused(patch, words):
    with pytest.raises(SceneError, match=words):
        piezo_scene(patch=patch)


@pytest.mark.parametrize(
    "tables",
    [
        {"search": {"position": {}}},
        {"drive": {"frequency": 100.0, "electrostatic": {"gain": 1.0}}},
        {"effects": {"variation": {"thickness": [[1.0, 2.0]]}}},
    ],
)
def test_what_piezo_patches_cannot_have_is_refused(tables):
    with pytest.raises(SceneError, match="piezo patches"):
        piezo_scene(**tables)
    mixed = [{"name": "a", "area": AREA, "kind": "piezo", **CERAMIC}, {"name": "b", "area": AREA}]
    with pytest.raises(SceneError, match=r"actuators\[1\].kind"):
        Scene.load("paper").with_tables(actuators=mixed)
