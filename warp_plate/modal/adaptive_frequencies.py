"""Frequencies at which to compute a response so that no resonance is missed, however sharp.

Near a resonance of frequency f₀ and half-width δ the response is proportional to 1/(x − i), x = (f − f₀)/δ, a circle in
the complex plane. Frequencies f₀ + δ tan θ with evenly spaced θ lie evenly on it, and the response at one of them is
within 1 − cos(step/2) = 0.4 % of the peak, whatever δ. Beyond them x doubles from one to the next up to the spacing of
a plain grid, so the number of frequencies of a resonance depends only on the logarithm of its sharpness.
"""

from __future__ import annotations

import math

import numpy as np

# Frequencies of the plain grid, evenly spaced on a logarithmic axis.
PLAIN = 400
# (points,) x on the circle, every 10 degrees.
CIRCLE = np.tan(np.radians(np.arange(-80, 81, 10)))
# Frequencies closer than this part of their distance from the nearest pole are merged, unless they are farther apart
# than half the spacing of the plain grid, which overdamped modes must not thin out.
CLOSE = 0.05
# Half-widths relative to the frequency: below SHARPEST a resonance counts as undamped, and is sampled as one of the
# half-width UNDAMPED, on either side of its peak.
SHARPEST, UNDAMPED = 1e-12, 5e-6


def adaptive_frequencies(centres: np.ndarray, widths: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return rising frequencies [Hz] from ``low`` to ``high`` that follow every resonance between them.

    Args:
        centres: (resonances,) [Hz], 0 for rigid motions.
        widths: (resonances,) half-widths [Hz], 0 without damping.
    """
    undamped = widths <= SHARPEST * centres
    widths = np.where(undamped, UNDAMPED * centres, widths)
    reach = CIRCLE[-1] * widths
    near = (centres > 0) & (centres + reach > low) & (centres - reach < high)
    centres, widths, undamped = centres[near], widths[near], undamped[near]
    plain = np.geomspace(low, high, PLAIN)
    groups = [plain]
    for centre, width in zip(centres, widths, strict=True):
        spacing = centre * (plain[1] / plain[0] - 1)
        doublings = max(0, math.ceil(math.log2(spacing / width / CIRCLE[-1])))
        skirt = CIRCLE[-1] * 2.0 ** np.arange(1, doublings + 1)
        groups.append(centre + width * np.concatenate([-skirt, CIRCLE, skirt]))
    frequencies = np.unique(np.concatenate(groups))
    frequencies = frequencies[(frequencies >= low) & (frequencies <= high)]
    frequencies = _merged(frequencies, plain[1] / plain[0] - 1, centres, widths)
    for centre, width in zip(centres[undamped], widths[undamped], strict=True):
        ends = (frequencies == low) | (frequencies == high)
        frequencies = frequencies[np.abs(frequencies - centre) > np.where(ends, SHARPEST * centre, width / 10)]
    return frequencies


def _merged(frequencies: np.ndarray, spacing: float, centres: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Return rising frequencies without those, but for the last, that are close to the one before in view of the
    nearest pole and of the plain grid's spacing, a part of the frequency."""
    near = 0.5 * spacing * frequencies
    for centre, width in zip(centres, widths, strict=True):
        near = np.minimum(near, CLOSE * np.hypot(frequencies - centre, width))
    kept = [0]
    for index in range(1, len(frequencies) - 1):
        if frequencies[index] - frequencies[kept[-1]] > near[index]:
            kept.append(index)
    return frequencies[[*kept, len(frequencies) - 1]]
