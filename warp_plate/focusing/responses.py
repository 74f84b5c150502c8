"""Responses of points to held samples of the actuators' pressures, voltages or currents, exact in time.

A pressure of 1 N/m² during one sample, Δ = 1/rate long, moves a point at the end of sample l + 1 by

    h[l] = Σ_p ψ_p (χ_p f) (exp(s_p Δ) − 1)/s_p exp(s_p l Δ)

over the poles of :mod:`warp_plate.modal.poles`. So sums over samples are exact for pressures that are constant between
samples, as a converter without a reconstruction filter holds them.

From them follow the waveforms of one energy that keep the rest of the plate quiet at the moment of the focus. With
amplitudes a = B w of the modes at the moment and G the matrix of the mean square over the rest, they solve

    max g·w   under   |w|² ≤ E,   aᵀ G a ≤ r² (g·w)²,

a convex problem, for the second bound is a cone. Its solution is a multiple of w = (1 + μ BᵀGB)⁻¹ g with a multiplier
μ ≥ 0 of that bound, which is 0 if time reversal, w = g, satisfies it. With G = S² and S B Bᵀ S = V diag(k) Vᵀ,
c = Vᵀ S B g, motion and rest are sums over k,

    g·w = g·g − Σ μ c² / (1 + μ k),   aᵀ G a = Σ c² / (1 + μ k)²,

whose ratio falls as μ grows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import scipy

from warp_plate.modal.coils_in_time import in_time
from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.modal.other_solutions import modes_below
from warp_plate.modal.poles import Poles
from warp_plate.scene.focus import Focus
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

# Numbers of an array of poles and samples, to limit memory.
SAMPLES_AT_ONCE = 2**20
# Range of μ in units of 1 / max k, and halvings of its logarithm.
RANGE, HALVINGS = 1e10, 100


class HeldResponses:
    """Responses of a plate to samples of its actuators' pressures, so many of them; of velocity or displacement."""

    def __init__(self, plate: ModalPlate, rate: int, samples: int, velocity: bool, highest: float = math.inf) -> None:
        """Free motions above ``highest`` [Hz] are left out."""
        poles = plate.poles(samples / rate)
        # One pole of each conjugate pair is enough, counted twice, because motion is real.
        turning = poles.values.imag
        self._poles: Poles = poles.part(np.flatnonzero((turning >= 0) & (turning <= 2 * math.pi * highest)))
        s, self._samples, self._step = self._poles.values, samples, 1 / rate
        one_sample = np.expm1(s * self._step) / (1 if velocity else s)
        self._gains = self._poles.gains(plate.actuator_forces()) * (one_sample * np.where(s.imag > 0, 2, 1))[:, None]
        self.plate = plate

    @classmethod
    def of_scene(cls, scene: Scene, samples: int, velocity: bool | None = None) -> HeldResponses:
        """Return the responses of a scene's plate by its table ``[focus]``; ``velocity`` if not as the table says."""
        table = scene.focus
        assert table is not None
        velocity = table.quantity == "velocity" if velocity is None else velocity
        if not scene.coil_indices:
            plate = modes_below(scene, table.highest, "focus.highest")
            return cls(plate, table.rate, samples, velocity)
        # Higher modes yield to coils, and so take part in the lowest motions of the plate with them.
        plate = in_time(solve_modes(scene, table.highest, key=f"focus.highest {table.highest:g}"))
        return cls(plate, table.rate, samples, velocity, table.highest)

    @property
    def table(self) -> Focus:
        """The scene's table ``[focus]``."""
        table = self.plate.scene.focus
        assert table is not None
        return table

    def at_foci(self) -> np.ndarray:
        """Return h (actuators, foci, samples) [m or m/s per N/m²] at the points of ``[focus]``."""
        shapes = self._poles.observe(self.plate.at_points(self.table.points).T)
        pairs = (self._gains.T[:, None] * shapes).reshape(-1, self._poles.values.size)
        blocks = [pairs.real @ decays.real - pairs.imag @ decays.imag for _, decays in self._decays(self._samples)]
        return np.hstack(blocks).reshape(self._gains.shape[1], len(shapes), -1)

    def states(self, waveforms: np.ndarray) -> np.ndarray:
        """Return the states of the poles (poles, sets) at the end of waveforms (sets, actuators, samples) [N/m²]."""
        sets, actuators, samples = waveforms.shape
        rows, states = waveforms[..., ::-1].reshape(-1, samples).T, np.zeros((self._gains.shape[0], sets))
        for block, decays in self._decays(samples):
            part = rows[block[0] : block[-1] + 1]
            sums = (decays.real @ part + 1j * (decays.imag @ part)).reshape(-1, sets, actuators)
            states = states + np.einsum("psa,pa->ps", sums, self._gains)
        return states

    def states_at(self, waveforms: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return the states (poles, sets) of each set of waveforms at the end of its own sample (sets,)."""
        longest = int(ends.max()) + 1
        # Later samples are left out, and silence is put before, so that all sets end together.
        late = np.zeros((*waveforms.shape[:2], longest))
        for aligned, waveform, end in zip(late, waveforms, ends.tolist(), strict=True):
            played = waveform[:, : end + 1]
            aligned[:, longest - end - 1 :][:, : played.shape[1]] = played
        return self.states(late)

    def end_motions(self, samples: int, waveforms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the modal amplitudes (sets, modes) at the end of waveforms (sets, actuators, samples), and B Bᵀ."""
        modes = self.plate.frequencies.size
        gram = np.zeros((modes, modes))
        for _, _, motions in self._end_blocks(samples):
            gram += motions @ motions.T
        return self.amplitudes(self.states(waveforms)), gram

    def reversed_motions(self, amplitudes: np.ndarray, samples: int) -> np.ndarray:
        """Return Bᵀ times amplitudes (sets, modes), as waveforms (sets, actuators, samples)."""
        waveforms = np.empty((len(amplitudes), self._gains.shape[1], samples))
        for actuator, since_end, motions in self._end_blocks(samples):
            waveforms[:, actuator, samples - 1 - since_end] = amplitudes @ motions
        return waveforms

    def _end_blocks(self, samples: int) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield actuators, samples before the last (block,) and the columns of B (modes, block)."""
        for since_end, decays in self._decays(samples):
            for actuator, gains in enumerate(self._gains.T):
                yield actuator, since_end, np.asarray((self._poles.vectors @ (gains[:, None] * decays)).real)

    def next_states(self, states: np.ndarray, pressures: np.ndarray) -> np.ndarray:
        """Return the states after another sample of pressures (sets, actuators) [N/m²]."""
        return np.asarray(np.exp(self._poles.values * self._step)[:, None] * states + self._gains @ pressures.T)

    def amplitudes(self, states: np.ndarray, rates: bool = False) -> np.ndarray:
        """Return the modal amplitudes (sets, modes) of states, or their rates of change."""
        states = self._poles.values[:, None] * states if rates else states
        return np.asarray((self._poles.vectors @ states).real.T)

    def _decays(self, samples: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield l (block,) of 0 ... samples − 1, block by block, and exp(s l Δ) (poles, block)."""
        values = self._poles.values[:, None] * self._step
        for block in np.array_split(np.arange(samples), -(-samples * len(values) // SAMPLES_AT_ONCE)):
            yield block, np.exp(values * block)


def quiet_optimum(responses: HeldResponses, gains: np.ndarray) -> tuple[np.ndarray, list[bool]]:
    """Return the waveforms (foci, actuators, samples), not yet scaled, and whether each attains the bound.

    Where no waveforms satisfy the bound, return nearly those of the least motion of the rest over that of the focus.
    """
    table = responses.table
    assert table.rest is not None
    samples, ratio = gains.shape[-1], 10 ** (-table.rest.contrast / 20)
    amplitudes, gram = responses.end_motions(samples, gains)
    attained, combined = [], []
    for gain, motion, point in zip(gains, amplitudes, table.points, strict=True):
        root = _root_mean_square(responses.plate, (*point, table.rest.radius))
        values, vectors = scipy.linalg.eigh(root @ gram @ root)
        values, parts = np.maximum(values, 0), vectors.T @ (root @ motion)
        multiplier, holds = _multiplier(values, parts, float((gain**2).sum()), ratio)
        attained.append(holds)
        combined.append(root @ (vectors @ (multiplier * parts / (1 + multiplier * values))))
    return gains - responses.reversed_motions(np.array(combined), samples), attained


def _multiplier(values: np.ndarray, parts: np.ndarray, square: float, ratio: float) -> tuple[float, bool]:
    """Return the smallest μ that satisfies the bound, and whether the bound is attained; 0 and False if it is slack."""

    def excess(multiplier: float) -> float:
        share = 1 / (1 + multiplier * values)
        return float(np.linalg.norm(parts * share) - ratio * (square - (multiplier * parts**2 * share).sum()))

    if excess(0.0) <= 0:
        return 0.0, False
    low, high = 1 / RANGE / values.max(), RANGE / values.max()
    if excess(high) > 0:
        return high, False
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high, True


def _root_mean_square(plate: ModalPlate, disc: tuple[float, float, float]) -> np.ndarray:
    """Return the root S of the matrix of the mean square, by mass, outside a disc x, y, radius [m]."""
    inside = Target(disc=disc)
    outside = plate.kinetic_matrix() - plate.kinetic_matrix(inside, plate.scene.plate.box)
    mass = plate.space.plate_mass - plate.space.region_mass(inside)
    squares, vectors = scipy.linalg.eigh(outside)
    return np.asarray((vectors * np.sqrt(np.maximum(squares, 0) / mass)) @ vectors.T)
