"""Plates of a linear scene by their modes, with the interface of the time-stepping solver."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from warp_plate.modal.coils_in_time import in_time
from warp_plate.modal.energies import ModalEnergies
from warp_plate.modal.loads import has_exponential_loads
from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.modal.motion import fields, largest_displacements
from warp_plate.modal.motion import trace as displacement_at
from warp_plate.modal.radiation import WeightedSound
from warp_plate.modal.slopes import EnergySlopes
from warp_plate.modal.spaces.trimmed_splines import TrimmedSplines
from warp_plate.plate.designs import (
    NO_PER_PLATE,
    Designs,
    PerPlate,
    PerPlateValues,
    as_phasors,
    carriers_of,
    check_designs,
    patch_ends,
)
from warp_plate.plate.scheme import check_grid, sampling_step
from warp_plate.plate.section import make_section
from warp_plate.plate.signals import actuator_delays, actuator_frequencies, highest_frequency
from warp_plate.plate.stability_limit import find_limit
from warp_plate.plate.weights import (
    NO_AREAS,
    REGIONS,
    CoilRegion,
    RegionLike,
    SoundRegion,
    ToneRegion,
    node_positions,
    region_weights,
    weigh_region,
)
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target
from warp_plate.solve.devices import find_device
from warp_plate.solve.response import Response
from warp_plate.solve.run import Progress, Run
from warp_plate.solve.solver import Drives, refuse_pickling
from warp_plate.solve.specialize import Quantity

# Path of a solver that takes no time steps.
MODAL: Literal["modal"] = "modal"


def trace_step(scene: Scene, moment_form: bool = False) -> float:
    """Return the time step of traces [s]: the scene's, or that of time steps on its grid, so that both engines give
    the same times."""
    unstepped = scene.outline is not None and scene.modal_only_key is not None
    limit = math.inf if scene.grid.time_step or unstepped else find_limit(scene, moment_form)[0].time_step
    return sampling_step(scene, limit)


def _has_curve(region: RegionLike) -> bool:
    return isinstance(region, tuple | ToneRegion) or (isinstance(region, Target) and region.mask is None)


@dataclass(frozen=True)
class ModalGrid:
    """Nodes at which results by modes are given, and the times of their traces; nothing is stepped on it."""

    scene: Scene  # The scene, which has a grid
    per_plate: PerPlate = NO_PER_PLATE  # Quantities that may differ between the plates of a batch

    @cached_property
    def region_weights(self) -> np.ndarray:
        """(2, ny, nx) weights of the plate and of the target, in cells."""
        return region_weights(self.scene)

    @cached_property
    def surface_density(self) -> np.ndarray:
        """(ny, nx) mass per area [kg/m²]."""
        return make_section(self.scene).mass

    @property
    def cell(self) -> float:
        """Area of a cell of the grid [m²]."""
        return math.prod(self.scene.spacing)

    def __post_init__(self) -> None:
        check_grid(self.scene)
        sampling_step(self.scene, math.inf)  # refuses a time step that the drive does not allow

    @cached_property
    def time_step(self) -> float:
        """Time step of traces [s]."""
        return trace_step(self.scene, carriers_of(self.scene, self.per_plate) > 1)

    @property
    def steps(self) -> int:
        """Number of time steps of the whole run, of which the last ends within half a step of its end."""
        return math.ceil(self.scene.window.end / self.time_step - 0.5 - 1e-9)


class ModalSolver:
    """Energies and displacements of the plates of a linear scene, exact in time, without time steps.

    Stands in for :class:`PlateSolver` wherever batches of plates are run: the grid only says where displacements and
    weights are given.

    Args:
        scene: Scene, or its grid.
        device: Device of batches of designs under tones; everything else is computed on the CPU.
        areas, per_plate, quantity: See :class:`PlateSolver`; sounds and then coils are the last of the areas.
        plate: Modes of the scene's plate, if they have been solved for.

    Attributes:
        discretization: Grid of displacements and traces.
        plate: Modes of the scene's plate.
        node_steps: 0, for comparison with stepping.
        compile_seconds: Time that solving for the modes took [s].

    Raises:
        SceneError: The scene is not linear, its plate buckles, or a file is malformed.
    """

    path = MODAL
    node_steps = 0
    node_steps_per_plate = 0

    def __init__(
        self,
        scene: Scene | ModalGrid,
        device: str = "auto",
        areas: Mapping[str, RegionLike] = NO_AREAS,
        per_plate: PerPlate = NO_PER_PLATE,
        quantity: Quantity = "velocity",
        plate: ModalPlate | None = None,
    ) -> None:
        started = time.perf_counter()
        self.device, self.quantity = find_device(device), quantity
        self.discretization = ModalGrid(scene, per_plate) if isinstance(scene, Scene) else scene
        self._areas = areas
        searched = self.scene.search.frequency
        highest = max(highest_frequency(self.scene), searched.range[1] if searched is not None else 0.0)
        self.plate: ModalPlate = in_time(plate or solve_modes(self.scene, highest))
        self._highest = highest
        self.compile_seconds = time.perf_counter() - started

    __reduce__ = refuse_pickling

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.discretization.scene

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of the regions whose energies runs return."""
        return (*REGIONS, *self._areas)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the scene's effects."""
        return tuple(name.replace("_", " ") for name in self.scene.effects.names)

    def describe_path(self, traced: bool = False) -> str:
        """Return the name and the number of the modes."""
        return f"{MODAL} ({len(self.plate.frequencies)} modes)"

    @cached_property
    def response(self) -> Response:
        """Gram matrices at the scene's own frequencies and places."""
        return Response(self._modal_energies.scene_matrices())

    def gram_matrices(self, designs: Designs) -> np.ndarray:
        """Return (plates, regions, 2M, 2M) Gram matrices of designs, without using their drives."""
        return self._modal_energies.matrices(*self._parameters(designs))

    def energy_slopes(self, designs: Designs) -> EnergySlopes:
        """Return energies of designs and their slopes by formula; SceneError: those of the drive are not known."""
        scene = self.scene
        if not (scene.linear and has_exponential_loads(scene.drive)):
            key = scene.drive.waveform_key if scene.linear else scene.nonlinear_table
            raise SceneError(f"{key}: its slopes are not known; search without 'gradient'")
        return self._modal_energies.slopes(designs.drives, *self._parameters(designs))

    def run(
        self,
        drives: Drives,
        times: Sequence[float] = (),
        points: Sequence[tuple[float, float]] = (),
        progress: Progress | None = None,
        peak_times: Sequence[float] = (),
    ) -> Run:
        """Return energies, displacements at ``times``, their peak and traces, as :meth:`PlateSolver.run` does."""
        designs = drives if isinstance(drives, Designs) else Designs(as_phasors(drives, len(self.scene.actuators)))
        self._check(designs)
        energy = self._energies(designs)
        energy[~np.isfinite(designs.drives).all(axis=1)] = np.nan
        displacement, trace, trace_times = self._records(designs.drives, times, points)
        peak, outline_peak = np.zeros((len(energy), 1, 1)), None
        if len(peak_times):
            peak, outline_peak = largest_displacements(self.plate, designs.drives, np.asarray(peak_times, dtype=float))
        run = Run(
            energy=energy,
            regions=self.regions,
            masses=self._masses,
            displacement=displacement,
            times=np.asarray(times, dtype=float),
            peak=peak,
            outline_peak=outline_peak,
            matrices=self.response.matrices if self.scene.linear and designs.only_drives else None,
            trace=trace,
            trace_times=trace_times,
            node_steps=0,
            faults={},
        )
        if progress is not None:
            progress(1, 1)
        return run

    def _energies(self, designs: Designs) -> np.ndarray:
        """Return (plates, regions) energies [J]."""
        if not self.scene.linear:
            return self._modal_energies.scene_values(designs.drives)
        if designs.only_drives:
            return self.response.energy(designs.drives)
        return self._modal_energies.values(designs.drives, *self._parameters(designs))

    def _parameters(self, designs: Designs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return frequencies (plates, M) [Hz], areas (plates or 1, M, 4) [m] and delays (plates, M) [s] of designs."""
        values = self._check(designs)
        frequency = actuator_frequencies(self.scene) if values.frequency is None else values.frequency
        delay = actuator_delays(self.scene) if values.delay is None else values.delay
        areas = patch_ends(self.scene.actuators).reshape(1, -1, 4) if values.edges is None else values.edges
        shape = designs.drives.shape
        return np.broadcast_to(frequency, shape), areas, np.broadcast_to(delay, shape)

    def _check(self, designs: Designs) -> PerPlateValues:
        grid = self.discretization
        if designs.only_drives:
            return PerPlateValues()
        return check_designs(designs, grid.scene, grid.per_plate, grid.time_step)

    @cached_property
    def _modal_energies(self) -> ModalEnergies:
        areas = self._areas.values()
        points = [area.point for area in areas if isinstance(area, SoundRegion)]
        sounds = [WeightedSound(self.plate, self._highest, point) for point in points]
        coils = [area for area in areas if isinstance(area, CoilRegion)]
        return ModalEnergies(self.plate, self._region_matrices, self.quantity, self.device, sounds, coils)

    @cached_property
    def _region_matrices(self) -> list[np.ndarray]:
        areas = [area for area in self._areas.values() if not isinstance(area, ToneRegion)]
        regions: list[Any] = ["plate", self.scene.target, *areas]
        return [
            self._weighted(region) if isinstance(region, np.ndarray) else self.plate.kinetic_matrix(region)
            for region in regions
        ]

    def _weighted(self, weights: np.ndarray) -> np.ndarray:
        """Return the mass matrix (modes, modes) of weights (ny, nx) of the grid's nodes, in cells."""
        shapes = self.plate.shapes(*node_positions(self.scene)).reshape(len(self.plate.frequencies), -1)
        masses = weights * self.discretization.surface_density * self.discretization.cell
        return np.asarray((shapes * masses.ravel()) @ shapes.T)

    @cached_property
    def _masses(self) -> np.ndarray:
        space = self.plate.space
        regions: list[Any] = [self.scene.plate.box, self.scene.target]
        regions += self._areas.values()
        if isinstance(space, TrimmedSplines) and all(map(_has_curve, regions)):
            return np.array([0.0 if isinstance(one, ToneRegion) else space.region_mass(one) for one in regions])
        weights = [weigh_region(self.scene, name, region) for name, region in self._areas.items()]
        fields = [*self.discretization.region_weights, *weights]
        return np.array([(field * self.discretization.surface_density).sum() for field in fields]) * (
            self.discretization.cell
        )

    def _records(
        self, phasors: np.ndarray, times: Sequence[float], points: Sequence[tuple[float, float]]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return displacements (plates, times, ny, nx), traces (plates, points, steps) [m] and their times [s]."""
        grid = self.discretization
        trace_times = grid.time_step * np.arange(1, grid.steps + 1) if len(points) else np.empty(0)
        x, y = node_positions(self.scene)
        displacement = np.empty((len(phasors), len(times), y.size, x.size))
        if len(times):
            displacement[:] = fields(self.plate, phasors, np.asarray(times, dtype=float), x, y)
        trace = np.empty((len(phasors), len(points), trace_times.size))
        if len(points):
            trace[:] = displacement_at(self.plate, phasors, points, trace_times)
        return displacement, trace, trace_times
