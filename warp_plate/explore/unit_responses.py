"""Motion and energies of a linear plate under any drive, from its responses to unit drives.

Displacements are linear in the drives, so that 2M runs suffice: with z as in ``solve.response``, the steady motion is
Σ z_a · (motion under unit drive a), and energies are zᵀ matrix z.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from warp_plate.analysis.motion import last_period, steady_motions
from warp_plate.modal.radiation import WeightedSound
from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import real_parts
from warp_plate.plate.weights import REGIONS
from warp_plate.problem.requirements import make_requirements
from warp_plate.problem.specified_drives import Tone
from warp_plate.resolve import resolve
from warp_plate.result.motion import QUADRANTS, DriveResponse, SteadyMotion, quadrants
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.specification import Allowance, Level, Specification
from warp_plate.solve.response import Response, measure_response, unit_drives
from warp_plate.solve.run import Progress
from warp_plate.solve.solver import PlateSolver

# Specification whose regions are the target and all the rest, in place of a missing one.
WHOLE_PLATE = Specification(level=Level(acceleration_g=1.0), elsewhere=Allowance(relative_db=0.0), tolerance={})


@dataclass(frozen=True)
class UnitResponses:
    """Responses to 2M unit drives: 1 on each actuator alone, then −i on each."""

    scene: Scene  # scene
    response: Response  # Gram matrices of the regions
    amplitudes: np.ndarray  # (2M, ny, nx) complex displacements [m per N/m²]
    residual: float  # largest ``SteadyMotion.residual`` of the unit drives
    bound: float  # largest localization factor of any drive
    best_drive: np.ndarray  # (actuators,) phasors of the drive that reaches it [N/m²]
    accelerations: Mapping[str, np.ndarray]  # by region (points, actuators) accelerations [m/s² per N/m²]
    sound: np.ndarray | None  # (rows, actuators) F of the A-weighted sound power ½ ‖F z‖² [W]; None by time steps

    def read(self, phasors: np.ndarray) -> DriveResponse:
        """Return the response to one drive (actuators,) [N/m²]."""
        amplitude = np.tensordot(real_parts(phasors[None])[0], self.amplitudes, 1)
        peaks = {name: np.abs(rows @ phasors) for name, rows in self.accelerations.items()}
        return DriveResponse(
            scene=self.scene,
            phasors=phasors,
            motion=SteadyMotion(amplitude, self.residual),
            energy=dict(zip((*REGIONS, *QUADRANTS), self.response.energy(phasors[None])[0].tolist(), strict=True)),
            bound=self.bound if math.isfinite(self.bound) else None,
            levels={name: (float(values.min()), float(values.max())) for name, values in peaks.items()},
            sound_power=None if self.sound is None else float(np.linalg.norm(self.sound @ phasors)) ** 2 / 2,
        )


def unit_responses(
    scene: Scene, device: str = "auto", path: str = "auto", progress: Progress | None = None
) -> UnitResponses:
    """Simulate the unit drives, in float64 because small differences of energies matter.

    The path "modal" takes the modes of the plate.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    specification = scene.specification or WHOLE_PLATE
    solver = live_solver(scene.in_float64().model_copy(update={"specification": specification}), device, path)
    response = solver.response if isinstance(solver, ModalSolver) else measure_response(solver, progress)
    units = unit_drives(len(scene.actuators), slice(2 * len(scene.actuators)))
    motions = steady_motions(solver.run(units, last_period(scene, solver.discretization.time_step)), scene)
    accelerations, sound = _accelerations_and_sound(solver) if isinstance(solver, ModalSolver) else ({}, None)
    return UnitResponses(
        scene=scene,
        response=response,
        amplitudes=np.stack([motion.amplitude for motion in motions]),
        residual=float(np.max([motion.residual for motion in motions])),
        bound=response.bound(),
        best_drive=response.best_drive(),
        accelerations=accelerations,
        sound=sound,
    )


def _accelerations_and_sound(solver: ModalSolver) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Return the unit accelerations of the regions of the scene's specification, and the sound of the plate."""
    scene = solver.scene
    with suppress(SceneError):  # of masks
        requirements, frequency = make_requirements(solver.plate), scene.drive.frequency
        tone = Tone(solver.plate, requirements, frequency, np.ones(len(scene.actuators)))
        regions = {part.name: part.region for part in requirements.aims}
        regions |= {part.name: part.region for part in requirements.rests}
        velocities = tone.accelerations / (2j * math.pi * frequency)
        sound = WeightedSound(solver.plate, frequency).factor(frequency) @ velocities
        return {name: tone.rows(region.samples) for name, region in regions.items()}, sound
    return {}, None


def live_solver(scene: Scene, device: str, path: str) -> PlateSolver | ModalSolver:
    """Return a solver that also sums the energies of the plate's quadrants."""
    return resolve(scene, device, purpose="replay", path=path).solver(areas=quadrants(scene.plate.size))
