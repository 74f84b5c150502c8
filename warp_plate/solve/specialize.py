"""A discretized scene on one device: the compile key and the arrays that every path needs."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Literal, get_args

import numpy as np
import warp as wp

from warp_plate.effects.effect import DISPLACEMENT, IN_PLANE
from warp_plate.kernels.coils import BRANCH, NUMBERS
from warp_plate.kernels.cuda import RESERVED_BYTES
from warp_plate.kernels.update import KernelEffects, make_parameters
from warp_plate.plate.coils import MountedCoil
from warp_plate.plate.designs import actuator_spaces, patch_ends
from warp_plate.plate.scheme import Discretization, Scheme
from warp_plate.plate.signals import running_sums, waves_apart
from warp_plate.plate.stability_limit import needs_moment_form
from warp_plate.plate.weights import EDGE_LINES, NO_AREAS, REGIONS, RegionLike, reachable_nodes, weigh_region
from warp_plate.scene.errors import SceneError
from warp_plate.solve.devices import LOADING, cpu_threads, load_kernel

# Rows are padded to whole cache lines, which are also whole vector registers.
LINE_BYTES = 64
Quantity = Literal["velocity", "displacement"]


class Specialized:
    """A discretized scene made ready for the kernels of a device; arrays have the layout of ``warp_plate.kernels``.

    ``areas`` are further regions by name, whose energy is summed too, as that of displacements if ``quantity`` says so.
    """

    def __init__(
        self,
        discretization: Discretization,
        device: wp.Device,
        threads: int | None = None,
        areas: Mapping[str, RegionLike] = NO_AREAS,
        quantity: Quantity = "velocity",
    ) -> None:
        self.discretization, self.device, self.quantity = discretization, device, quantity
        self.scene, self.scheme = discretization.scene, discretization.scheme
        if quantity not in get_args(Quantity):
            raise SceneError(f"quantity = {quantity!r}: no such quantity; there are: {', '.join(get_args(Quantity))}")
        if quantity == "displacement" and not self.scene.linear:
            raise SceneError(
                f"{self.scene.nonlinear_table}: displacements are computed as the response to the load's running sums, "
                "valid for linear plates alone; delete it, or measure velocities"
            )
        self.threads = threads or cpu_threads()
        self.loaded_kernels: dict[wp.Kernel, int | None] = {}  # with their threads per block
        self.late_seconds = 0.0  # Time spent on kernels that are compiled when a run needs them [s]
        self.effects = kernel_effects(discretization)  # Compile key of the kernels
        self.real = {"float32": wp.float32, "float64": wp.float64}[self.scene.grid.precision]
        (nx, ny), line = self.scheme.nodes, LINE_BYTES // wp.types.type_size_in_bytes(self.real)
        self.rows, self.stride = ny + 2, -(-nx // line) * line  # Shape of a field, with padding
        self.interior_nodes = (nx - 2) * (ny - 2)  # Nodes inside the edges
        self.node_steps_per_plate = self.interior_nodes * self.scheme.steps  # Nodes updated × steps
        self.regions = (*REGIONS, *areas)  # Names of the regions for which energies are summed
        self.parameters = make_parameters(self.real)()  # Struct of the kernels' scalar coefficients
        for name in ("stiffness", "aspect", "decay"):
            setattr(self.parameters, name, getattr(self.scheme, name))
        self._put_loads_and_regions([weigh_region(self.scene, name, area) for name, area in areas.items()])
        signals = discretization.signals
        wave, sizes = (signals.wave, np.ones(signals.terms)) if quantity == "velocity" else running_sums(signals.wave)
        # (steps, terms) waves that all plates share, or their running sums for energies of displacements
        self.wave: wp.array = wp.array(wave, dtype=self.real, device=device)
        self.sizes = sizes  # (terms,) powers of two that the wave was divided by

    def _put_loads_and_regions(self, further: list[np.ndarray]) -> None:
        """Set the arrays below from patches and regions, relative to the masses of the nodes.

        In moment form a pressure accelerates a node by its share of the mass of the node's own part of the cell.
        """
        discretization, scheme, device = self.discretization, self.scheme, self.device
        patches, regions = discretization.patches, np.stack([*discretization.region_weights, *further])
        loaded = np.any([*patches, *(coil.share for coil in self.coils)], axis=0)
        if discretization.per_plate.centre:
            loaded |= reachable_nodes(self.scene, actuator_spaces(self.scene, discretization.per_plate))
        share = np.ones(patches.shape[1:])
        if scheme.bending is not None:
            loss = 0.0 if scheme.backward else scheme.viscous * scheme.time_step / scheme.bending.mass
            ratio = scheme.bending.mass / scheme.surface_density
            heavy = scheme.bending.weight * ratio * (1 + loss / 2)
            patches, share, regions = patches / heavy, share / heavy, regions * ratio
        weights = np.zeros((len(regions), self.rows, self.stride))
        weights[:, 1:-1, : scheme.nodes[0]] = regions
        # (regions, rows, stride) weights of the regions
        self.weights: wp.array = wp.array(weights, dtype=wp.float64, device=device)
        # (covered nodes, 2) row of the field and column of the nodes that are loaded
        self.support: wp.array = wp.array(np.argwhere(loaded) + [1, 0], dtype=int, device=device)
        # (actuators, covered nodes) load of each actuator per unit of its coefficient
        self.patches: wp.array = wp.array(patches[:, loaded], dtype=self.real, device=device)
        self.share = share[loaded]  # (covered nodes,) load on a node whose whole cell is under a pressure of one

    @cached_property
    def masses(self) -> np.ndarray:
        """(regions,) mass of each region [kg]; cached because reading from a device waits until it is idle."""
        hx, hy = self.scheme.spacing
        masses: np.ndarray = self.weights.numpy().sum(axis=(1, 2)) * self.scheme.surface_density * hx * hy
        masses.flags.writeable = False
        return masses

    @cached_property
    def largest_rate_per_step(self) -> float:
        """Rate, in the kernels' units, that the loads' work adds at most in a step; cached as ``masses``."""
        norms = np.linalg.norm(self.patches.numpy().astype(float), axis=1)
        if self.discretization.per_plate.centre:  # the largest norms wherever the actuators are
            sides = np.ptp(patch_ends(self.scene.actuators), axis=2)
            covered = (sides / self.scheme.spacing + 2).prod(axis=1)
            norms = np.maximum(norms, self.share.max() * np.sqrt(covered))
        share = np.zeros(self.discretization.patches.shape[1:])
        share[self.support.numpy()[:, 0] - 1, self.support.numpy()[:, 1]] = self.share
        norms = np.concatenate([norms, largest_rates(self.scheme, self.coils, share)])
        # Waves are below two in size and coefficients at most one.
        load = 2 * self.effects.terms * norms.sum()
        if self.discretization.moving is not None:
            load += np.sqrt(self.interior_nodes)
        return float(load)

    @cached_property
    def drive_factors(self) -> wp.array:
        """(terms, features, actuators) factors of the features of ``plate.signals`` in the coefficients, float64."""
        factors = self.discretization.signals.mixing * self.sizes[:, None, None]
        return wp.array(factors, dtype=wp.float64, device=self.device)

    @property
    def coils(self) -> Sequence[MountedCoil]:
        """Coils on the plate."""
        return self.scheme.bending.coils if self.scheme.bending is not None else ()

    @property
    def shared_bytes(self) -> int:
        """Shared memory that kernels may take for a block of the CUDA device."""
        return int(self.device.max_shared_memory_per_block) - RESERVED_BYTES

    @property
    def loaded_rows(self) -> np.ndarray:
        """(rows,) one for the rows of a field with a loaded node, otherwise zero."""
        loaded = np.zeros(self.rows, dtype=np.int32)
        loaded[self.support.numpy()[:, 0]] = 1
        return loaded

    @property
    def loaded(self) -> wp.array:
        """``loaded_rows`` on the device."""
        return wp.array(self.loaded_rows, dtype=int, device=self.device)

    @property
    def taps(self) -> list[wp.array]:
        """bend_x, bend_y, move_x, move_y of ``plate.operator`` on the device, those of y times ``aspect``."""
        x, y, aspect = self.scheme.taps_x, self.scheme.taps_y, self.scheme.aspect
        return [self.to_device(taps) for taps in (x.bend, aspect * y.bend, x.move, aspect * y.move)]

    def load(self, *kernels: wp.Kernel, block_dim: int | None = None) -> None:
        """Compile kernels for the device, or load them from Warp's cache."""
        for kernel in kernels:
            load_kernel(kernel, self.device, block_dim)
            self.loaded_kernels[kernel] = block_dim

    @contextmanager
    def compiling_late(self) -> Iterator[None]:
        """Count the time within among that of compiling, although it is spent during a run."""
        started = time.perf_counter()
        with LOADING:
            yield
        self.late_seconds += time.perf_counter() - started

    def to_device(self, values: np.ndarray) -> wp.array:
        """Return a copy on the device in the scene's precision."""
        precision = self.scene.grid.precision
        if not (np.abs(values) <= np.finfo(precision).max).all():
            raise SceneError(
                f"grid.precision = {precision!r}: an effect, a drive or a layer is too large for it; write "
                f"{'a smaller one' if precision == 'float64' else 'float64'}"
            )
        return wp.array(values, dtype=self.real, device=self.device)


def effect_names(discretization: Discretization) -> tuple[str, ...]:
    """Return the names of the effects in the compiled kernel."""
    scene = discretization.scene
    several_waves = discretization.carriers > 1 or scene.drive.electrostatic is not None or waves_apart(scene) > 1
    names, damped = scene.effects.compiled, scene.effects.damping is not None
    moments = several_waves or needs_moment_form(scene)
    before, after = names[:damped], names[damped:]
    coils = ["coils"][: scene.coils_in_time]
    return (*before, *["bending by moments"][:moments], *after, *coils, *["several waves"][:several_waves])


def kernel_effects(discretization: Discretization) -> KernelEffects:
    """Return the compile key of the kernels."""
    scheme, scene = discretization.scheme, discretization.scene
    grid = None if scheme.bending is None else scheme.bending.grid
    distributed = (term for term in scene.terms if term.place is None or getattr(term.place, "side", "") in EDGE_LINES)
    kinds = {(term.role, term.multiple_of, term.factors) for term in distributed}
    return KernelEffects(
        damping=("damping", "", DISPLACEMENT) in kinds,
        square_cells=scheme.square_cells or scheme.order == 4,
        order=scheme.order,
        terms=discretization.signals.terms,
        moments=discretization.carriers > 1 or needs_moment_form(scene),
        retarded=("damping", "bending", DISPLACEMENT) in kinds,
        in_plane=any(("stiffness", "", factors) in kinds for factors in IN_PLANE),
        springs=("stiffness", "", DISPLACEMENT) in kinds or (grid is not None and bool(grid.strips.any())),
        membrane=scene.effects.stretches,
        attached=scheme.bending is not None and bool(scheme.bending.attachments),
        coils=scene.coils_in_time,
        branches=0 if scheme.bending is None else max((len(coil.branches) for coil in scheme.bending.coils), default=0),
        travelling=scene.effects.travelling is not None,
        outline=grid is not None,
    )


def coil_numbers(scheme: Scheme, coils: Sequence[MountedCoil], pressure_gain: np.ndarray) -> np.ndarray:
    """Return (coils, numbers) of coils for their kernels, in the scaled units of these, where a pressure of one adds
    ``pressure_gain`` (ny, nx) to the rates."""
    step, cell = scheme.time_step, scheme.spacing[0] * scheme.spacing[1]
    mass = 1 / (scheme.surface_density * cell)  # per kilogram
    damping, stiffness = step * mass, step**2 * mass  # per N·s/m and N/m
    rows, most = [], max((len(mounted.branches) for mounted in coils), default=0)
    for mounted in coils:
        coil, inductive = mounted.coil, mounted.by_voltage and mounted.coil.inductance > 0
        memory = 2 * coil.inductance / step if inductive else 0.0
        halves = [shunt * step / (2 * inductance) for shunt, inductance in mounted.branches]
        weights = [shunt / (1 + half) for (shunt, _), half in zip(mounted.branches, halves, strict=True)]
        conductance = 1 / (coil.resistance + memory + sum(weights)) if mounted.by_voltage else 0.0
        induced = coil.force_factor**2 * conductance
        half = (coil.suspension_damping + induced) * damping / 2
        magnet, own = coil.magnet_mass * mass, coil.magnet_damping * damping / 2
        inverse = 1 / (magnet + own + half) if magnet else 0.0
        resistance = coil.moving_mass * mass + half - inverse * half**2
        response = float((mounted.share**2 * pressure_gain).sum())
        numbers = {
            "stiffness": coil.suspension_stiffness * stiffness,
            "half_damping": half,
            "moving_mass": coil.moving_mass * mass,
            "force": coil.force_factor * (conductance if mounted.by_voltage else 1.0) / cell,
            "memory": memory,
            "magnet": inverse,
            "magnet_decay": magnet - own - half,
            "magnet_stiffness": coil.magnet_stiffness * stiffness,
            "response": response,
            "implicit": 1 / (1 + response * resistance),
            "resistance": resistance,
            "current": conductance,
            "induced": coil.force_factor * scheme.load_scale / step,
            "follow": 2.0 if inductive else 1.0,
        }
        branches = np.zeros((most, BRANCH))
        branches[: len(weights)] = [(weight, 2 * a / (1 + a)) for weight, a in zip(weights, halves, strict=True)] or 0
        rows.append([*(numbers[name] for name in NUMBERS), *branches.ravel()])
    return np.array(rows).reshape(-1, len(NUMBERS) + BRANCH * most)


def largest_rates(scheme: Scheme, coils: Sequence[MountedCoil], pressure_gain: np.ndarray) -> np.ndarray:
    """Return (coils,) norms of the rates that a volt or ampere at each coil adds in a step."""
    numbers = coil_numbers(scheme, coils, pressure_gain)
    forces = np.abs(numbers[:, NUMBERS.index("force")] * numbers[:, NUMBERS.index("implicit")])
    return np.array([force * np.linalg.norm(c.share * pressure_gain) for c, force in zip(coils, forces, strict=True)])
