"""Plates by finite elements of high degree with continuous slopes, for every linear effect; layers do not overlap.

In each of the elements between lines of the plate, a side has Hermite's cubics of values and slopes at its ends and
bubbles (1 − s²)² P_k^(4, 4)(s), s = −1 ... 1; the functions of the plate are products of those of its sides (the
hp version: C. Schwab, p- and hp-Finite Element Methods, 1998). Elements at the edges are short, for singular corners.
"""

from functools import partial
from itertools import pairwise

import numpy as np
import scipy
from numpy.polynomial import legendre, polynomial

HERMITE = [[0.5, -0.75, 0, 0.25], [0.25, -0.25, -0.25, 0.25], [0.5, 0.75, 0, -0.25], [-0.25, -0.25, 0.25, 0.25]]
BUBBLE = [1, 0, -2, 0, 1]
Sparse = scipy.sparse.csr_array
GRADED, LONGEST, SHORTEST = (0.15, 0.02), 3, 0.005
LEFT_OUT = {"clamped": [0, 1], "supported": [0]}


def element_frequencies(scene, count, degree=10):
    """Return the lowest ``count`` natural frequencies [Hz] of the undamped plate."""
    sides = [Side(scene, axis, degree) for axis in (0, 1)]
    bending, support, mass, _ = matrices(scene, *sides)
    squares, _ = lowest_modes(bending + support, mass, count, shift_of(scene))
    return np.sqrt(np.maximum(squares, 0)) / (2 * np.pi)


def lowest_modes(stiffness, mass, count, shift):
    """Return the lowest ω² [1/s²], rising, and mass-normalised vectors (unknowns, modes)."""
    shifted = stiffness + shift * mass
    units = scipy.sparse.diags_array(1 / np.sqrt(shifted.diagonal()))
    mass, shifted = (scipy.sparse.csc_array(units @ matrix @ units) for matrix in (mass, shifted))
    solve = scipy.sparse.linalg.splu(
        shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    ).solve
    inverse = scipy.sparse.linalg.LinearOperator(shifted.shape, matvec=solve, dtype=float)
    start = np.random.default_rng(0).normal(size=mass.shape[0])
    squares, vectors = scipy.sparse.linalg.eigsh(shifted, count, mass, sigma=0, OPinv=inverse, v0=start)
    order = np.argsort(squares)
    return squares[order] - shift, units @ vectors[:, order]


def shift_of(scene):
    """Return the size of the lowest ω² [1/s²], by which free plates are shifted."""
    plate = scene.plate
    return plate.rigidity / (plate.density * plate.thickness) * (np.pi / max(plate.size)) ** 4


class Side:
    """Functions along x (0) or y (1): values[derivative] (functions, points), their points and weights."""

    def __init__(self, scene, axis, degree, inner=(0.06, 0.5, 0.94)):
        length, edges = scene.plate.size[axis], scene.edges
        ends = ((edges.left, edges.right), (edges.bottom, edges.top))[axis]
        wanted = [*length * np.array(inner)]
        if scene.effects.layers or scene.effects.variation:  # short ones, with loads that jump between them
            wanted += [place for item in scene.actuators for place in item.area[2 * axis : 2 * axis + 2]]
            wanted += [*np.linspace(0, length, 1 + int(np.ceil(LONGEST * length / min(scene.plate.size))))]
        lines = [0.0, length, *_lines(scene, axis)]
        for place in wanted:  # rounding of the matrices of very short elements would hide the plate
            if np.abs(np.subtract(lines, place)).min() > SHORTEST * length:
                lines.append(place)
        self.lines = np.unique(np.round(lines, 12))
        self.degree, nodes = degree, len(self.lines)
        out = [unknown for end, first in zip(ends, (0, 2 * nodes - 2), strict=True) for unknown in
               (first + np.array(LEFT_OUT.get(end, []) if isinstance(end, str) else [], dtype=int))]  # fmt: skip
        self.kept = np.setdiff1d(np.arange(2 * nodes + (degree - 3) * (nodes - 1)), out)
        self.points, self.weights = self.rule()
        self.values = self.values_at(self.points)
        shared = (self.values[0] != 0).astype(float)
        self.pairs = np.nonzero(shared @ shared.T)  # functions that are not zero in a common element
        self.ends = [
            np.array([self.kept == first, self.kept == first + 1], dtype=float) for first in (0, 2 * nodes - 2)
        ]

    def rule(self, low=-np.inf, high=np.inf):
        """Return points and weights of Gauss's rule on the elements, of what lies between two places."""
        lines = np.unique(np.clip(self.lines, low, high))
        s, weights = legendre.leggauss(self.degree + 5)
        half = np.diff(lines)[:, None] / 2
        return (lines[:-1, None] + half * (1 + s)).ravel(), (half * weights).ravel()

    def values_at(self, points):
        """Return values and two derivatives (3, functions, points) at any points."""
        nodes, bubbles = len(self.lines), self.degree - 3
        values = np.zeros((3, 2 * nodes + bubbles * (nodes - 1), points.size))
        of_points = np.clip(np.searchsorted(self.lines, points, side="right") - 1, 0, nodes - 2)
        for element, half in enumerate(np.diff(self.lines) / 2):
            inside = np.flatnonzero(of_points == element)
            own = np.array(
                [*range(2 * element, 2 * element + 4), *(2 * nodes + element * bubbles + np.arange(bubbles))]
            )
            scale = np.where(np.isin(np.arange(self.degree + 1), (1, 3)), half, 1)
            reference = _reference(self.degree, (points[inside] - self.lines[element]) / half - 1)
            for derivative in range(3):
                here = reference[derivative] * scale[:, None] / half**derivative
                values[derivative, own[:, None], inside] = here
        return values[:, self.kept]

    def integral(self, low, high):
        """Return the integrals of the functions between any two places."""
        points, weights = self.rule(low, high)
        return self.values_at(points)[0] @ weights


def _reference(degree, s):
    values = np.empty((3, degree + 1, s.size))
    for k in range(degree + 1):
        row = HERMITE[k] if k < 4 else polynomial.polymul(BUBBLE, scipy.special.jacobi(k - 4, 4, 4).coef[::-1])
        for derivative in range(3):
            values[derivative, k] = polynomial.polyval(s, polynomial.polyder(row, derivative))
    return values


def _lines(scene, axis):
    places = [place for item in scene.effects.oscillators for place in item.area[2 * axis : 2 * axis + 2]]
    edges = [place for layer in scene.effects.layers for place in layer.area[2 * axis : 2 * axis + 2]]
    lines = sorted({0.0, scene.plate.size[axis], *edges})
    for low, high in pairwise(lines):  # short elements at the edges of layers, whose corners are singular
        short = np.multiply(GRADED, min(high - low, scene.plate.size[axis] / 4))
        places += [low, *(low + short if low in edges else []), *(high - short if high in edges else [])]
    for _, rows in scene.effects.variation or ():
        shape = np.shape(rows) if rows is not None else (1, 1)
        places += [*np.linspace(0, scene.plate.size[axis], max(shape[1 - axis], 2))]
    return places


def _factor(scene, name, x, y):
    """Return a factor of the scene's variation at points (y, x)."""
    rows = getattr(scene.effects.variation, name, None)
    array = np.array([[1.0]] if rows is None else rows)
    for axis, (points, length) in enumerate(((y, scene.plate.size[1]), (x, scene.plate.size[0]))):
        columns = np.linspace(0, length, array.shape[axis]) if array.shape[axis] > 1 else np.zeros(1)
        array = np.apply_along_axis(lambda v, p=points, c=columns: np.interp(p, c, v), axis, array)
    return array


def layered(scene, x, y):
    """Return what layers add to the rigidity [N·m] and the mass per area [kg/m²] at points (y, x)."""
    plate = scene.plate
    thickness, young = (_factor(scene, name, x, y) for name in ("thickness", "young_modulus"))
    thickness, young = plate.thickness * thickness, plate.young_modulus * young
    rigidity, mass = np.zeros((2, len(y), len(x)))
    for layer in scene.effects.layers:
        x0, x1, y0, y1 = layer.area
        inside = np.outer((y > y0) & (y < y1), (x > x0) & (x < x1))
        half, top = thickness / 2, thickness / 2 + layer.thickness
        sheets = [(young, -half, half), (layer.young_modulus, half, top)]
        sheets += [(layer.young_modulus, -top, -half)] if layer.both else []
        zeroth, first, second = (
            sum(modulus * (high**power - low**power) / power for modulus, low, high in sheets) for power in (1, 2, 3)
        )
        added = second - first**2 / zeroth - young * thickness**3 / 12
        rigidity += inside * added / (1 - plate.poisson_ratio**2)
        mass += inside * layer.density * layer.thickness * (1 + layer.both)
    return rigidity, mass


def _rigidities(scene, x, y):
    """Return Dx, Dy, D1 and Dxy [N·m] at points (y, x)."""
    ratio, flat = scene.plate.poisson_ratio, scene.effects.orthotropic
    isotropic = np.array([1, 1, ratio, (1 - ratio) / 2])
    own = (flat.Dx, flat.Dy, flat.D1, flat.Dxy) if flat else scene.plate.rigidity * isotropic
    thickness, young = (_factor(scene, name, x, y) for name in ("thickness", "young_modulus"))
    added = layered(scene, x, y)[0]
    return [value * young * thickness**3 + part * added for value, part in zip(own, isotropic, strict=True)]


def density_at(scene, x, y):
    """Return the mass per area [kg/m²] at points (y, x)."""
    factors = (_factor(scene, name, x, y) for name in ("thickness", "density"))
    plate = scene.plate.density * scene.plate.thickness * np.prod(list(factors), axis=0)
    return plate + layered(scene, x, y)[1]


def _integral(along_x, along_y, field, x=(0, 0), y=(0, 0)):
    """Return the integrals of field times products of derivatives of functions along x and along y, sparse."""
    (row_x, column_x), (row_y, column_y) = along_x.pairs, along_y.pairs
    products = [
        side.values[first][rows] * side.values[second][columns] * side.weights
        for side, (rows, columns), (first, second) in ((along_x, along_x.pairs, x), (along_y, along_y.pairs, y))
    ]
    count = along_x.kept.size
    places = row_y[:, None] * count + row_x, column_y[:, None] * count + column_x
    size = count * along_y.kept.size
    values = products[1] @ field @ products[0].T
    return Sparse((values.ravel(), [place.ravel() for place in places]), (size, size))


def slopes(along_x, along_y, ratio):
    """Return the matrix of ∫ u_x² + ratio u_y² dA over the products of functions."""
    one = np.ones((along_y.points.size, along_x.points.size))
    return _integral(along_x, along_y, one, (1, 1)) + ratio * _integral(along_x, along_y, one, y=(1, 1))


def matrices(scene, along_x, along_y):
    """Return the stiffness of the plate alone and that of all else, the mass, and the damping but the material's.

    They are those of products of functions, those of x fastest, and of the oscillators' masses.
    """
    effects = scene.effects
    dx, dy, d1, dxy = _rigidities(scene, along_x.points, along_y.points)
    one = np.ones_like(dx)
    integral = partial(_integral, along_x, along_y)
    coupled = integral(d1, (2, 0), (0, 2))
    bending = integral(dx, (2, 2)) + integral(dy, y=(2, 2)) + coupled + coupled.T + integral(4 * dxy, (1, 1), (1, 1))
    support, area = 0 * bending, integral(one)
    mass = integral(density_at(scene, along_x.points, along_y.points))
    damping = (effects.damping.viscous if effects.damping else 0.0) * area
    if effects.tension:
        support = support + integral(effects.tension.x * one, (1, 1)) + integral(effects.tension.y * one, y=(1, 1))
    if effects.foundation:
        support = support + effects.foundation.stiffness * area
        damping = damping + effects.foundation.damping * area
    for name, axis, end in (("left", 0, 0), ("right", 0, 1), ("bottom", 1, 0), ("top", 1, 1)):
        edge = getattr(scene.edges, name)
        if isinstance(edge, str):
            continue
        side, other = (along_x, along_y)[:: 1 - 2 * axis]
        value, slope = side.ends[end]
        across = edge.translation * np.outer(value, value) + edge.rotation * np.outer(slope, slope)
        along = (other.values[0] * other.weights) @ other.values[0].T
        factors = (along, across) if axis == 0 else (across, along)
        support = support + scipy.sparse.kron(*map(scipy.sparse.csr_array, factors))
    for oscillator in effects.oscillators:
        x0, x1, y0, y1 = oscillator.area
        pull = np.zeros(support.shape[0])
        means = np.outer(along_y.integral(y0, y1), along_x.integral(x0, x1)).ravel() / ((y1 - y0) * (x1 - x0))
        pull[: means.size] = means
        if oscillator.mass:
            bending, support, mass, damping = (
                scipy.sparse.block_diag([matrix, [[value]]], format="csr")
                for matrix, value in ((bending, 0.0), (support, 0.0), (mass, oscillator.mass), (damping, 0.0))
            )
            pull = np.append(pull, -1.0)
        pull = Sparse(pull[:, None])
        support = support + oscillator.stiffness * (pull @ pull.T)
        damping = damping + oscillator.damping * (pull @ pull.T)
    return bending, support, mass, damping


def bending_of(scene, along_x, along_y, shapes):
    """Return the bending energies of pairs of shapes (functions along y, functions along x, shapes), by curvatures.

    Their relative errors are small, where those of the matrix are parts of its largest entry.
    """
    dx, dy, d1, dxy = _rigidities(scene, along_x.points, along_y.points)
    weights = np.outer(along_y.weights, along_x.weights)
    xx, xy, yy = (
        np.einsum("jkm,kx,jy->myx", shapes, along_x.values[2 - i], along_y.values[i], optimize=True) for i in (0, 1, 2)
    )
    moments = (dx * xx + d1 * yy, 4 * dxy * xy, dy * yy + d1 * xx)
    return sum(
        np.einsum("yx,myx,nyx->mn", weights, a, b, optimize=True) for a, b in zip(moments, (xx, xy, yy), strict=True)
    )
