"""The batched grid tensors of one chunk of plates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warp_plate.solve.specialize import Specialized

# u, rate, squares, u_next, rate_next; and a load for each term
FIELDS = 5
# And of the general paths at most: u, mx, my, mxy, ∇²u and what strains
GENERAL_FIELDS = 6
# All plates are cleared at once where the first are no fewer than one of so many: a call for each field takes longer.
WHOLE = 4


@dataclass(frozen=True)
class HostSide:
    """Numbers of a state in the host's memory, pinned where the device is another: they are copied while both work.

    coefficients, units, energy: as in :class:`State`.
    """

    coefficients: wp.array
    units: wp.array
    energy: wp.array


@dataclass
class State:
    """Room for ``capacity`` plates; fields are (capacity, rows, stride) and hold zeros outside the plate.

    moves: the five fields u, rate, squares, u_next and rate_next in one piece.
    u_next, rate_next: the buffers that take turns with u and rate on the streaming paths; the resident path on CPU
    and the plain streaming path keep the curvature in u_next. coefficients: (capacity, terms, actuators), and loads:
    (terms, capacity, rows, stride), see ``kernels.load``; in_phase and quadrature are the first two loads. units:
    (capacity,) displacement that one stands for [m]; moving: (capacity,) the moving load's size in units of pressure;
    nodes: (traced nodes, 2), row of the tensor and column; inner_nodes: the same with the row of the plate; trace:
    (capacity, traced nodes, steps).
    wave: (capacity, steps, terms) that a run takes, which is shared_wave, or plate_waves; of
    places of their own, along_x (capacity, actuators, nx) and along_y; see ``per_plate``. host: numbers waiting for the
    device, and those of the device for the host. beside: what kernels need beside all this, and launches put together,
    made by who launches them.
    """

    capacity: int
    coefficients: wp.array
    loads: wp.array
    in_phase: wp.array
    quadrature: wp.array
    moves: wp.array
    u: wp.array
    rate: wp.array
    squares: wp.array
    u_next: wp.array
    rate_next: wp.array
    units: wp.array
    moving: wp.array
    nodes: wp.array
    inner_nodes: wp.array
    trace: wp.array
    column_sums: wp.array
    energy: wp.array
    wave: wp.array
    shared_wave: wp.array
    plate_waves: wp.array
    along_x: wp.array
    along_y: wp.array
    host: HostSide
    beside: dict[Hashable, Any] = dataclasses.field(default_factory=dict)

    @property
    def has_plate_waves(self) -> bool:
        """Whether the plates of the run at hand have waves of their own."""
        return self.wave is self.plate_waves

    def clear(self, plates: int) -> None:
        """The first plates, and the number beyond them, back to rest at t = 0; the load fields stay."""
        if WHOLE * plates >= self.capacity:
            self.moves.zero_()
            return
        for field in (self.u, self.rate, self.squares, self.u_next, self.rate_next):
            field[: plates + 1].zero_()


# A path, called as advance(state, plates, start, stop): takes the first ``plates`` plates of a state from step
# ``start`` to ``stop``. It has finished on CPU, or is queued on the device's stream on CUDA, when it returns.
Advance = Callable[[State, int, int, int], None]


def bytes_per_plate(specialized: Specialized, traced_nodes: int) -> int:
    """Device memory that one plate takes."""
    itemsize = wp.types.type_size_in_bytes(specialized.real)
    regions, rows, stride = specialized.weights.shape
    count = FIELDS + specialized.effects.terms + (0 if specialized.effects.plain else GENERAL_FIELDS)
    fields = count * rows * stride + traced_nodes * specialized.scheme.steps
    plate_waves = specialized.scheme.steps * specialized.effects.terms if specialized.carriers else 0
    places = specialized.patches.shape[0] * (sum(specialized.scheme.nodes) + 4) if specialized.per_plate.centre else 0
    return (fields + plate_waves) * itemsize + 8 * (regions * (stride + 1) + places)


def make_state(specialized: Specialized, capacity: int, nodes: wp.array) -> State:
    """Zeroed room for ``capacity`` plates on the device."""
    device, real = specialized.device, specialized.real
    regions = specialized.weights.shape[0]
    terms, actuators = specialized.effects.terms, specialized.patches.shape[0]

    # The general passes on CPU read a number beyond the last plate; it must be zero.
    spare = 0 if specialized.effects.plain else 1

    def field(*more: int) -> wp.array:
        return wp.zeros((*more, capacity + spare, specialized.rows, specialized.stride), dtype=real, device=device)

    moves, loads, steps, (nx, ny) = field(FIELDS), field(terms), specialized.scheme.steps, specialized.scheme.nodes
    wave = shared_wave(specialized.wave, capacity)
    own = capacity if specialized.carriers else 0
    moved = capacity if specialized.per_plate.centre else 0

    def beside(shape: tuple[int, ...], dtype: type) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device="cpu", pinned=device.is_cuda)

    return State(
        capacity=capacity,
        coefficients=wp.zeros((capacity, terms, actuators), dtype=real, device=device),
        loads=loads,
        in_phase=loads[0],
        quadrature=loads[1],
        moves=moves,
        u=moves[0],
        rate=moves[1],
        squares=moves[2],
        u_next=moves[3],
        rate_next=moves[4],
        units=wp.zeros(capacity, dtype=real, device=device),
        moving=wp.zeros(capacity, dtype=real, device=device),
        nodes=nodes,
        inner_nodes=wp.array(nodes.numpy() - np.array([1, 0], np.int32), dtype=int, device=device),
        trace=wp.zeros((capacity, nodes.shape[0], specialized.scheme.steps), dtype=real, device=device),
        column_sums=wp.zeros((capacity, regions, specialized.stride), dtype=wp.float64, device=device),
        energy=wp.zeros((capacity, regions), dtype=wp.float64, device=device),
        wave=wave,
        shared_wave=wave,
        plate_waves=wp.zeros((own, steps, terms), dtype=real, device=device),
        along_x=wp.zeros((moved, actuators, nx), dtype=wp.float64, device=device),
        along_y=wp.zeros((moved, actuators, ny), dtype=wp.float64, device=device),
        host=HostSide(
            coefficients=beside((capacity, terms, actuators), real),
            units=beside((capacity,), real),
            energy=beside((capacity, regions), wp.float64),
        ),
    )


def shared_wave(wave: wp.array, plates: int) -> wp.array:
    """One wave (steps, terms) as that of so many plates, without a copy: the stride from plate to plate is zero."""
    made: wp.array = wp.array(
        ptr=wave.ptr, dtype=wave.dtype, shape=(plates, *wave.shape), strides=(0, *wave.strides), device=wave.device
    )
    made._ref = wave  # type: ignore[assignment]  # which owns the numbers
    return made
