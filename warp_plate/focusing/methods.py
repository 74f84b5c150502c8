"""Waveforms of actuators that focus: plain NumPy over impulse responses.

Waveforms w of samples n = 0 ... N − 1, held between them, move the foci by u = A w, for some time after them too,

    u[f, m] = Σ_a Σ_n h[a, f, m − n] w[a, n]

with h[a, f, l] the response l + 1 samples after the beginning of one sample. A wished motion d of the foci has the
gains g = Aᵀ d: its correlation with the motion is d · A w = g · w. For a pulse, d = 1 at one focus and moment, that is
the motion there. Time reversal plays g, which has the largest correlation of all waveforms of one energy (Cauchy and
Schwarz); one-bit time reversal plays its signs, which have it of all waveforms of one peak.
"""

from __future__ import annotations

import logging
import math

import numpy as np
import scipy

# Halvings of the interval of the multiplier.
HALVINGS = 200
# Relative residual at which the inverse filter's iteration ends, and its most steps.
RESIDUAL, STEPS = 1e-3, 1000
# Smallest and largest condition of the L-curve, and their number.
CONDITIONS = 1.0, 1e7, 281
# Least curvature of a corner of it.
CORNER = 0.1


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


def keep_above(h: np.ndarray, rate: int, lowest: float) -> np.ndarray:
    """Return responses (..., samples) without frequencies below half of ``lowest`` [Hz], those above it unchanged.

    The gain between the two is sin², so that the filter rings for few periods.
    """
    length = scipy.fft.next_fast_len(2 * h.shape[-1], real=True)
    above = np.clip(2 * scipy.fft.rfftfreq(length, 1 / rate) / lowest - 1, 0, 1)
    spectrum = scipy.fft.rfft(h, length) * np.sin(math.pi / 2 * above) ** 2
    return np.asarray(scipy.fft.irfft(spectrum, length)[..., : h.shape[-1]])


def scale_to_limits(waveforms: np.ndarray, energy: float | None, peak: float | None) -> np.ndarray:
    """Return waveforms (sets, actuators, samples), each set times the largest factor within the limits."""
    axes = (1, 2)
    largest, squares = np.abs(waveforms).max(axis=axes, keepdims=True), (waveforms**2).sum(axis=axes, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_peak = math.inf if peak is None else peak / largest
        by_energy = math.inf if energy is None else np.sqrt(energy / squares)
        return np.asarray(np.where(largest > 0, waveforms * np.minimum(by_peak, by_energy), 0.0))


def optimum(gains: np.ndarray, energy: float | None, peak: float | None) -> tuple[np.ndarray, float]:
    """Return the waveforms w of largest g·w under Σ w² ≤ energy and |w| ≤ peak, and an upper bound of g·w.

    With a multiplier λ ≥ 0 of the energy, w = clip(g / 2λ, ±peak), and for every λ no g·w exceeds
    λ energy + Σ max_w (g w − λ w²), the maximum over |w| ≤ peak.

    Args:
        gains: (actuators, samples) g.
        energy: Largest Σ w²; None for no limit.
        peak: Largest |w|; None for no limit, if the energy has one.
    """
    size = float(np.linalg.norm(gains))
    if energy is None or (peak is not None and peak**2 * np.count_nonzero(gains) <= energy):
        assert peak is not None
        return peak * np.sign(gains), peak * float(np.abs(gains).sum())
    if size == 0.0:
        return np.zeros_like(gains), 0.0
    low, high = 0.0, size / (2 * math.sqrt(energy))
    limit = math.inf if peak is None else peak
    for _ in range(HALVINGS if peak is not None else 0):
        middle = (low + high) / 2
        spent = float((np.minimum(np.abs(gains) / (2 * middle), limit) ** 2).sum())
        low, high = (middle, high) if spent > energy else (low, middle)
        if high - low <= np.spacing(high):
            break
    best = np.clip(gains / (2 * high), -limit, limit)
    return best, high * energy + float((gains * best - high * best**2).sum())


def inverse_filter(responses: Convolution, wished: np.ndarray, condition: float) -> np.ndarray:
    """Return the waveforms w (sets, actuators, played) of least |A w − d|² + μ |w|².

    μ is the largest squared singular value of the responses at any frequency, over condition². With w = Aᵀ y that is
    (A Aᵀ + μ) y = d, or with more foci than actuators (Aᵀ A + μ) w = Aᵀ d, solved by conjugate gradients: unlike a
    division of spectra this knows that waveforms neither begin before the first sample nor go on after the last. The
    division is the preconditioner.

    Args:
        responses: A.
        wished: (sets, foci, samples) d.
        condition: Ratio of the largest singular value to those that are damped to a half.
    """
    by_actuators = wished.shape[1] > responses.actuators
    gram = responses.gram(by_actuators)
    weight = float(np.linalg.eigvalsh(gram).max()) / condition**2
    nearly = np.linalg.inv(gram + weight * np.eye(gram.shape[1])) if weight else gram
    residual = responses.reverse(wished) if by_actuators else wished
    solution, samples = np.zeros_like(residual), residual.shape[2]

    def precondition(rows: np.ndarray) -> np.ndarray:
        return responses.invert(responses.transform(rows) @ nearly)[..., :samples]

    def multiply(rows: np.ndarray) -> np.ndarray:
        forth, back = (responses.move, responses.reverse) if by_actuators else (responses.reverse, responses.move)
        return back(forth(rows)) + weight * rows

    step = precondition(residual)
    product = _dot(residual, step)
    end = RESIDUAL**2 * (product if by_actuators else _dot(residual, residual))
    for _ in range(STEPS):
        if ((product if by_actuators else _dot(residual, residual)) <= end).all() or not product.any():
            break
        image = multiply(step)
        length = _ratio(product, _dot(step, image))
        solution, residual = solution + length * step, residual - length * image
        divided = precondition(residual)
        before, product = product, _dot(residual, divided)
        step = divided + _ratio(product, before) * step
    else:
        words = "the inverse filter's iteration ended after %d steps; a smaller focus.condition takes fewer"
        logging.getLogger("warp_plate").warning(words, STEPS)
    return solution if by_actuators else responses.reverse(solution)


def l_curve_condition(responses: Convolution, wished: np.ndarray) -> float | None:
    """Return the condition at the corner of the inverse filter's L-curve, or None if it has none.

    The corner is where log |w| over log |A w − d| bends most (P. C. Hansen, SIAM Rev. 34, 1992, pp. 561-580), with A
    taken frequency by frequency; of corners nearly as sharp it is the one of the smallest waveforms.

    Args:
        responses: A.
        wished: (sets, foci, samples) d.
    """
    squares, vectors = np.linalg.eigh(responses.gram())
    parts = (np.abs(responses.transform(wished) @ vectors) ** 2).sum(axis=1).ravel()
    squares = np.maximum(squares, 0).ravel()
    conditions = np.geomspace(*CONDITIONS)
    damped = [squares + squares.max() / condition**2 for condition in conditions]
    residual = np.array([(parts * ((square - squares) / square) ** 2).sum() for square in damped])
    size = np.array([(parts * squares / square**2).sum() for square in damped])
    across, up = (np.gradient(np.log(values)) for values in (residual, size))
    bend = (up * np.gradient(across) - across * np.gradient(up)) / np.hypot(across, up) ** 3
    corners, _ = scipy.signal.find_peaks(bend, height=max(CORNER, bend.max() / 2))
    return float(conditions[corners[0]]) if corners.size else None


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the products of sets (sets, rows, samples), shaped to multiply them."""
    return np.einsum("sfn,sfn->s", first, second)[:, None, None]


def _ratio(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.divide(first, second, out=np.zeros_like(first), where=second > 0)
