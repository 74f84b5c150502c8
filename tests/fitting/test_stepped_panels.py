"""Fits of responses by time stepping, from random panels; ``benchmarks/fits`` has many more."""

import math

import numpy as np
import pytest
from fits.campaign import ALLOWED, INSEPARABLE, measured, summary
from fits.panels import random_panel
from fits.stepping import extrapolated, transfer_functions

from warp_plate import PlateSolver

# A panel with a loss factor, and one with springs and viscous damping.
PANELS = 16, 17


def steady_amplitudes(scene, frequency, periods):
    """Return the receptances (sensors,) at the end of a run, when only the tone is left, and the time step."""
    drive, window = {"frequency": frequency}, {"start": 0, "end": periods / frequency}
    solver = PlateSolver(scene.with_tables(drive=drive, window=window), "cpu", threads=1)
    run = solver.run([[1.0]], points=[each.point for each in scene.measurement])
    last = run.trace_times > (periods - 4) / frequency
    turn = 2 * math.pi * frequency * run.trace_times[last]
    waves = np.stack([np.cos(turn), -np.sin(turn)], axis=1)
    real, imaginary = np.linalg.lstsq(waves, run.trace[0][:, last].T)[0]
    x0, x1, y0, y1 = scene.actuators[0].area
    return (real + 1j * imaginary) / ((x1 - x0) * (y1 - y0)), solver.scheme.time_step


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["viscous", "material"])
def test_damped_responses_are_those_of_damped_steps(kind):
    """At one frequency a loss factor is a retardation time; both with what the scheme makes of iω and ω²."""
    panel = random_panel(2)
    frequency, loss = float(panel.frequencies[5]), 0.2
    omega, surface = 2 * math.pi * frequency, panel.scene.plate.density * panel.scene.plate.thickness
    grid = {"nodes": [1 + 2 * count for count in panel.lattice], "precision": "float64"}
    scene = panel.scene.with_tables(grid=grid, effects={}, window={"start": 0, "end": 60 / frequency})
    viscous = kind == "viscous"
    damping, material = {"viscous": loss * omega * surface}, {"time": loss / omega}
    effects = {"damping": damping} if viscous else {"material_damping": material}
    stepped, step = steady_amplitudes(scene.with_tables(effects=effects), frequency, 60)
    centred, backward = 1j * np.sin(omega * step) / step, (1 - np.exp(-1j * omega * step)) / step
    factor = 1.0 if viscous else 1 + loss / omega * backward
    square = (loss * omega * viscous * centred - (2 / step * np.sin(omega * step / 2)) ** 2) / factor
    found = transfer_functions(scene, np.sqrt(np.array([square])))[:, 0] / factor
    assert found == pytest.approx(stepped, rel=1e-6)


def test_resonances_that_move_are_extrapolated():
    frequencies, squares = np.linspace(0.5, 3, 40), lambda cells: np.array([1, 4]) * (1 - 3 / cells**2)
    shares = np.array([[1, 0.3], [-0.7, 1], [0.2, 0.5]])

    def responses(cells):
        return shares @ (1 / (squares(cells)[:, None] * (1 + 0.05j) - frequencies**2))

    cells = (4, 5, 6, 7)
    found = extrapolated(cells, [responses(each) for each in cells])
    assert found == pytest.approx(responses(math.inf), rel=1e-3)


@pytest.mark.slow
def test_fits_of_stepped_panels():
    rows = [measured(number) for number in PANELS]
    found = summary(rows)
    assert found["said_inseparable"] == len(rows)
    assert found["rigidity_within"] == len(rows)
    for kind in ("modulus", "damping", "springs"):
        assert found[kind]["within"] == found[kind]["determined"] == found[kind]["numbers"]
    for row in rows:
        assert not row["inseparable"]
        assert max(abs(row["numbers"][key]["value"] / row["numbers"][key]["truth"] - 1) / limit
                   for key, limit in ALLOWED.items() if key in row["numbers"]) < 0.1  # fmt: skip
        assert set(INSEPARABLE) == {key for group in row["told_apart"] for key in group}
