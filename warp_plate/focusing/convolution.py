"""Motion of the foci under waveforms as a linear map, by Fourier transforms with zeros, and its transpose."""

from __future__ import annotations

import numpy as np
import scipy


class Convolution:
    """The map u = A w from waveforms (sets, actuators, played) to motion (sets, foci, samples).

    Args:
        h: (actuators, foci, samples) responses, h[..., l] that at sample l + 1 to a sample at 0.
        played: Number of samples of the waveforms, which may end before the motion.
    """

    def __init__(self, h: np.ndarray, played: int) -> None:
        self.actuators, _, self.samples = h.shape
        self.played = played
        self._length = scipy.fft.next_fast_len(2 * self.samples, real=True)
        self._spectra = self.transform(h)

    def move(self, waveforms: np.ndarray) -> np.ndarray:
        """Return A w."""
        return self.invert(self.transform(waveforms) @ self._spectra)

    def reverse(self, motion: np.ndarray) -> np.ndarray:
        """Return Aᵀ u (sets, actuators, played): motion (sets, foci, samples) through responses in reverse."""
        return self.invert(self.transform(motion) @ self._spectra.conj().mT)[..., : self.played]

    def gram(self, by_actuators: bool = False) -> np.ndarray:
        """Return (frequencies, foci, foci) products of the responses' spectra, A Aᵀ without its ends.

        Args:
            by_actuators: Return those of Aᵀ A, (frequencies, actuators, actuators).
        """
        if by_actuators:
            return self._spectra @ self._spectra.conj().mT
        return self._spectra.conj().mT @ self._spectra

    def transform(self, rows: np.ndarray) -> np.ndarray:
        """Return (frequencies, sets, rows) spectra of rows (sets, rows, samples) with zeros after them."""
        return np.ascontiguousarray(np.moveaxis(scipy.fft.rfft(rows, self._length), -1, 0))

    def invert(self, spectra: np.ndarray) -> np.ndarray:
        """Return the rows (sets, rows, samples) of spectra."""
        return np.asarray(scipy.fft.irfft(np.moveaxis(spectra, 0, -1), self._length)[..., : self.samples])
