"""Waveforms of actuators that focus, by all methods, and what bounds them: plain NumPy over impulse responses.

Waveforms w of samples n = 0 ... N − 1, held between them, move the foci by u = A w, for some time after them too,

    u[f, m] = Σ_a Σ_n h[a, f, m − n] w[a, n]

with h[a, f, l] the response l + 1 samples after the beginning of one sample. A wished motion d of the foci has the
gains g = Aᵀ d: its correlation with the motion is d · A w = g · w. For a pulse, d = 1 at one focus and moment, that is
the motion there. Time reversal plays g, which has the largest correlation of all waveforms of one energy (Cauchy and
Schwarz); one-bit time reversal plays its signs, which have it of all waveforms of one peak.
"""

import logging
import math
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.focusing.wishes import Wish
from warp_plate.scene.focus import Focus

# Halvings of the interval of the multiplier.
HALVINGS = 200
# Relative residual at which the inverse filter's iteration ends, and its most steps.
RESIDUAL, STEPS = 1e-3, 1000


class Convolution:
    """The map u = A w from waveforms (sets, actuators, played) to motion (sets, foci, samples) by responses h
    (actuators, foci, samples), h[..., l] that at sample l + 1 to a sample at 0; waveforms may end before the motion."""

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
        """Return products of the responses' spectra, A Aᵀ (frequencies, foci, foci) without its ends, or Aᵀ A."""
        if by_actuators:
            return self._spectra @ self._spectra.conj().mT
        return self._spectra.conj().mT @ self._spectra

    def transform(self, rows: np.ndarray) -> np.ndarray:
        """Return (frequencies, sets, rows) spectra of rows (sets, rows, samples) with zeros after them."""
        return np.ascontiguousarray(np.moveaxis(scipy.fft.rfft(rows, self._length), -1, 0))

    def invert(self, spectra: np.ndarray) -> np.ndarray:
        """Return the rows (sets, rows, samples) of spectra."""
        return np.asarray(scipy.fft.irfft(np.moveaxis(spectra, 0, -1), self._length)[..., : self.samples])


@dataclass(frozen=True)
class Gains:
    """Correlation of the motion of each focus with its wish."""

    values: np.ndarray  # (foci, actuators, samples) g, whose products with the waveforms are those of motion and wish
    optimum: np.ndarray  # (foci, actuators, samples) waveforms of largest g·w within the limits
    bound: np.ndarray  # (foci,) upper bounds of g·w of all waveforms within the limits

    def gap(self, waveforms: np.ndarray) -> np.ndarray:
        """Return the parts (foci,) of the bounds that waveforms lack; 0 at a focus that nothing moves."""
        attained = np.einsum("fan,fan->f", self.values, waveforms)
        return 1 - np.divide(attained, self.bound, out=np.ones_like(self.bound), where=self.bound > 0)


def find_gains(h: np.ndarray, table: Focus, wish: Wish) -> Gains:
    """Return the gains of responses h (actuators, foci, recorded), without frequencies below ``focus.lowest``."""
    banded = keep_above(h, table.rate, table.lowest) if table.lowest else h
    values = Convolution(banded, wish.samples).reverse(wish.apart(wish.motion))
    best, bounds = zip(*(optimum(g, *limits_of(table)) for g in values), strict=True)
    return Gains(values, np.stack(best), np.array(bounds))


def make_waveforms(h: np.ndarray, table: Focus, wish: Wish, gains: Gains) -> dict[str, np.ndarray]:
    """Return the waveforms (foci, actuators, samples) of the methods for one panel, not yet scaled to the limits."""
    return {
        "time_reversal": gains.values,
        "one_bit": np.sign(gains.values),
        "inverse_filter": inverse_filter(*least_squares(h, wish), table.condition),
        "optimum": gains.optimum,
    }


def least_squares(h: np.ndarray, wish: Wish) -> tuple[Convolution, np.ndarray]:
    """Return A and d of the least squares |A w − d|² that inverse filters minimise, the mean of several panels.

    Responses h (actuators, panels · foci, recorded) have the foci of each panel after those of the one before.
    """
    panels = h.shape[1] // len(wish.followed)
    wished = np.tile(wish.apart(wish.followed), (1, panels, 1))
    return Convolution(h / panels**0.5, wish.samples), wished / panels**0.5


def limits_of(table: Focus) -> tuple[float | None, float | None]:
    """Return the largest Σ w² and |w|."""
    return None if table.energy is None else table.energy * table.rate, table.peak_limit


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
    λ energy + Σ max_w (g w − λ w²), the maximum over |w| ≤ peak. One of both limits may be None.
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


def inverse_filter(responses: Convolution, wished: np.ndarray, condition: float, most_steps: int = STEPS) -> np.ndarray:
    """Return the waveforms w (sets, actuators, played) of least |A w − d|² + μ |w|².

    μ is the largest squared singular value of the responses at any frequency, over condition². With w = Aᵀ y that is
    (A Aᵀ + μ) y = d, or with more foci than actuators (Aᵀ A + μ) w = Aᵀ d, solved by conjugate gradients: unlike a
    division of spectra this knows that waveforms neither begin before the first sample nor go on after the last. The
    division is the preconditioner. After ``most_steps`` the iteration ends with a warning.
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
    for _ in range(most_steps):
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
        logging.getLogger("warp_plate").warning(words, most_steps)
    return solution if by_actuators else responses.reverse(solution)


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the products of sets (sets, rows, samples), shaped to multiply them."""
    return np.einsum("sfn,sfn->s", first, second)[:, None, None]


def _ratio(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.divide(first, second, out=np.zeros_like(first), where=second > 0)
