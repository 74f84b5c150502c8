"""Natural frequencies of homogeneous isotropic plates by a Ritz method in polynomials, for edges in any mix.

    φ_i(s) = (1 + s)^p (1 − s)^q P_i^(2q, 2p)(s) / norm,   s = −1 ... 1,   i = 0, 1, ...,

with p and q = 0, 1, 2 for free, supported and clamped ends and Jacobi polynomials P, are orthonormal: those of R. B.
Bhat, J. Sound Vib. 102 (1985) 493-499. Energies as in A. W. Leissa, J. Sound Vib. 31 (1973) 257-293. Where a clamped
and a free edge meet, the moments are singular, and ω² converges like the power −SINGULAR of the number of functions;
two numbers give its limit.
"""

import numpy as np
import scipy
from numpy.polynomial import legendre

POWERS = {"free": 0, "supported": 1, "clamped": 2}
SINGULAR = 4.5


def ritz_frequencies(size, edges, rigidity, poisson_ratio, surface_density, functions, count):
    """Return the lowest ``count`` natural frequencies [Hz] by ``functions`` along each side.

    Edges are those at the left, bottom, right and top.
    """
    along_x, along_y = _integrals(size[0], edges[0], edges[2], functions), _integrals(size[1], *edges[1::2], functions)
    coupled = np.kron(along_y[0, 2], along_x[2, 0])
    stiffness = np.kron(np.eye(functions), along_x[2, 2]) + np.kron(along_y[2, 2], np.eye(functions))
    stiffness += poisson_ratio * (coupled + coupled.T)
    stiffness += 2 * (1 - poisson_ratio) * np.kron(along_y[1, 1], along_x[1, 1])
    squares = scipy.linalg.eigh(stiffness, eigvals_only=True, subset_by_index=(0, count - 1))
    return np.sqrt(np.maximum(squares, 0) * rigidity / surface_density) / (2 * np.pi)


def extrapolated_frequencies(*plate, functions, count):
    """Return the limit of the frequencies that two numbers of functions tell."""
    fewer, more = round(0.75 * functions), functions
    coarse, fine = (ritz_frequencies(*plate, number, count) for number in (fewer, more))
    return fine + (fine - coarse) / ((more / fewer) ** SINGULAR - 1)


def _integrals(length, low, high, functions):
    """Return ∫ of products of two derivatives by their orders, as matrices."""
    p, q = POWERS[low], POWERS[high]
    s, weights = legendre.leggauss(functions + p + q)
    values = scipy.special.eval_jacobi(np.arange(functions)[:, None], 2 * q, 2 * p, s) * (1 + s) ** p * (1 - s) ** q
    values /= np.sqrt((values**2 * weights).sum(axis=1) * length / 2)[:, None]
    degrees = np.arange(s.size)
    coefficients = (values * weights) @ legendre.legvander(s, degrees[-1]) * (degrees + 0.5)
    at = [legendre.legval(s, legendre.legder(coefficients, order, scl=2 / length, axis=1).T) for order in range(3)]
    return {(i, j): (at[i] * weights) @ at[j].T * length / 2 for i in range(3) for j in range(3)}
