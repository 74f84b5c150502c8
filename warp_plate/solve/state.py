"""The device arrays of a batch of plates."""

from collections.abc import Callable, Hashable
from typing import Any

import warp as wp

from warp_plate.kernels.coils import STATE as COIL_STATE
from warp_plate.kernels.update import make_state
from warp_plate.solve.specialize import Specialized

# u, rate, squares, u_next, rate_next; the loads come on top.
FIELDS = 5
# Largest number of further fields of the moment form: u, mx, my, mxy, the membrane curvature and a strain.
MOMENT_FORM_FIELDS = 6
# Clear the whole batch at once if at least 1/CLEAR_SHARE of it is used: a call for each field takes longer.
CLEAR_SHARE = 4


class State:
    """Zeroed arrays for up to ``capacity`` plates; fields are (capacity, rows, stride), zero outside the plate.

    ``nodes`` (traced nodes, 2) has the row and column of nodes whose displacement is kept.
    """

    def __init__(self, specialized: Specialized, capacity: int, nodes: wp.array | None = None) -> None:
        device, real, discretization = specialized.device, specialized.real, specialized.discretization
        regions, rows, stride = specialized.weights.shape
        (nx, ny), steps, terms = specialized.scheme.nodes, specialized.scheme.steps, specialized.effects.terms
        actuators = specialized.patches.shape[0]
        # The moment form's passes on CPU read a number beyond the last plate; it must be zero.
        plates = capacity + (0 if specialized.effects.plain else 1)
        with_waves = capacity if discretization.carriers else 0
        with_places = capacity if discretization.per_plate.centre else 0

        def zeros(*shape: int, dtype: type = real) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=device)

        def on_host(*shape: int, dtype: type = real) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device="cpu", pinned=device.is_cuda)

        self.specialized = specialized
        self.capacity = capacity  # Largest number of plates
        self.coefficients = zeros(capacity, terms, actuators)  # Factors of the waves
        self.loads = zeros(terms, plates, rows, stride)  # Load fields, see ``kernels.loads``
        self.in_phase, self.quadrature = self.loads[0], self.loads[1]  # The first two
        self.fields_memory = zeros(FIELDS, plates, rows, stride)  # The five fields below in one piece
        self.u = self.fields_memory[0]  # Displacement
        self.rate = self.fields_memory[1]  # Displacement gained in a step
        self.squares = self.fields_memory[2]  # Sum of rate² over the window
        self.u_next = self.fields_memory[3]  # Alternates with u on streaming paths; holds the curvature on the others
        self.rate_next = self.fields_memory[4]  # Alternates with rate on streaming paths
        self.attached = zeros(capacity, attached_masses(specialized), 2)  # Displacements and rates of attached masses
        self.coils = zeros(capacity, len(specialized.coils), COIL_STATE + specialized.effects.branches)
        self.units = zeros(capacity)  # Displacement [m] of a unit of u
        self.travelling = zeros(capacity)  # Strength of the load that travels, in units of each plate's pressure
        self.nodes = wp.empty((0, 2), dtype=int, device=device) if nodes is None else nodes
        self.trace = zeros(capacity, self.nodes.shape[0], steps)  # Displacement of the traced nodes
        self.column_sums = zeros(capacity, regions, stride, dtype=wp.float64)  # Scratch of the energies
        self.energy = zeros(capacity, regions, dtype=wp.float64)  # Weighted sums of squares
        self.plate_waves = zeros(with_waves, steps, terms)  # A wave for each plate
        self.along_x = zeros(with_places, actuators, nx, dtype=wp.float64)  # Weights of each plate's patches
        self.along_y = zeros(with_places, actuators, ny, dtype=wp.float64)  # The same along y
        # Host copies, pinned for CUDA, so that copying does not stop the host
        self.host_coefficients = on_host(capacity, terms, actuators)
        self.host_units = on_host(capacity)
        self.host_energy = on_host(capacity, regions, dtype=wp.float64)
        # Launches that can be repeated, by what they launch; see ``streaming.repeat``
        self.recordings: dict[Hashable, Callable[..., object]] = {}
        self.whole_runs: set[tuple[int, bool]] = set()  # (plates, per-plate waves) of runs that were queued once
        self._scratch: dict[str, wp.array] = {}
        # Arguments of kernels: the drive, the fields, and those that a launch with alternating buffers writes
        Forcing, Fields = make_state(real)
        self.drive: Any = Forcing()
        self.drive.loads, self.drive.in_phase, self.drive.quadrature = self.loads, self.in_phase, self.quadrature
        self.drive.units, self.drive.travelling = self.units, self.travelling
        self.drive.coefficients = self.coefficients
        self.fields, self.next_fields = Fields(), Fields()
        self.next_fields.u, self.next_fields.rate = self.u_next, self.rate_next
        self.fields.u, self.fields.rate = self.u, self.rate
        for fields in (self.fields, self.next_fields):
            fields.squares, fields.attached, fields.coils = self.squares, self.attached, self.coils
            fields.nodes, fields.trace = self.nodes, self.trace
        self.use_waves(per_plate=False)

    def use_waves(self, per_plate: bool) -> None:
        """Choose the waves of the current run: ``plate_waves``, or the scene's wave for all plates."""
        self.has_plate_waves = per_plate
        wave = self.specialized.wave
        # The scene's wave as that of all plates, without a copy: the stride between plates is zero.
        self.drive.wave = self.plate_waves if per_plate else wp.array(
            ptr=wave.ptr, dtype=wave.dtype, shape=(self.capacity, *wave.shape), strides=(0, *wave.strides),
            device=wave.device,
        )  # fmt: skip

    def alternate(self) -> None:
        """Exchange the fields with those that the last launch wrote."""
        self.u, self.u_next = self.u_next, self.u
        self.rate, self.rate_next = self.rate_next, self.rate
        self.fields, self.next_fields = self.next_fields, self.fields

    def scratch(self, name: str, *shape: int) -> wp.array:
        """Return an array for a path's use between its launches, zero when first asked for."""
        if name not in self._scratch:
            self._scratch[name] = wp.zeros(shape, dtype=self.specialized.real, device=self.specialized.device)
        return self._scratch[name]

    def clear(self, plates: int) -> None:
        """Put the first plates, and the number beyond them, at rest; the load fields stay."""
        for states in (self.attached, self.coils):
            if states.size:
                states.zero_()
        if CLEAR_SHARE * plates >= self.capacity:
            self.fields_memory.zero_()
            return
        for field in (self.u, self.rate, self.squares, self.u_next, self.rate_next):
            field[: plates + 1].zero_()


# advance(state, plates, start, stop) takes the first ``plates`` plates from step ``start`` to ``stop``. When it returns
# the work is done on CPU, and queued on the device's stream on CUDA.
Advance = Callable[[State, int, int, int], None]


def attached_masses(specialized: Specialized) -> int:
    """Return how many masses are attached to the plate."""
    bending = specialized.scheme.bending
    return len(bending.attachments) if bending is not None else 0


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
