"""A discretized scene on one device: the compile key and the arrays that every path needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import warp as wp

from warp_plate.kernels.effects import KernelEffects
from warp_plate.kernels.update import make_parameters
from warp_plate.plate.designs import actuator_spaces
from warp_plate.plate.discretization import Discretization
from warp_plate.plate.scheme import Scheme
from warp_plate.plate.signals import running_sums, waves_apart
from warp_plate.plate.stability_limit import needs_moment_form
from warp_plate.plate.weights import NO_AREAS, REGIONS, Region, reachable_nodes, weigh_region
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import cpu_threads

# Rows are padded to whole cache lines, which are also whole vector registers.
LINE_BYTES = 64
Quantity = Literal["velocity", "displacement"]


@dataclass(frozen=True)
class Specialized:
    """A scene made ready for the kernels of one device; arrays have the layout of ``warp_plate.kernels``."""

    discretization: Discretization  # The scene on its grid, on the host
    scene: Scene  # The scene
    scheme: Scheme  # Its steps and coefficients
    effects: KernelEffects  # Compile key of the kernels
    real: type  # ``wp.float32`` or ``wp.float64``
    rows: int  # Rows of a field, ny + 2
    stride: int  # Columns of a field, nx and padding
    device: wp.Device  # Device of all arrays
    threads: int  # Threads of the CPU to use
    regions: tuple[str, ...]  # Names of the regions whose energy is summed
    parameters: Any  # Struct of the kernels' scalar coefficients
    support: wp.array  # (covered nodes, 2) row of the field and column of the nodes that are loaded
    patches: wp.array  # (actuators, covered nodes) load of each actuator per unit of its coefficient
    weights: wp.array  # (regions, rows, stride) float64 weights of the regions
    wave: wp.array  # (steps, terms) waves that all plates share; running sums of them if energies are of displacements
    share: np.ndarray  # (covered nodes,) load on a node whose whole cell is under a pressure of one
    quantity: Quantity  # "velocity" for kinetic energies; "displacement" for the same sums of displacements
    sizes: np.ndarray  # (terms,) powers of two that the wave was divided by

    @property
    def interior_nodes(self) -> int:
        """Number of nodes inside the edges."""
        nx, ny = self.scheme.nodes
        return (nx - 2) * (ny - 2)

    @cached_property
    def masses(self) -> np.ndarray:
        """(regions,) mass of each region [kg]; cached because reading from a device waits until it is idle."""
        hx, hy = self.scheme.spacing
        masses: np.ndarray = self.weights.numpy().sum(axis=(1, 2)) * self.scheme.surface_density * hx * hy
        masses.flags.writeable = False
        return masses

    @property
    def loaded_rows(self) -> np.ndarray:
        """(rows,) one for the rows of a field that hold a loaded node, else zero."""
        loaded = np.zeros(self.rows, dtype=np.int32)
        loaded[np.unique(self.support.numpy()[:, 0])] = 1
        return loaded

    @property
    def taps(self) -> tuple[wp.array, wp.array, wp.array, wp.array]:
        """bend_x, bend_y, move_x, move_y of ``plate.operator`` on the device, those of y times ``aspect``."""
        x, y, aspect = self.scheme.taps_x, self.scheme.taps_y, self.scheme.aspect
        bend_x, bend_y, move_x, move_y = map(self.to_device, (x.bend, aspect * y.bend, x.move, aspect * y.move))
        return bend_x, bend_y, move_x, move_y

    def to_device(self, values: np.ndarray) -> wp.array:
        """Return a copy on the device in the scene's precision.

        Raises:
            SceneError: A value exceeds the range of that precision.
        """
        precision = self.scene.grid.precision
        if not (np.abs(values) <= np.finfo(precision).max).all():
            raise SceneError(
                f"grid.precision = {precision!r}: an effect, a drive or a layer is too large for it; write "
                f"{'a smaller one' if precision == 'float64' else 'float64'}"
            )
        return wp.array(values, dtype=self.real, device=self.device)


def effect_names(scene: Scene, several_waves: bool = False) -> tuple[str, ...]:
    """Return the names of the effects in the compiled kernel.

    Args:
        several_waves: Plates have more waves than the scene's drive alone asks for.
    """
    several_waves = several_waves or scene.drive.electrostatic is not None or waves_apart(scene) > 1
    damping = scene.effects.damping
    named = {
        f"viscous damping ({damping.scheme})" if damping else "": damping,
        "bending by moments": several_waves or needs_moment_form(scene),
        "material damping": scene.effects.material_damping,
        "tension": scene.effects.tension,
        "foundation": scene.effects.foundation,
        "oscillators": scene.effects.oscillators,
        "stretching": scene.effects.stretching,
        "moving load": scene.effects.moving_load,
        "several waves": several_waves,
    }
    return tuple(name for name, table in named.items() if table)


def moment_form_effects(scene: Scene, moment_form: bool = False) -> dict[str, bool]:
    """Return the part of the compile key that is off for a plain plate; ``moment_form`` asks for the form itself."""
    effects = scene.effects
    elastic = any(not isinstance(edge, str) for _, edge in scene.edges)
    return {
        "moments": moment_form or needs_moment_form(scene),
        "material_damping": effects.material_damping is not None,
        "tension": effects.tension is not None,
        "foundation": effects.foundation is not None or elastic,
        "stretching": effects.stretching is not None,
        "oscillators": bool(effects.oscillators),
        "moving_load": effects.moving_load is not None,
    }


def specialize(
    discretization: Discretization,
    device: wp.Device,
    threads: int | None = None,
    areas: Mapping[str, Region] = NO_AREAS,
    quantity: Quantity = "velocity",
) -> Specialized:
    """Make a discretized scene ready for a device.

    Args:
        threads: Threads of the CPU (default: as many as it has).
        areas: Further regions by name.
        quantity: See :class:`Specialized`.

    Raises:
        SceneError: Displacements are asked of a scene that is not linear, or an area covers no node.
    """
    scene, scheme = discretization.scene, discretization.scheme
    _check_quantity(scene, quantity)
    real = {"float32": wp.float32, "float64": wp.float64}[scene.grid.precision]
    dtype = np.dtype(scene.grid.precision)
    nx, ny = scheme.nodes
    line = LINE_BYTES // dtype.itemsize
    stride = -(-nx // line) * line
    further = [weigh_region(scene, name, area) for name, area in areas.items()]
    fields, share, regions = _in_units_of_mass(discretization, np.stack([*discretization.region_weights, *further]))
    support = np.argwhere(_loaded_nodes(discretization))
    signals = discretization.signals
    wave, sizes = signals.wave, np.ones(signals.terms)
    if quantity == "displacement":
        wave, sizes = running_sums(wave)
    parameters = make_parameters(real)()
    parameters.stiffness, parameters.aspect, parameters.decay = scheme.stiffness, scheme.aspect, scheme.decay
    weights = np.zeros((len(regions), ny + 2, stride))
    weights[:, 1:-1, :nx] = regions
    return Specialized(
        discretization=discretization,
        scene=scene,
        scheme=scheme,
        effects=KernelEffects(
            damping=scene.effects.damping is not None or scheme.viscous > 0,
            square_cells=scheme.square_cells or scheme.order == 4,
            order=scheme.order,
            terms=signals.terms,
            **moment_form_effects(scene, moment_form=discretization.carriers > 1),
        ),
        real=real,
        rows=ny + 2,
        stride=stride,
        device=device,
        threads=threads or cpu_threads(),
        regions=(*REGIONS, *areas),
        parameters=parameters,
        support=wp.array((support + [1, 0]).astype(np.int32), dtype=int, device=device),
        patches=wp.array(fields[:, support[:, 0], support[:, 1]].astype(dtype), dtype=real, device=device),
        weights=wp.array(weights, dtype=wp.float64, device=device),
        wave=wp.array(wave.astype(dtype), dtype=real, device=device),
        share=share[support[:, 0], support[:, 1]],
        quantity=quantity,
        sizes=sizes,
    )


def _check_quantity(scene: Scene, quantity: str) -> None:
    if quantity not in get_args(Quantity):
        raise SceneError(f"quantity = {quantity!r}: no such quantity; there are: {', '.join(get_args(Quantity))}")
    if quantity == "displacement" and not scene.linear:
        raise SceneError(
            f"{scene.nonlinear_table}: displacements are computed as the response to the load's running sums, valid "
            "for linear plates alone; delete it, or measure velocities"
        )


def _loaded_nodes(discretization: Discretization) -> np.ndarray:
    """Return (ny, nx), true at nodes that an actuator loads, or can load if actuators move from plate to plate."""
    scene, per_plate = discretization.scene, discretization.per_plate
    loaded: np.ndarray = np.any(discretization.patches, axis=0)
    return loaded | reachable_nodes(scene, actuator_spaces(scene, per_plate)) if per_plate.centre else loaded


def _in_units_of_mass(
    discretization: Discretization, regions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return loads (actuators, ny, nx), share (ny, nx) and weights (regions, ny, nx) relative to the nodes' masses.

    In moment form a pressure accelerates a node by its share of the mass of the node's own part of the cell.
    """
    scheme, patches = discretization.scheme, discretization.patches
    share = np.ones(patches.shape[1:])
    if scheme.bending is None:
        return patches, share, regions
    loss = 0.0 if scheme.backward else scheme.viscous * scheme.time_step / scheme.bending.mass
    ratio = scheme.bending.mass / scheme.surface_density
    heavy = scheme.bending.weight * ratio * (1 + loss / 2)
    return patches / heavy, share / heavy, regions * ratio
