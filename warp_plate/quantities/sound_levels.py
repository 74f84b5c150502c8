"""References of sound levels, and the A-weighting."""

import numpy as np

# References of levels of sound power [W] and of the root mean square of the pressure [Pa].
POWER_REFERENCE, PRESSURE_REFERENCE = 1e-12, 20e-6
# Corner frequencies of the A-weighting [Hz] of IEC 61672-1, and its value at 1 kHz before it is set to 0 dB.
CORNERS, AT_1_KHZ = (20.598997, 107.65265, 737.86223, 12194.217), -1.999656


def a_weighting(frequencies: np.ndarray) -> np.ndarray:
    """Return the A-weighting [dB] at frequencies [Hz], IEC 61672-1."""
    squares = np.asarray(frequencies, dtype=float) ** 2
    first, second, third, last = (corner**2 for corner in CORNERS)
    ratio = last * squares**2 / ((squares + first) * (squares + last))
    with np.errstate(divide="ignore"):
        level = np.log10(ratio / np.sqrt((squares + second) * (squares + third)))
    return np.asarray(20 * level - AT_1_KHZ)


def a_weight(frequency: float) -> float:
    """Return the A-weight of amplitudes at a frequency [Hz], one at 1 kHz."""
    return float(10 ** (float(a_weighting(np.array([frequency]))[0]) / 20))
