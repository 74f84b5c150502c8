"""Responses of points to held samples of the actuators' pressures, exact in time.

A pressure of 1 N/m² during one sample, Δ = 1/rate long, moves a point at the end of sample l + 1 by

    h[l] = Σ_p ψ_p (χ_p f) (exp(s_p Δ) − 1)/s_p exp(s_p l Δ)

over the poles of :mod:`warp_plate.modal.poles`. So sums over samples are exact for pressures that are constant between
samples, as a converter without a reconstruction filter holds them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles

# Numbers of an array of poles and samples, to limit memory.
BLOCK = 2**20


class HeldResponses:
    """Responses of a plate to samples of its actuators' pressures.

    Args:
        plate: Modes.
        rate: Samples a second.
        samples: Number of samples after which motion is wanted.
        velocity: Whether motion is velocity, not displacement.
    """

    def __init__(self, plate: ModalPlate, rate: int, samples: int, velocity: bool) -> None:
        every = plate.poles(samples / rate)
        # One pole of each conjugate pair is enough, counted twice, because motion is real.
        self._poles: Poles = every.part(np.flatnonzero(every.values.imag >= 0))
        s, self._samples, self._step = self._poles.values, samples, 1 / rate
        one_sample = np.expm1(s * self._step) / (1 if velocity else s)
        self._gains = self._poles.gains(plate.actuator_forces()) * (one_sample * np.where(s.imag > 0, 2, 1))[:, None]
        self.plate = plate

    def at_points(self, points: Sequence[tuple[float, float]]) -> np.ndarray:
        """Return h (actuators, points, samples) [m or m/s per N/m²] at points (x, y) [m]."""
        shapes = self._poles.observe(self.plate.at_points(points).T)
        pairs = (self._gains.T[:, None] * shapes).reshape(-1, self._poles.values.size)
        blocks = [pairs.real @ decays.real - pairs.imag @ decays.imag for decays in self._decays(self._samples)]
        return np.hstack(blocks).reshape(self._gains.shape[1], len(points), -1)

    def states(self, waveforms: np.ndarray) -> np.ndarray:
        """Return the states of the poles (poles, sets) at the end of waveforms (sets, actuators, samples) [N/m²]."""
        sets, actuators, samples = waveforms.shape
        rows, first, states = waveforms[..., ::-1].reshape(-1, samples).T, 0, np.zeros((self._gains.shape[0], sets))
        for decays in self._decays(samples):
            part = rows[first : first + decays.shape[1]]
            first += decays.shape[1]
            moved = (decays.real @ part + 1j * (decays.imag @ part)).reshape(-1, sets, actuators)
            states = states + np.einsum("psa,pa->ps", moved, self._gains)
        return states

    def states_at(self, waveforms: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return the states (poles, sets) of each set of waveforms at the end of its own sample (sets,)."""
        longest = int(ends.max()) + 1
        # Later samples are left out, and silence is put before, so that all sets end together.
        late = np.zeros((*waveforms.shape[:2], longest))
        for aligned, each, end in zip(late, waveforms, ends.tolist(), strict=True):
            heard = each[:, : end + 1]
            aligned[:, longest - end - 1 :][:, : heard.shape[1]] = heard
        return self.states(late)

    def end_motions(self, samples: int, waveforms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the modal amplitudes (sets, modes) at the end of waveforms (sets, actuators, samples), and B Bᵀ.

        B is the matrix (modes, actuators · samples) of the amplitudes at the end under each sample.
        """
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
        first = 0
        for decays in self._decays(samples):
            since_end = np.arange(first, first + decays.shape[1])
            first += decays.shape[1]
            for actuator, gains in enumerate(self._gains.T):
                yield actuator, since_end, np.asarray((self._poles.vectors @ (gains[:, None] * decays)).real)

    def next_states(self, states: np.ndarray, pressures: np.ndarray) -> np.ndarray:
        """Return the states after another sample of pressures (sets, actuators) [N/m²]."""
        return np.asarray(np.exp(self._poles.values * self._step)[:, None] * states + self._gains @ pressures.T)

    def amplitudes(self, states: np.ndarray, rates: bool = False) -> np.ndarray:
        """Return the modal amplitudes (sets, modes) of states, or their rates of change."""
        turned = self._poles.values[:, None] * states if rates else states
        return np.asarray((self._poles.vectors @ turned).real.T)

    def _decays(self, samples: int) -> Iterator[np.ndarray]:
        """Yield exp(s l Δ) (poles, block) of l = 0 ... samples − 1, block by block."""
        values = self._poles.values[:, None] * self._step
        for block in np.array_split(np.arange(samples), -(-samples * len(values) // BLOCK)):
            yield np.exp(values * block)
