"""Exact natural frequencies of plates with two opposite supported edges, after Lévy.

With u = w(x) sin(αy), α = mπ/b, the energy is ½∫ Dx w″² − 2 D1 α² w w″ + (4 Dxy α² + Tx) w′² + (Dy α⁴ + Ty α² + k
− μω²) w² dx, whose first variation gives, with M = Dx w″ − D1 α² w and V = (4 Dxy α² + Tx) w′ − M′,

    w′ = θ,   θ′ = (M + D1 α² w)/Dx,   M′ = (4 Dxy α² + Tx) θ − V,   V′ = −D1 α² θ′ + (Dy α⁴ + Ty α² + k − μω²) w.

A frequency is natural where the two conditions at x = a meet the two motions that those at x = 0 leave. The minors of
such pairs obey a linear equation of their own (compound matrices: B. S. Ng and W. H. Reid, J. Comput. Phys. 30, 1979,
pp. 125-139), which no growing exponential spoils. It is solved by exponentials, exact where the section is constant and
of fourth order elsewhere (Magnus).
"""

import itertools
import math

import numpy as np
import scipy

FIRST, SECOND = np.array(list(itertools.combinations(range(4), 2))).T
# Motions (w, θ, M, V) that an edge at x = 0 leaves, in columns.
MOTIONS = {"clamped": [[0, 0, 1, 0], [0, 0, 0, 1]], "supported": [[0, 1, 0, 0], [0, 0, 0, 1]]}
# Conditions at x = a, in rows.
CONDITIONS = {"clamped": [[1, 0, 0, 0], [0, 1, 0, 0]], "supported": [[1, 0, 0, 0], [0, 0, 1, 0]]}


def isotropic(young_modulus, thickness, poisson_ratio, density):
    """Return Dx, D1, Dy, Dxy [N·m] and the mass per area [kg/m²]."""
    rigidity = young_modulus * thickness**3 / 12 / (1 - poisson_ratio**2)
    return rigidity, poisson_ratio * rigidity, rigidity, (1 - poisson_ratio) / 2 * rigidity, density * thickness


def levy_frequencies(section, size, ends, highest, tension=(0.0, 0.0), bed=0.0, cuts=(), steps=1):
    """Return the natural frequencies below ``highest`` [Hz], rising.

    Args:
        section: Function of x that returns Dx, D1, Dy, Dxy [N·m] and the mass per area [kg/m²].
        size: Sides a and b [m]; y = 0 and y = b are supported.
        ends: Edges x = 0 and x = a: "clamped", "supported", "free", or (translation [N/m²], rotation [N]) of springs.
        highest: Highest frequency [Hz].
        tension: Tx and Ty [N/m].
        bed: Stiffness of the foundation [N/m³].
        cuts: Positions [m] where the section jumps or has a kink.
        steps: Steps between two cuts.
    """
    lines = itertools.pairwise(np.unique([0.0, *cuts, size[0]]))
    places = np.append(np.concatenate([np.linspace(*pair, steps, endpoint=False) for pair in lines]), size[0])
    points = np.concatenate([_gauss(*pair) for pair in itertools.pairwise(places)])
    found = []
    for number in itertools.count(1):
        alpha = number * math.pi / size[1]

        def determinant(frequency, alpha=alpha):
            matrices = [_compound(section, x, size[0], 2 * math.pi * frequency, alpha, tension, bed) for x in points]
            return _determinant(matrices, places, ends, section(0.0)[0])

        scan = highest * np.linspace(1e-3, 1, 300)
        signs = np.sign(determinant(scan))
        roots = [
            scipy.optimize.brentq(lambda f, of=determinant: of(np.array([f]))[0], scan[i], scan[i + 1], rtol=1e-10)
            for i in np.flatnonzero(signs[1:] != signs[:-1])
        ]
        found += roots
        if not roots:
            return np.sort(found)


def _gauss(low, high):
    return (low + high) / 2 + np.array([-1, 1]) * (high - low) / math.sqrt(12)


def _compound(section, x, length, omega, alpha, tension, bed):
    """Return the (frequencies, 6, 6) matrix of the minors' equation, in units of the plate's length and rigidity."""
    dx, d1, dy, dxy, mass = section(x)
    unit, twist, coupling = section(0.0)[0], 4 * dxy * alpha**2 + tension[0], d1 * alpha**2
    matrix = np.zeros((omega.size, 4, 4))
    matrix[:, 0, 1] = 1
    matrix[:, 1, 0], matrix[:, 1, 2] = coupling / dx, 1 / dx
    matrix[:, 2, 1], matrix[:, 2, 3] = twist, -1
    matrix[:, 3, 0] = -(coupling**2) / dx + dy * alpha**4 + tension[1] * alpha**2 + bed - mass * omega**2
    matrix[:, 3, 2] = -coupling / dx
    scale = np.array([1, length, length**2 / unit, length**3 / unit])
    matrix *= scale[:, None] / scale
    i, j, same = FIRST[:, None], SECOND[:, None], np.eye(4)
    return (
        matrix[:, i, FIRST] * same[j, SECOND]
        + matrix[:, j, SECOND] * same[i, FIRST]
        - matrix[:, i, SECOND] * same[j, FIRST]
        - matrix[:, j, FIRST] * same[i, SECOND]
    )


def _determinant(matrices, places, ends, unit):
    scale = np.array([1, places[-1], places[-1] ** 2 / unit, places[-1] ** 3 / unit])
    motions = MOTIONS.get(ends[0]) if isinstance(ends[0], str) else [[1, 0, 0, ends[0][0]], [0, 1, ends[0][1], 0]]
    conditions = CONDITIONS.get(ends[1]) if isinstance(ends[1], str) else [[ends[1][0], 0, 0, 1], [0, ends[1][1], 1, 0]]
    first, second = np.array(motions or [[1, 0, 0, 0], [0, 1, 0, 0]]) * scale
    minors = np.tile((first[FIRST] * second[SECOND] - first[SECOND] * second[FIRST])[:, None], (len(matrices[0]), 1, 1))
    for step, (low, high) in enumerate(itertools.pairwise(places)):
        early, late = (matrix * (high - low) for matrix in matrices[2 * step : 2 * step + 2])
        exponent = (early + late) / 2 + math.sqrt(3) / 12 * (late @ early - early @ late)
        minors = scipy.linalg.expm(exponent) @ minors
        minors /= np.abs(minors).max(axis=1, keepdims=True)
    first, second = np.array(conditions or [[0, 0, 0, 1], [0, 0, 1, 0]]) / scale
    return (first[FIRST] * second[SECOND] - first[SECOND] * second[FIRST]) @ minors[:, :, 0].T
