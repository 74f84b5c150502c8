"""The device arrays of a batch of plates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warp_plate.solve.specialize import Specialized

# u, rate, squares, u_next, rate_next; the loads come on top.
FIELDS = 5
# What the moment form needs at most besides: u, mx, my, mxy, the membrane curvature and a strain.
MOMENT_FORM_FIELDS = 6
# Clear the whole batch at once if at least 1/CLEAR_SHARE of it is used: a call for each field takes longer.
CLEAR_SHARE = 4


@dataclass(frozen=True)
class HostBuffers:
    """Host copies of three arrays of a :class:`State`; pinned for CUDA, so that copying does not stop the host."""

    coefficients: wp.array
    units: wp.array
    energy: wp.array


@dataclass
class State:
    """Arrays for up to ``capacity`` plates; fields are (capacity, rows, stride), zero outside the plate."""

    capacity: int  # Largest number of plates
    coefficients: wp.array  # (capacity, terms, actuators) factors of the waves
    loads: wp.array  # (terms, capacity, rows, stride) load fields, see ``kernels.load``
    in_phase: wp.array  # First load field
    quadrature: wp.array  # Second load field
    moves: wp.array  # (5, capacity, rows, stride) the five fields below in one piece
    u: wp.array  # Displacement
    rate: wp.array  # Displacement gained in a step
    squares: wp.array  # Sum of rate² over the window
    u_next: wp.array  # Buffer that takes turns with u on streaming paths; curvature on the others
    rate_next: wp.array  # Buffer that takes turns with rate on streaming paths
    units: wp.array  # (capacity,) displacement [m] of a unit of u
    moving: wp.array  # (capacity,) strength of the moving load, in units of each plate's pressure
    nodes: wp.array  # (traced nodes, 2) row of the field and column
    inner_nodes: wp.array  # (traced nodes, 2) row of the plate and column
    trace: wp.array  # (capacity, traced nodes, steps) displacement of the traced nodes
    column_sums: wp.array  # (capacity, regions, stride) float64 scratch of the energies
    energy: wp.array  # (capacity, regions) float64 weighted sums of squares
    wave: wp.array  # (capacity, steps, terms) waves of the current run, which are one of the next two
    shared_wave: wp.array  # The scene's wave as that of all plates
    plate_waves: wp.array  # A wave for each plate
    along_x: wp.array  # (capacity, actuators, nx) weights of patches that move from plate to plate
    along_y: wp.array  # (capacity, actuators, ny) the same along y
    host: HostBuffers  # Buffers for what is copied to the device and back
    # Further arrays and recorded launches, kept by whoever makes them
    beside: dict[Hashable, Any] = dataclasses.field(default_factory=dict)

    @property
    def has_plate_waves(self) -> bool:
        """True if each plate of the current run has a wave of its own."""
        return self.wave is self.plate_waves

    def clear(self, plates: int) -> None:
        """Put the first plates, and the number beyond them, at rest; the load fields stay."""
        if CLEAR_SHARE * plates >= self.capacity:
            self.moves.zero_()
            return
        for field in (self.u, self.rate, self.squares, self.u_next, self.rate_next):
            field[: plates + 1].zero_()


# advance(state, plates, start, stop) takes the first ``plates`` plates from step ``start`` to ``stop``. When it returns
# the work is done on CPU, and queued on the device's stream on CUDA.
Advance = Callable[[State, int, int, int], None]


def bytes_per_plate(specialized: Specialized, traced_nodes: int) -> int:
    """Return the device memory that one plate takes."""
    itemsize = wp.types.type_size_in_bytes(specialized.real)
    regions, rows, stride = specialized.weights.shape
    effects, steps, discretization = specialized.effects, specialized.scheme.steps, specialized.discretization
    fields = FIELDS + effects.terms + (0 if effects.plain else MOMENT_FORM_FIELDS)
    waves = effects.terms if discretization.carriers else 0
    numbers = fields * rows * stride + (traced_nodes + waves) * steps
    places = specialized.patches.shape[0] * (sum(specialized.scheme.nodes) + 4)
    return numbers * itemsize + 8 * (regions * (stride + 1) + (places if discretization.per_plate.centre else 0))


def make_state(specialized: Specialized, capacity: int, nodes: wp.array | None = None) -> State:
    """Allocate zeroed arrays for ``capacity`` plates.

    Args:
        capacity: Largest number of plates.
        nodes: (traced nodes, 2) row of the field and column of nodes whose displacement is kept (default: none).
    """
    device, real, discretization = specialized.device, specialized.real, specialized.discretization
    regions, steps, (nx, ny) = specialized.weights.shape[0], specialized.scheme.steps, specialized.scheme.nodes
    terms, actuators = specialized.effects.terms, specialized.patches.shape[0]
    nodes = wp.empty((0, 2), dtype=int, device=device) if nodes is None else nodes
    # The moment form's passes on CPU read a number beyond the last plate; it must be zero.
    plates = capacity + (0 if specialized.effects.plain else 1)
    waved = capacity if discretization.carriers else 0
    moved = capacity if discretization.per_plate.centre else 0

    def zeros(*shape: int, dtype: type = real) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=device)

    def buffer(*shape: int, dtype: type = real) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device="cpu", pinned=device.is_cuda)

    loads = zeros(terms, plates, specialized.rows, specialized.stride)
    moves = zeros(FIELDS, plates, specialized.rows, specialized.stride)
    wave = _repeated(specialized.wave, capacity)
    return State(
        capacity=capacity,
        coefficients=zeros(capacity, terms, actuators),
        loads=loads,
        in_phase=loads[0],
        quadrature=loads[1],
        moves=moves,
        u=moves[0],
        rate=moves[1],
        squares=moves[2],
        u_next=moves[3],
        rate_next=moves[4],
        units=zeros(capacity),
        moving=zeros(capacity),
        nodes=nodes,
        inner_nodes=wp.array(nodes.numpy() - np.array([1, 0], np.int32), dtype=int, device=device),
        trace=zeros(capacity, nodes.shape[0], steps),
        column_sums=zeros(capacity, regions, specialized.stride, dtype=wp.float64),
        energy=zeros(capacity, regions, dtype=wp.float64),
        wave=wave,
        shared_wave=wave,
        plate_waves=zeros(waved, steps, terms),
        along_x=zeros(moved, actuators, nx, dtype=wp.float64),
        along_y=zeros(moved, actuators, ny, dtype=wp.float64),
        host=HostBuffers(
            coefficients=buffer(capacity, terms, actuators),
            units=buffer(capacity),
            energy=buffer(capacity, regions, dtype=wp.float64),
        ),
    )


def _repeated(wave: wp.array, plates: int) -> wp.array:
    """Return one wave (steps, terms) as that of all plates, without a copy: the stride between plates is zero."""
    repeated: wp.array = wp.array(
        ptr=wave.ptr, dtype=wave.dtype, shape=(plates, *wave.shape), strides=(0, *wave.strides), device=wave.device
    )
    repeated._ref = wave  # type: ignore[assignment]  # keeps the memory alive
    return repeated
