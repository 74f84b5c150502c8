"""The drives that the haptics field takes without a search: a single actuator, time reversal, an inverse filter.

With H_k(x) the displacement at x of the steady motion under actuator k alone, of unit magnitude, as a phasor:

- time reversal to the middle x₀ of the target: Z_k = conj H_k(x₀). At one frequency, turning a signal round in time is
  taking the conjugate, and all that actuators send then arrives at x₀ in phase. (M. Fink, IEEE Trans. UFFC 39(5), 1992;
  on a plate for touch: M. R. Bai, Y. K. Tsai, J. Acoust. Soc. Am. 129, 2011; C. Hudin, J. Lozada, V. Hayward, IEEE
  Trans. Haptics 8(2), 2015.)
- inverse filter: b is what should be, one in the target and zero elsewhere, at every node of the grid, and
  Z = (HᴴWH + λ1)⁻¹ HᴴW b minimises Σ W|HZ − b|² + λΣ|Z|², W being the nodes' areas. (L. Pantera, C. Hudin, IEEE Trans.
  Haptics 13(3), 2020, whose control points are the nodes here; the regularisation is Tikhonov's.)

Both are steady drives of one frequency. A burst's own time reversal is a signal of its own for each actuator, and a
scene has one for all of them: there is none here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warp_plate.analysis.superposition import LINEAR_ORDERS, LINEAR_SAMPLES, last_period, motions_of
from warp_plate.plate.discretization import discretize
from warp_plate.plate.signals import carrier_frequencies
from warp_plate.plate.weights import REGIONS, bilinear, localization_factor, region_weights
from warp_plate.problem.evaluate_cases import cases_from_run, evaluate_objectives
from warp_plate.problem.objectives import make_objectives
from warp_plate.result.model import Result
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.peak import record_times
from warp_plate.solve.response import Response
from warp_plate.solve.solver import PlateSolver

# For people, in the order of a table.
BASELINES = {
    "single": "best single actuator",
    "time_reversal": "time reversal to the target's middle",
    "inverse_filter": "regularised inverse filter",
}
# The square root of λ, in parts of the largest singular value of √W H: a combination of actuators that moves the plate
# less than this part of the most effective one is damped, not called for in full.
REGULARISATION = 0.1


def baselines(solver: PlateSolver, response: Response) -> dict[str, np.ndarray]:
    """By the names in BASELINES, a drive (actuators,) each, of largest magnitude one.

    solver: of a scene whose steady motion is linear in its drives and has one frequency; response: its energies.

    Raises:
        SceneError: the scene is another one; one line that says why.
    """
    transfer = transfer_functions(solver)
    units = np.eye(len(transfer), dtype=complex)
    single = int(np.argmax(np.nan_to_num(localization_factor(response.energy(units)), nan=-1.0)))
    found = (units[single], time_reversal(solver.scene, transfer), inverse_filter(solver.scene, transfer))
    return dict(zip(BASELINES, found, strict=True))


def with_baselines(result: Result, device: str = "auto", path: str = "auto") -> Result:
    """The result of ``localize`` with a case for each of BASELINES beside its own; without them where Ctrl-C comes.

    Raises:
        SceneError: see ``why_none``.
    """
    scene, shown = result.scene, list(BASELINES)[1:]
    try:
        discretization = discretize(scene)
        solver = PlateSolver(discretization, device, path, areas=make_objectives(discretization).regions)
        transfer = transfer_functions(solver)
        drives = dict(zip(shown, (time_reversal(scene, transfer), inverse_filter(scene, transfer)), strict=True))
        run = solver.run(np.array(list(drives.values())), record_times(scene), scene.record.points)
    except KeyboardInterrupt:  # a search is not lost for want of what it is compared with
        return result
    cases = cases_from_run(drives, run)
    worth, more = evaluate_objectives(scene, cases, device, path)
    return replace(
        result,
        cases={**result.cases, **cases},
        objective_values_by_case={**result.objective_values_by_case, **worth},
        node_steps=result.node_steps + solver.node_steps + more,
    )


def check_baselines(scene: Scene) -> None:
    """Refuse a scene without such drives, before it is searched.

    Raises:
        SceneError: see ``why_none``.
    """
    reason = why_none(scene)
    if reason is not None:
        raise SceneError(f"baselines: {reason}; time reversal and inverse filter need one frequency and linear drives")


def why_none(scene: Scene) -> str | None:
    """Why a scene has no such drives, for people; None where it has."""
    if not scene.linear:
        return f"{scene.nonlinear_table} is not linear in the drives"
    for key in ("signal", "chirp", "burst"):
        if getattr(scene.drive, key) is not None:
            return f"drive.{key} is no steady drive of one frequency"
    if len(carrier_frequencies(scene)) > 1:
        return "the actuators' frequencies differ"
    return None


def transfer_functions(solver: PlateSolver) -> np.ndarray:
    """(actuators, ny, nx) complex displacements H [m per N/m²] in the last period of the run, Re(H Z exp(iωt)).

    Raises:
        SceneError: see ``why_none``.
    """
    scene = solver.scene
    check_baselines(scene)
    (frequency,) = carrier_frequencies(scene)
    # ``superposition`` reads the drive's frequency, which here is that of all actuators.
    tone = scene.model_copy(update={"drive": scene.drive.model_copy(update={"frequency": frequency})})
    times = last_period(tone, solver.specialized.scheme.time_step, LINEAR_SAMPLES)
    count = len(scene.actuators)
    run = solver.run(np.concatenate([np.eye(count), -1j * np.eye(count)]), times)
    motions = np.stack([motion.amplitudes[0] for motion in motions_of(run, tone, LINEAR_ORDERS)])
    # Z = −i moves the plate by −iH: the mean of both takes out half of what is left of the start.
    transfer: np.ndarray = (motions[:count] + 1j * motions[count:]) / 2
    return transfer


def time_reversal(scene: Scene, transfer: np.ndarray) -> np.ndarray:
    """(actuators,) the drive that focuses on the middle of the target's area; transfer: (actuators, ny, nx)."""
    target = region_weights(scene)[REGIONS.index("target")]
    (width, height), (ny, nx) = scene.plate.size, target.shape
    x, y = (np.linspace(0, side, count) for side, count in ((width, nx), (height, ny)))
    middle = (float(target.sum(axis=0) @ x / target.sum()), float(target.sum(axis=1) @ y / target.sum()))
    corners, shares = bilinear([middle], scene.grid.nodes, scene.plate.size)
    rows, columns = corners[0].T
    return _of_largest_one((transfer[:, rows, columns] @ shares[0]).conj())


def inverse_filter(scene: Scene, transfer: np.ndarray) -> np.ndarray:
    """(actuators,) the drive whose motion is nearest to one in the target and zero elsewhere, for its size; transfer:
    (actuators, ny, nx)."""
    plate, target = (region_weights(scene)[REGIONS.index(name)] for name in ("plate", "target"))
    weight = np.sqrt(np.maximum(plate, 0)).ravel()
    wanted = (target / np.where(plate > 0, plate, 1)).ravel()
    matrix = (transfer.reshape(len(transfer), -1) * weight).T
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    if not values[0] > 0:
        return _of_largest_one(np.zeros(len(transfer), dtype=complex))
    filtered = values / (values**2 + (REGULARISATION * values[0]) ** 2)
    return _of_largest_one(right.conj().T @ (filtered * (left.conj().T @ (weight * wanted))))


def _of_largest_one(drive: np.ndarray) -> np.ndarray:
    """The drive scaled; all zero where nothing moves."""
    largest = np.abs(drive).max()
    return drive / largest if largest > 0 else drive
