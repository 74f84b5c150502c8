"""Waveforms of actuators that focus: plain NumPy over impulse responses.

Waveforms w of samples n = 0 ... N − 1, held between them, move the foci by u = A w, for some time after them too,

    u[f, m] = Σ_a Σ_n h[a, f, m − n] w[a, n]

with h[a, f, l] the response l + 1 samples after the beginning of one sample. A wished motion d of the foci has the
gains g = Aᵀ d: how well motion goes with it is d · A w = g · w. For a pulse, d = 1 at one focus and moment, that is the
motion there. Time reversal plays g, which of all waveforms of one energy goes best with d (Cauchy and Schwarz); one-bit
time reversal plays its signs, which do so of all waveforms of one peak.
"""

from __future__ import annotations

import logging
import math

import numpy as np
import scipy

from warp_plate.focusing.convolution import Convolution

# Halvings of the interval of the multiplier.
HALVINGS = 200
# Relative residual at which the inverse filter's iteration ends, and its most steps.
RESIDUAL, STEPS = 1e-3, 1000
# Smallest and largest condition of the L-curve, and their number.
CONDITIONS = 1.0, 1e7, 281
# Least curvature of a corner of it.
CORNER = 0.1


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
    rest = responses.reverse(wished) if by_actuators else wished
    solution, samples = np.zeros_like(rest), rest.shape[2]

    def divide(rest: np.ndarray) -> np.ndarray:
        return responses.invert(responses.transform(rest) @ nearly)[..., :samples]

    step = divide(rest)
    product = _dot(rest, step)
    end = RESIDUAL**2 * (product if by_actuators else _dot(rest, rest))
    for _ in range(STEPS):
        if ((product if by_actuators else _dot(rest, rest)) <= end).all() or not product.any():
            break
        if by_actuators:
            image = responses.reverse(responses.move(step)) + weight * step
        else:
            image = responses.move(responses.reverse(step)) + weight * step
        length = _ratio(product, _dot(step, image))
        solution, rest = solution + length * step, rest - length * image
        divided = divide(rest)
        before, product = product, _dot(rest, divided)
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
    rest = np.array([(parts * ((each - squares) / each) ** 2).sum() for each in damped])
    size = np.array([(parts * squares / each**2).sum() for each in damped])
    across, up = (np.gradient(np.log(each)) for each in (rest, size))
    bend = (up * np.gradient(across) - across * np.gradient(up)) / np.hypot(across, up) ** 3
    corners, _ = scipy.signal.find_peaks(bend, height=max(CORNER, bend.max() / 2))
    return float(conditions[corners[0]]) if corners.size else None


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the products of sets (sets, rows, samples), shaped to multiply them."""
    return np.einsum("sfn,sfn->s", first, second)[:, None, None]


def _ratio(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.divide(first, second, out=np.zeros_like(first), where=second > 0)
