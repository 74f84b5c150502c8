"""Scene → compile key, scheme and the arrays that every path needs, on one device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import warp as wp

from warp_plate.kernels.effects import Effects
from warp_plate.kernels.update import make_parameters
from warp_plate.plate.designs import PerPlate, actuator_spaces
from warp_plate.plate.discretization import Discretization
from warp_plate.plate.moving_load import MovingWeights
from warp_plate.plate.scheme import Scheme
from warp_plate.plate.signals import Signals, running_sums, waves_apart
from warp_plate.plate.stability_limit import needs_moment_form
from warp_plate.plate.weights import NO_AREAS, REGIONS, Region, reachable_nodes, weigh_region
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import cpu_threads

# Rows are padded to whole cache lines, which are also whole vector registers.
LINE_BYTES = 64
# What a run's energies are of.
Quantity = Literal["velocity", "displacement"]


@dataclass(frozen=True)
class Specialized:
    """A scene made ready for the kernels of one device; arrays in the layout of ``warp_plate.kernels``.

    real: wp.float32 or wp.float64; rows = ny + 2; stride: columns with padding; threads: of the CPU to use; regions:
    names of those whose energy is summed.
    support: (covered nodes, 2), patches: (actuators, covered nodes), weights: (regions, rows, stride),
    wave: (steps, terms), all on the device; signals, moving: what drives and a moving load do in time; parameters:
    the kernels' struct.
    per_plate: what may differ between plates; carriers: of each plate's own, or 0; share: (covered nodes,) what
    a pressure of one on a node's whole cell is worth there. quantity: of energies; for "displacement" the wave holds
    running sums, divided by sizes (terms,), powers of two.
    """

    discretization: Discretization
    scene: Scene
    scheme: Scheme
    effects: Effects
    real: type
    rows: int
    stride: int
    device: wp.Device
    threads: int
    regions: tuple[str, ...]
    parameters: Any
    support: wp.array
    patches: wp.array
    weights: wp.array
    signals: Signals
    moving: MovingWeights | None
    wave: wp.array
    per_plate: PerPlate
    carriers: int
    share: np.ndarray
    quantity: Quantity
    sizes: np.ndarray

    @property
    def interior_nodes(self) -> int:
        """Nodes that move."""
        nx, ny = self.scheme.nodes
        return (nx - 2) * (ny - 2)

    @cached_property
    def masses(self) -> np.ndarray:
        """(regions,) mass of each region [kg]; kept, for asking a device waits until it is idle."""
        hx, hy = self.scheme.spacing
        masses: np.ndarray = self.weights.numpy().sum(axis=(1, 2)) * self.scheme.surface_density * hx * hy
        masses.flags.writeable = False
        return masses

    @property
    def loaded_rows(self) -> np.ndarray:
        """(rows,) one for the rows of the tensor in which some node is loaded, else zero."""
        loaded = np.zeros(self.rows, dtype=np.int32)
        loaded[np.unique(self.support.numpy()[:, 0])] = 1
        return loaded

    @property
    def taps(self) -> tuple[wp.array, wp.array, wp.array, wp.array]:
        """bend_x, bend_y, move_x, move_y on the device, those of y times ``aspect``; see ``plate.operator``."""
        x, y, aspect = self.scheme.taps_x, self.scheme.taps_y, self.scheme.aspect
        bend_x, bend_y, move_x, move_y = map(self.to_device, (x.bend, aspect * y.bend, x.move, aspect * y.move))
        return bend_x, bend_y, move_x, move_y

    def to_device(self, values: np.ndarray) -> wp.array:
        """A copy on the device in the scene's precision.

        Raises:
            SceneError: a number is too large for it.
        """
        precision = self.scene.grid.precision
        if not (np.abs(values) <= np.finfo(precision).max).all():
            raise SceneError(
                f"grid.precision = {precision!r}: an effect, a drive or a layer is too large for it; write "
                f"{'a smaller one' if precision == 'float64' else 'float64'}"
            )
        return wp.array(values, dtype=self.real, device=self.device)


def effect_names(scene: Scene, several_waves: bool = False) -> tuple[str, ...]:
    """The effects in the compiled kernel, for people and for results; ``several_waves``: also where the scene's drive
    does not ask for them."""
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
    """The part of the compile key that is off for a plain plate; ``moment_form``: taken by moments all the same."""
    effects = scene.effects
    elastic = any(not isinstance(edge, str) for _, edge in scene.edges)
    found = {
        "material_damping": effects.material_damping is not None,
        "tension": effects.tension is not None,
        "foundation": effects.foundation is not None or elastic,
        "stretching": effects.stretching is not None,
        "oscillators": bool(effects.oscillators),
        "moving_load": effects.moving_load is not None,
    }
    return {"moments": moment_form or needs_moment_form(scene), **found}


def specialize(
    discretization: Discretization,
    device: wp.Device,
    threads: int | None = None,
    areas: Mapping[str, Region] = NO_AREAS,
    quantity: Quantity = "velocity",
) -> Specialized:
    """Make a discretized scene ready for a device.

    Args:
        discretization: The scene on its grid.
        device: Where the kernels run.
        threads: Threads of the CPU (default: as many as it has).
        areas: Further regions by name.
        quantity: See :class:`Specialized`.

    Raises:
        SceneError: displacements of a scene that is not linear, or an area that covers no node.
    """
    scene, scheme, per_plate = discretization.scene, discretization.scheme, discretization.per_plate
    carriers, signals = discretization.carriers, discretization.signals
    _check_quantity(scene, quantity)
    real = {"float32": wp.float32, "float64": wp.float64}[scene.grid.precision]
    dtype = np.dtype(scene.grid.precision)
    nx, ny = scheme.nodes
    line = LINE_BYTES // dtype.itemsize
    stride = -(-nx // line) * line
    fields = discretization.patches
    reached = fields.any(axis=0)
    if per_plate.centre:
        reached |= reachable_nodes(scene, actuator_spaces(scene, per_plate))
    share = np.ones(fields.shape[1:])
    regions = np.stack(
        [*discretization.region_weights, *(weigh_region(scene, name, area) for name, area in areas.items())]
    )
    if scheme.bending is not None:
        # A pressure moves a node by its share of what the node's own part of the cell weighs.
        loss = 0.0 if scheme.backward else scheme.viscous * scheme.time_step / scheme.bending.mass
        ratio = scheme.bending.mass / scheme.surface_density
        heavy = scheme.bending.weight * ratio * (1 + loss / 2)
        fields, share = fields / heavy, share / heavy
        regions = regions * ratio
    wave, sizes = signals.wave, np.ones(signals.terms)
    if quantity == "displacement":
        wave, sizes = running_sums(wave)
    support = np.argwhere(reached)
    parameters = make_parameters(real)()
    parameters.stiffness = scheme.stiffness
    parameters.aspect = scheme.aspect
    parameters.decay = scheme.decay
    weights = np.zeros((len(regions), ny + 2, stride))
    weights[:, 1:-1, :nx] = regions
    return Specialized(
        discretization=discretization,
        scene=scene,
        scheme=scheme,
        effects=Effects(
            damping=scene.effects.damping is not None or scheme.viscous > 0,
            square_cells=scheme.square_cells or scheme.order == 4,
            order=scheme.order,
            terms=signals.terms,
            **moment_form_effects(scene, moment_form=carriers > 1),
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
        signals=signals,
        moving=discretization.moving,
        wave=wp.array(wave.astype(dtype), dtype=real, device=device),
        per_plate=per_plate,
        carriers=carriers,
        share=share[support[:, 0], support[:, 1]],
        quantity=quantity,
        sizes=sizes,
    )


def _check_quantity(scene: Scene, quantity: str) -> None:
    if quantity not in get_args(Quantity):
        raise SceneError(f"quantity = {quantity!r}: no such quantity; there are: {', '.join(get_args(Quantity))}")
    if quantity == "displacement" and not scene.linear:
        raise SceneError(
            f"{scene.nonlinear_table}: displacements are not linear in the load, whose running sums would be taken; "
            "delete it, or measure velocities"
        )
