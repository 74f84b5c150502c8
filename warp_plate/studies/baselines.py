"""Drives that the haptics field uses without a search: a single actuator, time reversal, and an inverse filter.

With H_k(x) the phasor of the steady displacement at x under actuator k alone, driven with unit magnitude:

- Time reversal to the middle x₀ of the target: Z_k = conj H_k(x₀). At one frequency, reversing a signal in time is
  taking the conjugate, and the waves of all actuators arrive at x₀ in phase. (M. Fink, IEEE Trans. UFFC 39(5), 1992; on
  a plate for touch: M. R. Bai, Y. K. Tsai, J. Acoust. Soc. Am. 129, 2011; C. Hudin, J. Lozada, V. Hayward, IEEE Trans.
  Haptics 8(2), 2015.)
- Inverse filter: with b the desired displacement, one in the target and zero elsewhere, at every node of the grid,
  Z = (HᴴWH + λ1)⁻¹ HᴴW b minimises Σ W|HZ − b|² + λΣ|Z|², where W are the nodes' areas. (L. Pantera, C. Hudin, IEEE
  Trans. Haptics 13(3), 2020; their control points are the nodes here, with Tikhonov regularisation.)

Both are steady drives of one frequency. The time reversal of a burst, a waveform for each actuator, is not among them.
"""

from collections.abc import Sequence

import numpy as np

from warp_plate.analysis.motion import last_period, steady_motions
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.signals import carrier_frequencies
from warp_plate.plate.weights import REGIONS, bilinear, node_positions
from warp_plate.problem.design_variables import magnitude_unit
from warp_plate.problem.evaluate_cases import cases_from_run
from warp_plate.problem.problem import Problem
from warp_plate.result.case import Case
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.run import run_with_peaks
from warp_plate.solve.solver import PlateSolver

# √λ relative to the largest singular value of √W H: combinations of actuators that move the plate less than this part
# of the most effective one are damped.
REGULARISATION = 0.1


def baseline_cases(problem: Problem, recorded: Sequence[float]) -> tuple[dict[str, Case], int]:
    """Simulate the baselines of a problem's scene, recorded at times [s]; return their cases by name, and the
    node-steps."""
    solver = problem.resolved.solver(areas=problem.objectives.regions)
    transfer = transfer_functions(solver)
    phasors = {"time_reversal": time_reversal(solver, transfer), "inverse_filter": inverse_filter(solver, transfer)}
    run, peaks = run_with_peaks(solver, np.array(list(phasors.values())), recorded=recorded)
    return cases_from_run(phasors, run, solver.discretization, peaks), solver.node_steps


def check_baselines(scene: Scene) -> None:
    """Check that a scene has baselines: its drive has one frequency, and its motion is linear in the drives."""
    reasons = [] if scene.linear else [f"{scene.nonlinear_table} is not linear in the drives"]
    for key in ("signal", "chirp", "burst"):
        if getattr(scene.drive, key) is not None:
            reasons.append(f"drive.{key} is not a steady drive of one frequency")
    if not reasons and len(carrier_frequencies(scene)) > 1:
        reasons.append("the actuators' frequencies differ")
    if reasons:
        needed = "time reversal and inverse filter need one frequency and linear drives"
        raise SceneError(f"baselines: {reasons[0]}; {needed}")


def transfer_functions(solver: PlateSolver | ModalSolver) -> np.ndarray:
    """Return the complex displacements (actuators, ny, nx) H [m per N/m²] in the last period, Re(H Z exp(iωt))."""
    scene = solver.scene
    check_baselines(scene)
    (frequency,) = carrier_frequencies(scene)
    # ``steady_motions`` reads the frequency of the drive, which the actuators may override.
    tone = scene.with_keys("drive", frequency=frequency)
    times = last_period(tone, solver.discretization.time_step)
    count = len(scene.actuators)
    run = solver.run(np.concatenate([np.eye(count), -1j * np.eye(count)]), times)
    motions = np.stack([motion.amplitude for motion in steady_motions(run, tone)])
    # The drive Z = −i yields −iH; the mean of both halves the remaining transient.
    return np.asarray((motions[:count] + 1j * motions[count:]) / 2)


def time_reversal(solver: PlateSolver | ModalSolver, transfer: np.ndarray) -> np.ndarray:
    """Return the phasors (actuators,) that focus on the centroid of the target, from (actuators, ny, nx) H."""
    scene = solver.scene
    target = solver.discretization.region_weights[REGIONS.index("target")]
    x, y = node_positions(scene)
    middle = (float(target.sum(axis=0) @ x / target.sum()), float(target.sum(axis=1) @ y / target.sum()))
    corners, shares = bilinear([middle], scene.grid.nodes, scene.plate.size)
    rows, columns = corners[0].T
    return _scaled(scene, (transfer[:, rows, columns] @ shares[0]).conj())


def inverse_filter(solver: PlateSolver | ModalSolver, transfer: np.ndarray) -> np.ndarray:
    """Return the phasors (actuators,) with the motion closest to one in the target and zero elsewhere."""
    scene, weights = solver.scene, solver.discretization.region_weights
    plate, target = (weights[REGIONS.index(name)] for name in ("plate", "target"))
    weight = np.sqrt(np.maximum(plate, 0)).ravel()
    desired = (target / np.where(plate > 0, plate, 1)).ravel()
    matrix = (transfer.reshape(len(transfer), -1) * weight).T
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    if not values[0] > 0:
        return np.zeros(len(transfer), dtype=complex)
    filtered = values / (values**2 + (REGULARISATION * values[0]) ** 2)
    return _scaled(scene, right.conj().T @ (filtered * (left.conj().T @ (weight * desired))))


def _scaled(scene: Scene, phasors: np.ndarray) -> np.ndarray:
    """Return phasors scaled to the largest magnitude of the scene; all zero where nothing moves."""
    largest = np.abs(phasors).max()
    return phasors / largest * magnitude_unit(scene) if largest > 0 else phasors
