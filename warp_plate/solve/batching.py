"""A batch of plates on a device."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import warp as wp

from warp_plate.plate.designs import PerPlateValues
from warp_plate.plate.signals import Signals
from warp_plate.solve.engine import Engine
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State
from warp_plate.solve.status import exceeds, find_faults

# Sizes of drives [N/m²] whose energies, which go with the square, keep full precision.
SMALLEST_DRIVE, LARGEST_DRIVE = 1e-130, 1e130


class Batch:
    """A batch of plates, stepped from rest at t = 0.

    Attributes:
        engine: The compiled kernels.
        state: The plates' arrays.
        plates: Number of plates, the first of the state.
        grown: (plates,) step at which a plate was seen to grow without bound, or −1.
        step: Number of steps taken.
    """

    def __init__(self, engine: Engine, state: State, plates: int) -> None:
        self.engine, self.state, self.plates = engine, state, plates
        self.grown = np.full(plates, -1)
        self.step = 0

    def advance(self, stop: int) -> None:
        """Take the plates to step ``stop``; on CUDA the work is queued."""
        if stop > self.step:
            self.engine.advance(self.state, self.plates, self.step, stop)
            self.step = stop

    def check_growth(self) -> bool:
        """Look for plates that grow without bound; return whether all do."""
        rate = self.state.rate.numpy()[: self.plates]
        self.grown[(self.grown < 0) & exceeds(rate, self.step * self.engine.largest_rate)] = self.step
        return bool((self.grown >= 0).all())

    @property
    def largest_sum(self) -> float:
        """Largest sum of rate² of a bounded plate."""
        scheme = self.engine.specialized.scheme
        return float((scheme.window[1] - scheme.window[0]) * (scheme.steps * self.engine.largest_rate) ** 2)


class PlateBatch(Batch):
    """A batch under drives of the host; results are in SI units.

    Attributes:
        phasors: (plates, actuators) drives.
        scale: (plates,) pressure that each plate is scaled by [N/m²]; not finite if its drive is not.

    Args:
        whole: Leave it to ``run_whole`` to load the drives, to clear the plates and to step them.
    """

    def __init__(
        self, engine: Engine, state: State, phasors: np.ndarray, values: PerPlateValues, whole: bool = False
    ) -> None:
        super().__init__(engine, state, len(phasors))
        self.phasors = phasors
        specialized = engine.specialized
        moving = specialized.discretization.moving
        least = moving.largest if moving else 0.0
        sizes = engine.per_plate.put_waves(state, values)
        coefficients = state.host_coefficients.numpy()
        self.scale = scaled_coefficients(specialized.discretization.signals, phasors, sizes, least, coefficients)
        self.whole = whole
        self._largest: wp.array | None = None
        self._samplers: dict[int, Callable[[], None]] = {}
        if not whole:
            engine.load_drives(state, len(phasors), values.edges)
        if not specialized.effects.plain:
            with np.errstate(over="ignore", invalid="ignore"):  # of plates whose drive is not finite
                state.host_units.numpy()[: len(phasors)] = self.scale * specialized.scheme.load_scale
            wp.copy(state.units, state.host_units, count=len(phasors))
        if moving:
            strength = np.zeros(state.capacity)
            strength[: len(phasors)] = least / np.where(self.scale == 0, 1, self.scale)
            state.moving.assign(strength.astype(specialized.scene.grid.precision))
        if not whole:
            state.clear(len(phasors))

    def run_whole(self) -> None:
        """Queue all steps, and the sums of the energies."""
        self.engine.run_whole(self.state, self.plates)
        self.step = self.engine.specialized.scheme.steps

    @property
    def displacement(self) -> np.ndarray:
        """(plates, ny, nx) displacement [m]."""
        return self._field(self.state.u, self.engine.specialized.scheme.load_scale)

    def sample_peak(self) -> None:
        """Compare the displacement of each node with the largest one sampled before; on CUDA the work is queued."""
        if self._largest is None:
            self._largest = wp.zeros_like(self.state.u[: self.plates])
        u = self.state.u
        if u.ptr not in self._samplers:  # fields of some paths take turns
            self._samplers[u.ptr] = self.engine.keep_largest(u[: self.plates], self._largest)
        self._samplers[u.ptr]()

    @property
    def peak(self) -> np.ndarray:
        """(plates, ny, nx) largest magnitude of the displacements that were sampled [m]."""
        assert self._largest is not None
        return self._field(self._largest, self.engine.specialized.scheme.load_scale)

    @property
    def velocity(self) -> np.ndarray:
        """(plates, ny, nx) velocity half a step before the displacement [m/s]."""
        return self._field(self.state.rate, speed_unit(self.engine.specialized))

    def _field(self, field: wp.array, unit: float) -> np.ndarray:
        nx, ny = self.engine.specialized.scheme.nodes
        values = field[: len(self.phasors)].numpy()[:, 1 : ny + 1, :nx].astype(float)
        with np.errstate(over="ignore", invalid="ignore"):
            values *= (self.scale * unit)[:, None, None]
        return values

    def trace(self, shares: np.ndarray) -> np.ndarray:
        """Return (plates, points, steps) displacements of points [m], NaN from ``step`` on.

        Args:
            shares: (points, 4) weights of the four nodes around each point, see ``weights.bilinear``.
        """
        corners = self.state.trace.numpy()[: len(self.phasors)]
        corners = corners.reshape(len(self.phasors), len(shares), 4, -1).astype(float)
        with np.errstate(over="ignore", invalid="ignore"):
            unit = (self.scale * self.engine.specialized.scheme.load_scale)[:, None, None]
            trace: np.ndarray = np.einsum("mpcn,pc->mpn", corners, shares) * unit
        trace[:, :, self.step :] = np.nan
        return trace

    def queue_energies(self) -> Callable[[np.ndarray], dict[int, tuple[str, float]]]:
        """Queue the sums of the energies, unless ``run_whole`` did.

        Returns:
            Function that waits for the sums, writes the energies (plates, regions) [J] into an array, and returns the
            faulty plates with fault and time, see ``Run.faults``.
        """
        specialized, scheme = self.engine.specialized, self.engine.specialized.scheme
        if not self.whole:
            self.engine.sums_to_host(self.state, self.plates)
        sums = self.engine.wait_for_sums(self.state, self.plates)

        def finish(energy: np.ndarray) -> dict[int, tuple[str, float]]:
            unit = energy_unit(specialized)
            faults = find_faults(self.phasors, self.scale, self.grown, sums(), unit, self.largest_sum, energy)
            times = np.where(self.grown >= 0, self.grown * scheme.time_step, math.nan)
            return {plate: (fault, float(times[plate])) for plate, fault in faults.items()}

        return finish


def scaled_coefficients(
    signals: Signals, phasors: np.ndarray, sizes: np.ndarray, least: float, coefficients: np.ndarray
) -> np.ndarray:
    """Write the coefficients of plates, each in units of the plate's largest pressure, and return the pressures.

    Args:
        phasors: (plates, actuators) drives.
        sizes: (1 or plates, terms) factors that the waves were divided by.
        least: Pressure of the moving load, which all plates have [N/m²].
        coefficients: (capacity, terms, actuators), written.

    Returns:
        (plates,) pressure [N/m²] of each plate; NaN where its energies would not keep full precision.
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
