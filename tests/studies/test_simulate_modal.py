"""Simulation by modes, against time steps and the steady state."""

import math

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate.modal.energies import ModalEnergies
from warp_plate.modal.modes import solve_modes
from warp_plate.studies.simulate import simulate

BURST = {"frequency": 290.0, "burst": {"start": 0.001, "duration": 0.008, "ramp": 0.003}}
RECORD = {"times": [0.006, 0.012], "points": [(0.05, 0.1), (0.1, 0.15)]}


def test_modal_result_is_that_of_fine_steps():
    grid = {"nodes": (41, 41), "order": 4, "load": "moments", "precision": "float64"}
    scene = scene_of(damping=88.0, drive=BURST, record=RECORD).with_tables(grid=grid)
    modal, stepped = (simulate(scene, device="cpu", path=path, estimate=False) for path in ("modal", "auto"))
    cases = modal.cases["drive"], stepped.cases["drive"]
    assert modal.by_modes
    assert not stepped.by_modes
    assert np.array_equal(modal.trace_times, stepped.trace_times)
    assert modal.times == pytest.approx(stepped.times, rel=1e-2)
    assert cases[0].energy == pytest.approx(cases[1].energy, rel=3e-3)
    assert np.allclose(cases[0].trace, cases[1].trace, rtol=0, atol=5e-3 * np.abs(cases[1].trace).max())
    late = cases[0].displacement[1]
    assert late.shape == (41, 41)
    assert late[20, 10] == pytest.approx(np.interp(0.012, modal.trace_times, cases[0].trace[0]), rel=1e-3)
    assert modal.peak_displacement == pytest.approx(stepped.peak_displacement, rel=0.02)


def test_loss_factor_is_simulated_by_modes_without_asking():
    """The trace turns as exp(iωt) from t = 0 on."""
    scene = scene_of(effects={"loss_factor": {"eta": 0.05}}, record={"points": [(0.05, 0.1)]})
    result = simulate(scene, device="cpu")
    assert result.by_modes
    assert result.effects == ("loss factor",)
    trace, times = result.cases["drive"].trace[0], result.trace_times
    angle = 2 * math.pi * 290.0 * times
    basis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    fitted = basis @ np.linalg.lstsq(basis, trace, rcond=None)[0]
    assert np.allclose(fitted, trace, rtol=0, atol=1e-5 * np.abs(trace).max())


def test_moving_load_presses_beside_the_actuators():
    load = {"force": 0.01, "start": (0.0, 0.05), "velocity": (12.0, 3.0), "size": 0.02}
    scene = scene_of(effects={"damping": {"viscous": 88.0}, "moving_load": load})
    result = simulate(scene, device="cpu", path="modal", drive="equal", estimate=False)
    plate = solve_modes(scene)
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    expected = ModalEnergies(plate, regions).scene_values(np.array([[1, 1, 1], [0, 0, 0]]))
    assert list(result.cases["drive"].energy.values()) == pytest.approx(expected[0], rel=1e-9)
    assert (expected[1] > 1e-3 * expected[0]).all()
