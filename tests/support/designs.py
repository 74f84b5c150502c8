"""Slopes of designs compared with differences of their values."""

import numpy as np


def errors_of_slopes(panel, numbers, direction, step, name):
    """Return the errors of a panel's slopes along a direction, of limits and of a value by its name, by differences of
    fourth order, and the largest slope of each."""
    value = panel.evaluate(numbers)

    def differences(step):
        one, other = (panel.evaluate(numbers + sign * step * direction, sloped=False) for sign in (1, -1))
        return np.append(one.excess - other.excess, getattr(one, name) - getattr(other, name)) / (2 * step)

    slopes = np.vstack([value.excess_slopes, value.slopes])
    expected = (4 * differences(step) - differences(2 * step)) / 3
    return np.abs(slopes @ direction - expected), np.abs(slopes).max(axis=1)


def error_at_end(panel, numbers, step=4e-3):
    """Return the error of the slope by the first number, at an end of its range, by differences of values inside of
    fourth order, as a part of the largest slope."""
    slopes, inward = panel.evaluate(numbers).slopes, 1 - 2 * numbers[0]
    ahead = np.eye(panel.count)[0] * inward * step
    values = [panel.evaluate(numbers + index * ahead, sloped=False).smooth for index in range(5)]
    return abs(slopes[0] - np.dot([-25, 48, -36, 16, -3], values) / (12 * step) * inward) / np.abs(slopes).max()
