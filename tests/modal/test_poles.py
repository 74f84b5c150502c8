"""Poles of damped plates, against the plate's matrices."""

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate.modal.modes import solve_modes

SIZE = (0.2, 0.15)
DAMPER = {"area": (0.05, 0.09, 0.03, 0.06), "mass": 2e-3, "stiffness": 80.0, "damping": 0.3}
EFFECTS = {
    "none": {},
    "viscous": {"damping": {"viscous": 40.0}},
    "material": {"material_damping": {"time": 2e-5}, "tension": {"x": 30.0}},
    "damper": {"damping": {"viscous": 5.0}, "oscillators": [DAMPER]},
}


def sides(plate, poles, sigma):
    """Return Σ ψχ/(σ − s) and (σ² + σC + Λ)⁻¹ of the lowest modes; those beyond are taken as uncoupled."""
    size = len(plate.frequencies)
    series = (poles.vectors / (sigma - poles.values)) @ poles.inputs
    exact = np.linalg.inv(sigma**2 * np.eye(size) + sigma * plate.damping + np.diag(plate.angular_frequencies**2))
    return series[:30, :30], exact[:30, :30]


@pytest.mark.parametrize("name", EFFECTS)
def test_transfer_matrix(name):
    scene = scene_of(size=SIZE, edges=("clamped", "supported", "free", "clamped"), effects=EFFECTS[name])
    plate = solve_modes(scene, highest=100.0, density=0.5)
    assert plate.proportional == (name in ("none", "viscous"))
    poles = plate.poles(0.1)
    for sigma in (120.0, -3 + 900j, 40 - 2500j):
        series, exact = sides(plate, poles, sigma)
        assert np.allclose(series, exact, rtol=0, atol=1e-5 * np.abs(exact).max())


def test_rigid_motions():
    plate = solve_modes(scene_of(size=SIZE, edges=("free",) * 4, effects=EFFECTS["viscous"]))
    assert np.count_nonzero(plate.frequencies == 0) == 3
    series, exact = sides(plate, plate.poles(0.1), 20 + 300j)
    assert np.allclose(series, exact, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_dampers_on_patches_respond_as_the_matrices_do():
    """(K + iωC − ω²M) u = f over the splines themselves, without modes."""
    scene = scene_of(size=SIZE, edges=("clamped", "free", "supported", "free"), effects=EFFECTS["damper"])
    plate, omega = solve_modes(scene), 2 * np.pi * 170.0
    matrices = [getattr(plate.galerkin, name).toarray() for name in ("stiffness", "damping", "mass")]
    load = plate.galerkin.mass @ plate.vectors @ plate.actuator_forces()
    direct = np.linalg.solve(matrices[0] + 1j * omega * matrices[1] - omega**2 * matrices[2], load)
    modal = plate.vectors @ plate.respond(np.array([170.0]), plate.actuator_forces())[0]
    assert np.allclose(modal, direct, rtol=0, atol=1e-6 * np.abs(direct).max())
    others = np.array([[170.0, 40.0, 290.0], [170.0, 170.0, 170.0]])
    each = plate.respond_each(others, plate.actuator_forces()[None])
    for row, column in ((0, 0), (1, 0), (1, 1), (1, 2)):
        assert np.allclose(
            plate.vectors @ each[row, :, column], direct[:, column], rtol=0, atol=1e-6 * abs(direct).max()
        )
    at_40 = plate.respond(np.array([40.0]), plate.actuator_forces())[0, :, 1]
    assert np.allclose(each[0, :, 1], at_40, rtol=0, atol=1e-6 * np.abs(at_40).max())


def test_loss_factor_leaves_tension_without_loss():
    """H = η B: with D∇⁴ alone lossy, a supported mode has the loss factor η B/K."""
    effects = {"loss_factor": {"eta": 0.02}, "tension": {"x": 60.0, "y": 20.0}}
    scene = scene_of(size=SIZE, edges=("supported",) * 4, effects=effects)
    plain = solve_modes(scene_of(size=SIZE, edges=("supported",) * 4)).frequencies[0]
    plate = solve_modes(scene)
    share = (plain / plate.frequencies[0]) ** 2
    assert plate.loss_factors[0] == pytest.approx(0.02 * share, rel=1e-8)
    assert plate.damping_ratios[0] == pytest.approx(0.01 * share, rel=1e-8)


def test_damping_of_each_mode():
    """The last ratio of a list holds for all higher modes."""
    effects = {"modal_damping": {"ratio": [0.01, 0.03, 0.005]}}
    plate = solve_modes(scene_of(size=SIZE, effects=effects))
    assert plate.damping_ratios[:5] == pytest.approx([0.01, 0.03, 0.005, 0.005, 0.005])
    omega = plate.angular_frequencies
    assert np.diag(plate.damping)[:2] == pytest.approx([0.02 * omega[0], 0.06 * omega[1]])
