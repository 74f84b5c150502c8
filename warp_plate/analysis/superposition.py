"""A plate's motion and energies under any drive, at once, from the responses to unit drives.

Where displacements are linear in the drives, 2M runs hold them all: with z as in ``solve.response``, the steady motion
is Σ z_a · (motion under unit a), and energies are zᵀ matrix z. Where they are not, each drive is simulated.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import numpy as np

from warp_plate.optimize.quadratic import real_parts
from warp_plate.result.live import DriveResponse, SteadyMotion, quadrants
from warp_plate.scene.model import Scene
from warp_plate.solve.response import Response, measure_response, unit_drives
from warp_plate.solve.run import Run
from warp_plate.solve.solver import PlateSolver, Progress

# Displacements from which the motion is taken, and multiples of the drive's frequency: a linear plate moves at that
# frequency alone, one that stretches at its multiples as well.
LINEAR_SAMPLES, LINEAR_ORDERS = 12, np.arange(1, 2)
SAMPLES, ORDERS = 32, np.arange(1, 6)
# A search asks beside whoever draws, and an ended one may still be at its last swarm under other settings; but a solver
# has one state, and all solvers on a device queue on the same stream, of which graphs are captured.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class UnitResponses:
    """Responses to 2M unit drives, 1 on each actuator alone and then −i on each.

    scene: the one simulated; response: Gram matrices of ``regions``; amplitudes: (2M, ny, nx) complex [m per N/m²];
    residual: see :class:`SteadyMotion`, the largest of the units.
    """

    scene: Scene
    response: Response
    regions: tuple[str, ...]
    amplitudes: np.ndarray
    residual: float
    bound: float
    best_drive: np.ndarray

    def energies(self, drives: np.ndarray) -> np.ndarray:
        """(plates, regions) energies [J] of drives (plates, actuators)."""
        return self.response.energy(drives)

    def read(self, drive: np.ndarray) -> DriveResponse:
        """The plate under one drive (actuators,) [N/m²]."""
        amplitude = np.tensordot(real_parts(drive[None])[0], self.amplitudes, 1)
        return DriveResponse(
            scene=self.scene,
            phasors=drive,
            motion=SteadyMotion(LINEAR_ORDERS, amplitude[None], self.residual),
            energy=dict(zip(self.regions, self.energies(drive[None])[0].tolist(), strict=True)),
            bound=self.bound if math.isfinite(self.bound) else None,
        )


def unit_responses(
    scene: Scene, device: str = "auto", path: str = "auto", progress: Progress | None = None
) -> UnitResponses:
    """Simulate the unit drives, in float64, for small differences of energies count.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    grid = scene.grid.model_copy(update={"precision": "float64"})
    exact = scene.model_copy(update={"grid": grid})
    solver = live_solver(exact, device, path)
    response = measure_response(solver, progress)
    units = unit_drives(len(scene.actuators))[: 2 * len(scene.actuators)]
    times = last_period(scene, solver.specialized.scheme.time_step, LINEAR_SAMPLES)
    motions = motions_of(solver.run(units, times), scene, LINEAR_ORDERS)
    return UnitResponses(
        scene=scene,
        response=response,
        regions=solver.specialized.regions,
        amplitudes=np.concatenate([motion.amplitudes for motion in motions]),
        residual=float(np.max([motion.residual for motion in motions])),
        bound=response.bound(),
        best_drive=response.best_drive(),
    )


@dataclass(frozen=True)
class SimulatedResponses:
    """The same for a scene that is not linear in its drives: each is a run of its own, and no bound is claimed."""

    scene: Scene
    solver: PlateSolver

    def energies(self, drives: np.ndarray) -> np.ndarray:
        """(plates, regions) energies [J] of drives (plates, actuators)."""
        with _ONE_AT_A_TIME:
            return self.solver.run(drives).energy

    def read(self, drive: np.ndarray) -> DriveResponse:
        """The plate under one drive (actuators,) [N/m²]."""
        times = last_period(self.scene, self.solver.specialized.scheme.time_step, SAMPLES)
        with _ONE_AT_A_TIME:
            run = self.solver.run(drive[None], times)
        energy = dict(zip(run.regions, run.energy[0].tolist(), strict=True))
        return DriveResponse(self.scene, drive, motions_of(run, self.scene, ORDERS)[0], energy, None)


def simulated_responses(scene: Scene, device: str, path: str) -> SimulatedResponses:
    """What simulates a scene drive by drive.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    with _ONE_AT_A_TIME:
        return SimulatedResponses(scene, live_solver(scene, device, path))


def live_solver(scene: Scene, device: str, path: str) -> PlateSolver:
    """One that sums the energy of the plate's quadrants too."""
    return PlateSolver(scene, device, path, areas=quadrants(scene.plate.size))


def last_period(scene: Scene, time_step: float, samples: int) -> list[float]:
    """Times [s] spread evenly over the last period of the drive in the run, or over so many steps where these last
    longer."""
    end = math.floor(scene.window.end / time_step) * time_step
    span = min(max(1 / scene.drive.frequency, samples * time_step), end)
    times: list[float] = (end - span * np.arange(samples) / samples).tolist()
    return times


def motions_of(run: Run, scene: Scene, orders: np.ndarray) -> list[SteadyMotion]:
    """The motion of each plate of a run at these multiples of the drive's frequency, by least squares over its times.

    What drifts meanwhile, a low mode that dies out slowly, is fitted beside it by a straight line in time.
    """
    angles = scene.drive_angular_frequency * np.outer(run.times, orders)
    drift = np.stack([np.ones(run.times.size), run.times / run.times.max() - 1], axis=1)
    columns = np.concatenate([np.cos(angles), -np.sin(angles), drift], axis=1)
    fields = run.displacement
    parts = np.tensordot(np.linalg.pinv(columns), fields, (1, 1)).swapaxes(0, 1)[:, : 2 * orders.size]
    left = fields - np.tensordot(columns[:, : 2 * orders.size], parts, (1, 1)).swapaxes(0, 1)
    whole, rest = ((field**2).sum(axis=(1, 2, 3)) for field in (fields, left))
    residual = np.sqrt(rest / np.where(whole > 0, whole, 1))
    real, imaginary = np.split(parts, 2, axis=1)  # (plates, orders, ny, nx)
    return [
        SteadyMotion(orders, amplitudes, float(share))
        for amplitudes, share in zip(real + 1j * imaginary, residual, strict=True)
    ]
