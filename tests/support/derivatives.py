"""Derivatives of functions that are added to splines, against differences."""

import numpy as np


def errors_of_derivatives(function, x, y, step):
    """Yield the number of functions and the (points,) errors of each first and second derivative, over the largest.

    They are compared with differences over a step [m] of the derivatives of one order less.
    """
    for order in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
        axis = 0 if order[0] else 1
        lower = (order[0] - (axis == 0), order[1] - (axis == 1))
        ahead, behind = (
            function.values(x + sign * step * (axis == 0), y + sign * step * (axis == 1), [lower])[0]
            for sign in (1, -1)
        )
        difference, values = (ahead - behind) / (2 * step), function.values(x, y, [order])[0]
        yield len(values), np.abs(difference - values).max(axis=0) / np.abs(values).max(axis=0)
