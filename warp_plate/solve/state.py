"""The device arrays of a batch of plates."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
import warp as wp

from warp_plate.solve.specialize import Specialized

# u, rate, squares, u_next, rate_next; the loads come on top.
FIELDS = 5
# Largest number of further fields of the moment form: u, mx, my, mxy, the membrane curvature and a strain.
MOMENT_FORM_FIELDS = 6
# Clear the whole batch at once if at least 1/CLEAR_SHARE of it is used: a call for each field takes longer.
CLEAR_SHARE = 4


class State:
    """Zeroed arrays for up to ``capacity`` plates; fields are (capacity, rows, stride), zero outside the plate.

    Args:
        specialized: The scene on the device.
        capacity: Largest number of plates.
        nodes: (traced nodes, 2) row of the field and column of nodes whose displacement is kept (default: none).
    """

    def __init__(self, specialized: Specialized, capacity: int, nodes: wp.array | None = None) -> None:
        device, real, discretization = specialized.device, specialized.real, specialized.discretization
        regions, rows, stride = specialized.weights.shape
        (nx, ny), steps, terms = specialized.scheme.nodes, specialized.scheme.steps, specialized.effects.terms
        actuators = specialized.patches.shape[0]
        # The moment form's passes on CPU read a number beyond the last plate; it must be zero.
        plates = capacity + (0 if specialized.effects.plain else 1)
        waved = capacity if discretization.carriers else 0
        moved = capacity if discretization.per_plate.centre else 0

        def zeros(*shape: int, dtype: type = real) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=device)

        def on_host(*shape: int, dtype: type = real) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device="cpu", pinned=device.is_cuda)

        self.capacity = capacity  # Largest number of plates
        self.coefficients = zeros(capacity, terms, actuators)  # Factors of the waves
        self.loads = zeros(terms, plates, rows, stride)  # Load fields, see ``kernels.load``
        self.in_phase, self.quadrature = self.loads[0], self.loads[1]  # The first two
        self.moves = zeros(FIELDS, plates, rows, stride)  # The five fields below in one piece
        self.u = self.moves[0]  # Displacement
        self.rate = self.moves[1]  # Displacement gained in a step
        self.squares = self.moves[2]  # Sum of rate² over the window
        self.u_next = self.moves[3]  # Buffer that takes turns with u on streaming paths; curvature on the others
        self.rate_next = self.moves[4]  # Buffer that takes turns with rate on streaming paths
        self.units = zeros(capacity)  # Displacement [m] of a unit of u
        self.moving = zeros(capacity)  # Strength of the moving load, in units of each plate's pressure
        self.nodes = wp.empty((0, 2), dtype=int, device=device) if nodes is None else nodes
        inner_nodes = self.nodes.numpy() - np.array([1, 0], np.int32)
        self.inner_nodes: wp.array = wp.array(inner_nodes, dtype=int, device=device)  # ``nodes`` by row of the plate
        self.trace = zeros(capacity, self.nodes.shape[0], steps)  # Displacement of the traced nodes
        self.column_sums = zeros(capacity, regions, stride, dtype=wp.float64)  # Scratch of the energies
        self.energy = zeros(capacity, regions, dtype=wp.float64)  # Weighted sums of squares
        self.shared_wave = _repeated(specialized.wave, capacity)  # The scene's wave as that of all plates
        self.plate_waves = zeros(waved, steps, terms)  # A wave for each plate
        self.wave = self.shared_wave  # (capacity, steps, terms) waves of the current run: shared_wave or plate_waves
        self.along_x = zeros(moved, actuators, nx, dtype=wp.float64)  # Weights of patches that differ between plates
        self.along_y = zeros(moved, actuators, ny, dtype=wp.float64)  # The same along y
        # Host copies, pinned for CUDA, so that copying does not stop the host
        self.host_coefficients = on_host(capacity, terms, actuators)
        self.host_units = on_host(capacity)
        self.host_energy = on_host(capacity, regions, dtype=wp.float64)
        self.beside: dict[Hashable, Any] = {}  # Further arrays and recorded launches of the paths

    @property
    def has_plate_waves(self) -> bool:
        """True if each plate of the current run has separate waves."""
        return self.wave is self.plate_waves

    def take_turns(self) -> None:
        """Exchange the fields with those that the last launch wrote."""
        self.u, self.u_next = self.u_next, self.u
        self.rate, self.rate_next = self.rate_next, self.rate

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


def _repeated(wave: wp.array, plates: int) -> wp.array:
    """Return one wave (steps, terms) as that of all plates, without a copy: the stride between plates is zero."""
    repeated: wp.array = wp.array(
        ptr=wave.ptr, dtype=wave.dtype, shape=(plates, *wave.shape), strides=(0, *wave.strides), device=wave.device
    )
    repeated._ref = wave  # type: ignore[assignment]  # keeps the memory alive
    return repeated
