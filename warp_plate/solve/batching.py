"""A batch of plates on a device: scaled drives in, displacements, energies and faults in SI units out.

At a stable step the scheme's energy grows only by the work of the load. So after n steps no rate exceeds n times the
norm of a step's load, apart from factors that a step next to the limit and unequal masses bring. A rate above that by
the factor SLACK is unstable growth.
"""

import math
from collections.abc import Callable

import numpy as np
import warp as wp

from warp_plate.kernels.energy import make_keep_largest, write_energies
from warp_plate.kernels.loads import make_scale_drives
from warp_plate.plate.designs import PerPlateValues
from warp_plate.plate.signals import Signals
from warp_plate.scene.errors import SceneError
from warp_plate.solve.compiled_scene import CompiledScene
from warp_plate.solve.run import Faults, find_faults
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State

# Sizes of drives [N/m²] whose energies, which go with the square, keep full precision.
SMALLEST_DRIVE, LARGEST_DRIVE = 1e-130, 1e130
# At a step next to the limit, rates are some ten times what the load's work gives; unequal masses take the rest.
SLACK = 1e3
# Steps, or node-steps of large batches, between two checks of plates that may grow.
CHECK_STEPS, CHECK_NODE_STEPS = 16, {"cpu": 2e7, "cuda": 2e9}
# Exceptions of producers and Warp for arrays that cannot be shared.
REFUSALS = (AttributeError, BufferError, IndexError, RuntimeError, TypeError, ValueError)


class Batch:
    """A batch of plates, stepped from rest at t = 0 under drives of the host or of the device."""

    def __init__(self, compiled: CompiledScene, state: State, plates: int) -> None:
        self.compiled, self.state, self.plates = compiled, state, plates
        self.grown = np.full(plates, -1)  # Step at which a plate was seen to grow without bound, or −1
        self.step = 0  # Steps taken
        self.largest_rate = SLACK * compiled.specialized.largest_rate_per_step
        moving = compiled.specialized.discretization.moving
        self.least = moving.largest if moving else 0.0  # Pressure that all plates have beside their drives [N/m²]
        self._summed = False
        self._largest: wp.array | None = None
        self._samplers: dict[int, wp.Launch] = {}

    def load(self, phasors: np.ndarray, values: PerPlateValues, whole: bool = False) -> None:
        """Put the plates at rest under drives of the host, or ``whole``: queue all their steps and sums too."""
        specialized, state = self.compiled.specialized, self.state
        self.phasors = phasors
        sizes = self.compiled.put_waves(state, values)
        coefficients = state.host_coefficients.numpy()
        self.scale = scaled_coefficients(specialized.discretization.signals, phasors, sizes, self.least, coefficients)
        if not specialized.effects.plain:
            with np.errstate(over="ignore", invalid="ignore"):  # of plates whose drive is not finite
                state.host_units.numpy()[: self.plates] = self.scale * specialized.scheme.load_scale
            wp.copy(state.units, state.host_units, count=self.plates)
        if self.least:
            strength = np.zeros(state.capacity)
            strength[: self.plates] = self.least / np.where(self.scale == 0, 1, self.scale)
            state.travelling.assign(strength.astype(specialized.scene.grid.precision))
        if whole:
            self.compiled.run_whole(state, self.plates)
            self.step, self._summed = specialized.scheme.steps, True
        else:
            self.compiled.load_drives(state, self.plates, values.edges)
            state.clear(self.plates)

    def load_on_device(self, drives: wp.array) -> None:
        """Put the plates at rest under drives (plates, actuators, 2) on the device: Re Z, Im Z."""
        specialized, state = self.compiled.specialized, self.state
        state.use_waves(per_plate=False)
        self._device_scale = wp.empty(self.plates, dtype=wp.float64, device=specialized.device)
        with specialized.compiling_late():
            kernel = make_scale_drives(specialized.real, drives.dtype)
            specialized.load(kernel)
        wp.launch(
            kernel,
            dim=self.plates,
            inputs=[drives, specialized.drive_factors, self.least, SMALLEST_DRIVE, LARGEST_DRIVE]
            + [specialized.scheme.load_scale],
            outputs=[state.coefficients, self._device_scale, state.units, state.travelling],
            device=specialized.device,
        )
        self.compiled.write_loads(state, self.plates)
        state.clear(self.plates)

    def advance(self, stop: int) -> None:
        """Take the plates to step ``stop``; on CUDA the work is queued."""
        if stop > self.step:
            self.compiled.advance(self.state, self.plates, self.step, stop)
            self.step = stop

    def check_growth(self) -> bool:
        """Look for plates that grow without bound; return whether all do."""
        rate = self.state.rate.numpy()[: self.plates]
        largest = np.maximum(rate.max(axis=(1, 2)), -rate.min(axis=(1, 2)))
        self.grown[(self.grown < 0) & ~(largest <= self.step * self.largest_rate)] = self.step  # or not a number
        return bool((self.grown >= 0).all())

    @property
    def largest_sum(self) -> float:
        """Largest sum of rate² of a bounded plate."""
        scheme = self.compiled.specialized.scheme
        return float((scheme.window[1] - scheme.window[0]) * (scheme.steps * self.largest_rate) ** 2)

    @property
    def displacement(self) -> np.ndarray:
        """(plates, ny, nx) displacement [m]."""
        return self._field(self.state.u, self.compiled.specialized.scheme.load_scale)

    def sample_peak(self) -> None:
        """Compare the displacement of each node with the largest one sampled before; on CUDA the work is queued."""
        u, specialized = self.state.u[: self.plates], self.compiled.specialized
        if self._largest is None:
            self._largest = wp.zeros_like(u)
        if u.ptr not in self._samplers:  # fields of some paths alternate
            with specialized.compiling_late():
                kernel = make_keep_largest(specialized.real)
                specialized.load(kernel)
            self._samplers[u.ptr] = wp.launch(
                kernel, dim=u.shape, inputs=[u], outputs=[self._largest], device=specialized.device, record_cmd=True
            )
        self._samplers[u.ptr].launch()

    @property
    def peak(self) -> np.ndarray:
        """(plates, ny, nx) largest magnitude of the displacements that were sampled [m]."""
        assert self._largest is not None
        return self._field(self._largest, self.compiled.specialized.scheme.load_scale)

    @property
    def velocity(self) -> np.ndarray:
        """(plates, ny, nx) velocity half a step before the displacement [m/s]."""
        return self._field(self.state.rate, speed_unit(self.compiled.specialized))

    def _field(self, field: wp.array, unit: float) -> np.ndarray:
        nx, ny = self.compiled.specialized.scheme.nodes
        values = field[: self.plates].numpy()[:, 1 : ny + 1, :nx].astype(float)
        with np.errstate(over="ignore", invalid="ignore"):
            values *= (self.scale * unit)[:, None, None]
        return values

    def trace(self, shares: np.ndarray) -> np.ndarray:
        """Return (plates, points, steps) displacements of points [m], NaN from ``step`` on."""
        corners = self.state.trace.numpy()[: self.plates]
        corners = corners.reshape(self.plates, len(shares), 4, -1).astype(float)
        with np.errstate(over="ignore", invalid="ignore"):
            unit = (self.scale * self.compiled.specialized.scheme.load_scale)[:, None, None]
            trace: np.ndarray = np.einsum("mpcn,pc->mpn", corners, shares) * unit
        trace[:, :, self.step :] = np.nan
        return trace

    def queue_energies(self) -> Callable[[np.ndarray], Faults]:
        """Queue the sums of the energies, unless ``load`` did; return a function that waits for them.

        It writes the energies (plates, regions) [J] into an array and returns the faulty plates, see ``Run.faults``.
        """
        specialized, scheme = self.compiled.specialized, self.compiled.specialized.scheme
        if not self._summed:
            self.compiled.sums_to_host(self.state, self.plates)
        sums = self.compiled.wait_for_sums(self.state, self.plates)

        def finish(energy: np.ndarray) -> Faults:
            unit = energy_unit(specialized)
            faults = find_faults(self.phasors, self.scale, self.grown, sums(), unit, self.largest_sum, energy)
            times = np.where(self.grown >= 0, self.grown * scheme.time_step, math.nan)
            return {plate: (fault, float(times[plate])) for plate, fault in faults.items()}

        return finish

    def write_energies(self, energy: wp.array) -> None:
        """Write the energies (plates, regions) [J] of the window's steps so far, NaN for faulty plates."""
        specialized, scale = self.compiled.specialized, self._device_scale
        if (self.grown >= 0).any():
            scale.assign(np.where(self.grown >= 0, np.nan, scale.numpy()))
        self.compiled.sum_regions(self.state, self.plates)
        inputs = [self.state.energy, scale, energy_unit(specialized), self.largest_sum]
        wp.launch(write_energies, dim=self.plates, inputs=inputs, outputs=[energy], device=specialized.device)


def scaled_coefficients(
    signals: Signals, phasors: np.ndarray, sizes: np.ndarray, least: float, coefficients: np.ndarray
) -> np.ndarray:
    """Write the coefficients of plates, each in units of the plate's largest pressure [N/m²], and return these.

    They are NaN where energies would not keep full precision, and at least ``least``, the pressure of the moving load.
    ``sizes`` (1 or plates, terms) are the factors that the waves were divided by.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a drive that is not finite spoils its own plate alone
        # Plates innermost: NumPy is slow along short rows.
        columns = signals.coefficients(phasors).transpose(1, 2, 0)
        columns *= sizes.T[:, None]
        scale: np.ndarray = np.maximum(np.abs(columns).max(axis=(0, 1)), least)
        scale[(scale != 0) & ~((scale >= SMALLEST_DRIVE) & (scale <= LARGEST_DRIVE))] = np.nan
        columns /= np.where(scale == 0, 1, scale)
        coefficients[: len(phasors)] = columns.transpose(2, 0, 1)
    return scale


def speed_unit(specialized: Specialized) -> float:
    """Return the velocity [m/s] of a rate of one under a pressure of 1 N/m²; the displacement [m] for displacements."""
    scheme = specialized.scheme
    return scheme.load_scale / (scheme.time_step if specialized.quantity == "velocity" else 1.0)


def energy_unit(specialized: Specialized) -> float:
    """Return the energy, averaged over the window, of a sum of rate² of one: ½ρH·hx·hy·speed²/steps [J]."""
    scheme = specialized.scheme
    (hx, hy), (first, last) = scheme.spacing, scheme.window
    return 0.5 * scheme.surface_density * hx * hy * speed_unit(specialized) ** 2 / (last - first)


def steps_between_checks(specialized: Specialized, plates: int) -> int | None:
    """Return after how many steps to check for growth; None for plates that cannot grow.

    Plates may grow above the stability limit, and where they stretch.
    """
    if not specialized.scheme.stable:
        return CHECK_STEPS
    if not specialized.effects.membrane:
        return None
    work = CHECK_NODE_STEPS["cuda" if specialized.device.is_cuda else "cpu"]
    return max(CHECK_STEPS, int(work / (plates * specialized.interior_nodes)))


def import_drives(drives: object, actuators: int, device: wp.Device) -> wp.array:
    """Return drives as a Warp array (plates, actuators, 2) over the same memory, which the array keeps alive.

    Warp's current stream of the device waits for what the producer has queued on its own.
    """
    right = f"write Re Z and Im Z as (plates, {actuators}, 2) of float32 or float64"
    try:
        pairs = wp.from_dlpack(drives)
    except REFUSALS as error:
        raise SceneError(f"drives: not an array for a device ({' '.join(str(error).split())}); {right}") from None
    if not isinstance(pairs, wp.array) or pairs.dtype not in (wp.float32, wp.float64):
        raise SceneError(f"drives: an array of {pairs.dtype.__name__}; {right}")
    if pairs.ndim != 3 or pairs.shape[1:] != (actuators, 2):
        raise SceneError(f"drives: shape {pairs.shape}; {right}")
    if pairs.device != device:
        raise SceneError(f"drives: on {pairs.device}, but the solver is on {device}; make both on one device")
    return pairs
