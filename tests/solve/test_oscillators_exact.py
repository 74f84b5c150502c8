"""Oscillators on a plate, against two degrees of freedom, an absorber's anti-resonance, and superposition."""

import math

import numpy as np
import pytest
import scipy.linalg

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import overlap

SUPPORTED = ("supported",) * 4
NODES, SIZE = (13, 11), (0.2, 0.18)
FREE = ("free",) * 4
AREA = SIZE[0] * SIZE[1]
YOUNG, RATIO, THICKNESS, DENSITY = 1e9, 0.33, 5e-4, 0.5  # of conftest's plate; density per area
RIGIDITY = YOUNG * THICKNESS**3 / 12 / (1 - RATIO**2)
# So low a frequency that the load is constant to 1e-12.
CONSTANT = 1e-5


@pytest.fixture
def evenly_loaded(scene):
    """A factory of undamped scenes until ``end``, with one actuator over the whole plate."""

    def make(edges, effects, end, frequency, part=0.5, nodes=NODES, start=0.0, **changes):
        area = [(0.0, SIZE[0], 0.0, SIZE[1])]
        asked = {"effects": effects, "actuators": area, **changes}
        limit = make_scheme(scene(nodes, SIZE, edges, frequency=CONSTANT, **asked)).limit
        step = end / math.ceil(end / (part * limit))
        return scene(nodes, SIZE, edges, window=(start, end), frequency=frequency, time_step=step, **asked)

    return make


def run_traced(made, pressure, points=((0.07, 0.05),)):
    """Run and return times and traces (steps + 1, points), with the start at rest."""
    run = PlateSolver(made, "cpu").run([[pressure]], (), points)
    return np.append(0, run.trace_times), np.append(np.zeros((1, len(points))), run.trace[0].T, axis=0)


@pytest.mark.parametrize("damping", [0.0, 2.0])
@pytest.mark.parametrize("mass", [0.006, 0.0])
def test_oscillator_under_a_rigid_plate(evenly_loaded, damping, mass):
    """A free plate on a bed, evenly loaded, with an oscillator over all of it, stays flat: two degrees of freedom (one
    if the spring stands on the ground), solved by the matrix exponential."""
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
        made = evenly_loaded(FREE, effects, 0.05, 55.0, part)
        times, traces = run_traced(made, 3.0, ((0.07, 0.05), (0.2, 0.18), (0.0, 0.09)))
        np.testing.assert_allclose(traces, traces[:, :1] * np.ones(3), atol=1e-9 * np.abs(traces).max())
        turn, state = scipy.linalg.expm(motion * times[1]), np.array([0, 0, 0, 0, 1.0, 0])
        exact = [0.0]
        for _ in times[1:]:
            state = turn @ state
            exact.append(state[0])
        errors.append(np.abs(traces[:, 0] - exact).max() / np.abs(exact).max())
    assert errors[0] < (0.03 if damping else 0.003)
    assert errors[1] < errors[0] * (0.55 if damping else 0.27)


def test_spring_on_the_ground_by_superposition(scene):
    """At rest the mean deflection of the spring's patch is w/(1 + k δ), with w without the spring and δ under a unit
    force on the patch, from three damped runs; δ also by a sine series (Navier)."""
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
