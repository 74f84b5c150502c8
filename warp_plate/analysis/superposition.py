"""Motion and energies of a plate under any drive.

If displacements are linear in the drives, 2M runs suffice: with z as in ``solve.response``, the steady motion is
Σ z_a · (motion under unit drive a), and energies are zᵀ matrix z. Otherwise each drive is simulated.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import real_parts
from warp_plate.plate.weights import REGIONS
from warp_plate.resolve import resolve
from warp_plate.result.motion import QUADRANTS, DriveResponse, SteadyMotion, quadrants
from warp_plate.scene.model import Scene
from warp_plate.solve.response import Response, in_float64, measure_response, unit_drives
from warp_plate.solve.run import Progress, Run
from warp_plate.solve.solver import PlateSolver

# Displacements that a motion is fitted to, and multiples of the drive's frequency in it: a linear plate moves at that
# frequency alone, a plate that stretches also at its multiples.
LINEAR_SAMPLES, LINEAR_ORDERS = 12, np.arange(1, 2)
SAMPLES, ORDERS = 32, np.arange(1, 6)
# Regions of ``live_solver``.
LIVE_REGIONS = (*REGIONS, *QUADRANTS)
# A search runs beside the drawing thread, and a search that was ended may still finish a swarm under other settings.
# Solvers have one state, and all solvers of a device share the stream whose graphs are captured.
_SIMULATION = threading.Lock()


@dataclass(frozen=True)
class UnitResponses:
    """Responses to 2M unit drives: 1 on each actuator alone, then −i on each."""

    scene: Scene  # scene
    response: Response  # Gram matrices of the regions
    amplitudes: np.ndarray  # (2M, ny, nx) complex displacements [m per N/m²]
    residual: float  # largest ``SteadyMotion.residual`` of the unit drives
    bound: float  # largest localization factor of any drive
    best_drive: np.ndarray  # (actuators,) phasors of the drive that reaches it [N/m²]

    def energies(self, phasors: np.ndarray) -> np.ndarray:
        """Return (plates, regions) energies [J] of phasors (plates, actuators)."""
        return self.response.energy(phasors)

    def read(self, phasors: np.ndarray) -> DriveResponse:
        """Return the response to one drive (actuators,) [N/m²]."""
        amplitude = np.tensordot(real_parts(phasors[None])[0], self.amplitudes, 1)
        return DriveResponse(
            scene=self.scene,
            phasors=phasors,
            motion=SteadyMotion(LINEAR_ORDERS, amplitude[None], self.residual),
            energy=dict(zip(LIVE_REGIONS, self.energies(phasors[None])[0].tolist(), strict=True)),
            bound=self.bound if math.isfinite(self.bound) else None,
        )


def unit_responses(
    scene: Scene, device: str = "auto", path: str = "auto", progress: Progress | None = None
) -> UnitResponses:
    """Simulate the unit drives, in float64 because small differences of energies matter.

    The path "modal" takes the modes of the plate.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    solver = live_solver(in_float64(scene), device, path)
    response = solver.response if isinstance(solver, ModalSolver) else measure_response(solver, progress)
    units = unit_drives(len(scene.actuators))[: 2 * len(scene.actuators)]
    times = last_period(scene, solver.discretization.time_step, LINEAR_SAMPLES)
    motions = motions_of(solver.run(units, times), scene, LINEAR_ORDERS)
    return UnitResponses(
        scene=scene,
        response=response,
        amplitudes=np.concatenate([motion.amplitudes for motion in motions]),
        residual=float(np.max([motion.residual for motion in motions])),
        bound=response.bound(),
        best_drive=response.best_drive(),
    )


class SimulatedResponses:
    """Responses of a scene that is not linear in its drives; each is a run, and no bound is known.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """

    def __init__(self, scene: Scene, device: str, path: str) -> None:
        self.scene = scene
        with _SIMULATION:
            self.solver = live_solver(scene, device, path)

    def energies(self, phasors: np.ndarray) -> np.ndarray:
        """Return (plates, regions) energies [J] of phasors (plates, actuators)."""
        with _SIMULATION:
            return self.solver.run(phasors).energy

    def read(self, phasors: np.ndarray) -> DriveResponse:
        """Return the response to one drive (actuators,) [N/m²]."""
        times = last_period(self.scene, self.solver.discretization.time_step, SAMPLES)
        with _SIMULATION:
            run = self.solver.run(phasors[None], times)
        energy = dict(zip(run.regions, run.energy[0].tolist(), strict=True))
        return DriveResponse(self.scene, phasors, motions_of(run, self.scene, ORDERS)[0], energy, None)


def live_solver(scene: Scene, device: str, path: str) -> PlateSolver | ModalSolver:
    """Return a solver that also sums the energies of the plate's quadrants."""
    return resolve(scene, device, purpose="replay", path=path).solver(areas=quadrants(scene.plate.size))


def last_period(scene: Scene, time_step: float, samples: int) -> list[float]:
    """Return times [s] spread evenly over the last period of the drive, at least a time step apart if possible."""
    end = math.floor(scene.window.end / time_step) * time_step
    span = min(max(1 / scene.drive.frequency, samples * time_step), end)
    times: list[float] = (end - span * np.arange(samples) / samples).tolist()
    return times


def motions_of(run: Run, scene: Scene, orders: np.ndarray) -> list[SteadyMotion]:
    """Fit the motion of each plate of a run at these multiples of the drive's frequency, by least squares.

    A straight line in time is fitted besides, which takes up the slow decay of low modes.
    """
    angles = scene.drive_angular_frequency * np.outer(run.times, orders)
    drift = np.stack([np.ones(run.times.size), run.times / run.times.max() - 1], axis=1)
    columns = np.concatenate([np.cos(angles), -np.sin(angles), drift], axis=1)
    fields = run.displacement
    parts = np.tensordot(np.linalg.pinv(columns), fields, (1, 1)).swapaxes(0, 1)[:, : 2 * orders.size]
    rest = fields - np.tensordot(columns[:, : 2 * orders.size], parts, (1, 1)).swapaxes(0, 1)
    all_squares, rest_squares = ((field**2).sum(axis=(1, 2, 3)) for field in (fields, rest))
    residuals = np.sqrt(rest_squares / np.where(all_squares > 0, all_squares, 1))
    real, imaginary = np.split(parts, 2, axis=1)  # (plates, orders, ny, nx)
    return [
        SteadyMotion(orders, amplitudes, float(residual))
        for amplitudes, residual in zip(real + 1j * imaginary, residuals, strict=True)
    ]
