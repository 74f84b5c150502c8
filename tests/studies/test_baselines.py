"""Drives without a search: transfer functions against traces, and the property that defines each drive."""

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate import PlateSolver, SceneError, localize
from warp_plate.plate.weights import REGIONS, region_weights
from warp_plate.studies.baselines import (
    REGULARISATION,
    inverse_filter,
    time_reversal,
    transfer_functions,
)

FREQUENCY = 290.0


@pytest.fixture(scope="module")
def settled_solver():
    """A plate damped so strongly that its transient is over long before the end of the window."""
    return PlateSolver(scene_of(damping=130.0, window=(0.06, 0.1), frequency=FREQUENCY), "cpu")


def test_transfer_functions_agree_with_traces(settled_solver, phasors):
    """u(t) = Re(Σ H_k Z_k exp(iωt)) at a node, over the last whole periods."""
    transfer, drive = transfer_functions(settled_solver), phasors(1, 3)
    ny, nx = transfer.shape[1:]
    width, height = settled_solver.scene.plate.size
    column, row = 4, 7
    point = (width * column / (nx - 1), height * row / (ny - 1))
    run = settled_solver.run(drive, points=[point])
    late = run.trace_times > 0.1 - 4 / FREQUENCY
    steady = transfer[:, row, column] @ drive[0] * np.exp(2j * np.pi * FREQUENCY * run.trace_times[late])
    scale = np.abs(run.trace).max()
    np.testing.assert_allclose(run.trace[0, 0, late], steady.real, atol=2e-3 * scale)


def test_time_reversal_moves_the_middle_of_the_target_most(settled_solver):
    """No drive of the same power moves that point more: the Cauchy-Schwarz inequality becomes an equality."""
    transfer = transfer_functions(settled_solver)
    ny, nx = transfer.shape[1:]
    # The target is the lower left quarter, and its middle the node a quarter of the way along both sides.
    middle, drive = transfer[:, (ny - 1) // 4, (nx - 1) // 4], time_reversal(settled_solver, transfer)
    assert abs(middle @ drive) == pytest.approx(np.linalg.norm(middle) * np.linalg.norm(drive), rel=1e-9)
    assert np.abs(drive).max() == pytest.approx(1)


def test_inverse_filter_solves_the_normal_equations(settled_solver):
    """Minimiser of Σ W|HZ − b|² + λΣ|Z|²."""
    transfer, weights = transfer_functions(settled_solver), region_weights(settled_solver.scene)
    plate, target = (weights[REGIONS.index(name)].ravel() for name in ("plate", "target"))
    field = transfer.reshape(3, -1).T
    largest = np.linalg.svd(field * np.sqrt(plate)[:, None], compute_uv=False)[0]
    normal = field.conj().T @ (plate[:, None] * field) + (REGULARISATION * largest) ** 2 * np.eye(3)
    solution = np.linalg.solve(normal, field.conj().T @ target)
    np.testing.assert_allclose(inverse_filter(settled_solver, transfer), solution / np.abs(solution).max(), rtol=1e-9)


@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        ({"effects": {"stretching": {}}}, "effects.stretching"),
        ({"drive": {"frequency": 290.0, "burst": {"start": 0.0, "duration": 0.005}}}, "drive.burst"),
        ({"drive": {"frequency": 290.0, "chirp": {"end_frequency": 400.0, "duration": 0.01}}}, "drive.chirp"),
        ({"actuators": [{"name": "x", "area": (0.03, 0.06, 0.03, 0.06), "frequency": 200.0}]}, "frequencies differ"),
    ],
)
def test_other_scenes_are_refused_by_name(tables, reason):
    plain = scene_of()
    actuators = [*(actuator.model_dump() for actuator in plain.actuators), *tables.get("actuators", ())]
    with pytest.raises(SceneError, match=reason):
        transfer_functions(PlateSolver(plain.with_tables(**{**tables, "actuators": actuators}), "cpu"))


def test_modes_have_the_baselines_of_time_steps():
    tables = {"damping": 130.0, "window": (0.06, 0.1), "search": {"iterations": 2}, "modal_density": 1.0}
    made = scene_of((27, 27), order=4, load="moments", **tables)
    settings = {"device": "cpu", "baselines": True, "estimate": False, "spectrum": False}
    stepped, by_modes = (localize(made, evaluator=name, **settings).cases for name in ("direct", "modal"))
    for name in ("time_reversal", "inverse_filter"):
        assert by_modes[name].localization_factor == pytest.approx(stepped[name].localization_factor, rel=1e-2)
