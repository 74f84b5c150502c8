"""Coils in motion from rest, by modes: against one system of first order with the currents, and the steady state."""

import math

import numpy as np
import pytest
import scipy

from support.coils import LOSSLESS_COILS, first_order_system, panel
from warp_plate.modal.coils_in_time import in_time
from warp_plate.modal.energies import ModalEnergies
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.motion import modal_motion, trace
from warp_plate.plate.designs import scene_phasors

TIMES = np.linspace(0.0, 0.03, 61)
POINTS = [(0.03, 0.1), (0.14, 0.05)]


def first_order(plate, omega, phasors):
    """Return displacements (points, times) of the first-order system under Re(Z exp(iωt)).

    The tone is a further part of the state, so that the matrix exponential is exact.
    """
    matrix, columns = first_order_system(plate)
    driven, count = columns @ phasors, len(matrix)
    whole = np.zeros((count + 2, count + 2))
    whole[:count, :count], whole[:count, count:] = matrix, np.stack([driven.real, -driven.imag], axis=1)
    whole[count:, count:] = [[0, -omega], [omega, 0]]  # cos ωt, sin ωt
    state, step = np.zeros(count + 2), scipy.linalg.expm(whole * (TIMES[1] - TIMES[0]))
    state[count] = 1.0
    shapes, found = plate.at_points(POINTS).T, np.zeros((len(POINTS), len(TIMES)))
    for n in range(1, len(TIMES)):
        state = step @ state
        found[:, n] = shapes @ state[: len(plate.frequencies)]
    return found


def test_motion_from_rest_is_that_of_one_system_of_first_order():
    """With and without inductance, by voltage and by current, with all three magnets."""
    made = panel(LOSSLESS_COILS)
    plate = solve_modes(made, 50.0)
    plate = plate.part(np.arange(40))
    found = trace(in_time(plate), scene_phasors(made)[None], POINTS, TIMES)[0]
    expected = first_order(plate, 2 * math.pi * 290.0, scene_phasors(made))
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_motion_from_rest_becomes_the_steady_one():
    rows = [{**row, "magnet": None, "magnet_mass": None} for row in LOSSLESS_COILS[:1]]
    made = panel(rows)
    alone = solve_modes(made).part(np.arange(60))
    times = np.linspace(1.5, 1.51, 21)
    found = trace(in_time(alone), scene_phasors(made)[None], POINTS, times)[0]
    steady = alone.at_points(POINTS).T @ alone.respond_to_drive(np.array([290.0]), scene_phasors(made))[0, :, 0]
    expected = (steady[:, None] * np.exp(2j * math.pi * 290.0 * times)).real
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("burst", [False, True])
def test_energies_are_means_over_the_window(burst):
    made = panel(LOSSLESS_COILS).with_tables(window={"start": 0.005, "end": 0.02})
    if burst:
        made = made.with_tables(drive={"frequency": 290.0, "burst": {"duration": 0.012, "ramp": 0.003}})
    plate, phasors = in_time(solve_modes(made, 290.0).part(np.arange(60))), scene_phasors(made)
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(made.target)]
    energies = ModalEnergies(plate, regions).scene_values(phasors[None])[0]
    nodes, weights = np.polynomial.legendre.leggauss(1200)
    rates = modal_motion(plate, phasors[None], 0.0125 + 0.0075 * nodes, velocity=True)[:, 0]
    expected = [(rates * (region @ rates)).sum(axis=0) @ weights / 4 for region in regions]
    np.testing.assert_allclose(energies, expected, rtol=1e-5)


def test_slopes_by_the_drive_are_difference_quotients():
    made = panel(LOSSLESS_COILS).with_tables(window={"start": 0.005, "end": 0.02})
    plate, phasors = in_time(solve_modes(made, 290.0).part(np.arange(60))), scene_phasors(made)
    energies = ModalEnergies(plate, [plate.kinetic_matrix(), plate.kinetic_matrix(made.target)])
    setting = np.full((1, 4), 290.0), np.array([[row.box for row in made.actuators]]), np.zeros((1, 4))
    slopes = energies.slopes(phasors[None], *setting)
    np.testing.assert_allclose(slopes.energy[0], energies.scene_values(phasors[None])[0], rtol=1e-4)
    step = 1e-4
    for index in range(4):
        ends = [energies.values((phasors + side * step * np.eye(4)[index])[None], *setting)[0] for side in (1, -1)]
        quotient = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(slopes.drives[0][:, index], quotient, rtol=1e-4)
