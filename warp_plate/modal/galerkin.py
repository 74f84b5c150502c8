"""Matrices of a scene's plate in products of splines.

With u = Σ q_ij X_i(x) Y_j(y), the energies of the plate, its edges and what is attached to it are quadratic forms,

    T = ½ ∫ ρH u̇² dA + Σ ½ m ż²                                                          mass M
    U = ½ ∫ Dx u_xx² + 2 D1 u_xx u_yy + Dy u_yy² + 4 Dxy u_xy² dA                          bending B, part of K
      + ½ ∫ Tx u_x² + Ty u_y² + k u² dA + ½ ∮ k u² + r u_n² ds + Σ ½ s (ū − z)²            stiffness K
    F = ½ ∫ c u̇² dA + Σ ½ d (ū̇ − ż)² + τ B                                               viscous damping C

in which ū is the mean displacement of an oscillator's patch and z that of its mass. Only the displacement of a
supported edge and the slope of a clamped one need functions that keep them; moments and forces of all other edges
follow from the energies (A. W. Leissa, J. Sound Vib. 31, 1973, pp. 257-293). Where the plate's rigidity jumps, at the
edges of layers, only the slope is continuous, and where it has a kink, the curvature; the knots are placed so.

Every entry is an integral ∫ C(x, y) X_i X_k Y_j Y_l dA of a field and of derivatives of functions. Gauss's rule makes
it a product of three matrices: pairs of functions of y, the field at Gauss's points, pairs of functions of x. Pairs
that never overlap are left out, so that the same product yields small dense matrices and large sparse ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import scipy

from warp_plate.modal.lines import lines, spline_degree
from warp_plate.modal.splines import Splines, gauss, make_splines
from warp_plate.plate.section import factor_arrays, interpolate, laminates
from warp_plate.scene.effects import Oscillator, Variation
from warp_plate.scene.fields import Area
from warp_plate.scene.model import ElasticEdge, Scene

# Splines near a corner between a clamped and a free edge, where the moments are singular: intervals of these parts.
CORNER_INTERVALS = (0.3, 0.09)
# With so many breaks between two knots, of a fine map, so many of Gauss's points between two breaks suffice.
FINE, FINE_RULE = 4, 3
# Splines on either side of the edges of layers, whose corners are singular too: fewer if there are many edges.
LAYER_INTERVALS = (0.3, 0.09, 0.027)
Matrix: TypeAlias = scipy.sparse.csr_array
Field: TypeAlias = np.ndarray | float


@dataclass(frozen=True)
class Galerkin:
    """Matrices over the products of splines, x fastest, then over the oscillators' masses.

    Attributes:
        scene: Scene.
        along_x: Functions of x.
        along_y: Functions of y.
        mass: M [kg].
        bending: B, the stiffness of the plate alone [N/m].
        stiffness: K, with edges, tension, foundation and oscillators [N/m].
        damping: C [N·s/m].
        plate_mass: Mass of the plate with its layers, without oscillators [kg].
    """

    scene: Scene
    along_x: Splines
    along_y: Splines
    mass: Matrix
    bending: Matrix
    stiffness: Matrix
    damping: Matrix
    plate_mass: float

    @cached_property
    def masses(self) -> list[Oscillator]:
        """Oscillators that have a mass, in the order of their unknowns."""
        return [oscillator for oscillator in self.scene.effects.oscillators if oscillator.mass > 0]


class Integrals:
    """Integrals of a scene's fields times products of two functions, by Gauss's rule between all lines of the plate.

    Attributes:
        breaks: (2,) positions along x and along y [m] between which fields and functions are smooth.
        rule: Number of Gauss's points between two breaks.
        points: (2,) positions of Gauss's points along x and along y [m].
        pairs: (2,) rows and columns of the pairs of functions of x and of y that overlap.
    """

    def __init__(
        self,
        scene: Scene,
        along_x: Splines,
        along_y: Splines,
        cuts: tuple[Sequence[float], Sequence[float]] = ((), ()),
    ) -> None:
        """Prepare the rule; ``cuts`` are further breaks along x and y [m]."""
        self.scene, self.along = scene, (along_x, along_y)
        self._varied = bool(scene.effects.layers or scene.effects.variation)
        self.breaks = tuple(
            np.unique(np.clip([*splines.breaks, *(place for place, _ in lines(scene, axis)), *cuts[axis]], 0, side))
            for axis, (splines, side) in enumerate(zip(self.along, scene.plate.size, strict=True))
        )
        self.rule = along_x.degree + (3 if self._varied else 1)
        cells = min(len(breaks) / len(splines.breaks) for breaks, splines in zip(self.breaks, self.along, strict=True))
        if cells >= FINE:
            self.rule = FINE_RULE
        rules = [gauss(breaks, self.rule) for breaks in self.breaks]
        self.points, self._weights = (rules[0][0], rules[1][0]), (rules[0][1], rules[1][1])
        self.pairs = (_overlapping_pairs(along_x), _overlapping_pairs(along_y))
        self._unordered = tuple(_unordered(*pairs) for pairs in self.pairs)

    def fields(self) -> tuple[Field, ...]:
        """Return Dx, D1, Dy, Dxy [N·m] and the mass per area [kg/m²] at Gauss's points (y, x), or as numbers."""
        if self._varied:
            return self.fields_at(*self.points)
        return tuple(float(field[0, 0]) for field in self.fields_at(self.points[0][:1], self.points[1][:1]))

    def fields_at(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the fields of :meth:`fields` at points (y, x) [m]."""
        factors = {key: np.ones((y.size, x.size)) for key in Variation.model_fields}
        width, height = self.scene.plate.size
        for key, array in factor_arrays(self.scene).items():
            rows, columns = y / height * (len(array) - 1), x / width * (array.shape[1] - 1)
            factors[key] = interpolate(interpolate(array, rows).T, columns).T
        (bend_xx, bend_xy, bend_yy), twist, mass, _ = laminates(self.scene, x, y, factors)
        return bend_xx, bend_xy, bend_yy, twist, mass

    def inside(self, area: Area) -> np.ndarray:
        """Return one at Gauss's points (y, x) in a rectangle x0, x1, y0, y1 [m] whose sides are breaks, else zero."""
        x, y = self.points
        return np.outer((y > area[2]) & (y < area[3]), (x > area[0]) & (x < area[1])).astype(float)

    def integral(self, field: Field) -> float:
        """Return ∫ field dA of values at Gauss's points (y, x), or of a number."""
        return float((np.outer(self._weights[1], self._weights[0]) * field).sum())

    def matrix(self, field: Field, x: tuple[int, int] = (0, 0), y: tuple[int, int] = (0, 0)) -> Matrix:
        """Return ∫ field · u^(x₀, y₀) u^(x₁, y₁) dA, functions of the first factor in rows; derivatives along x and y.

        Args:
            field: Values at Gauss's points (y, x), or a number.
            x: Derivatives along x of the first and of the second factor.
            y: Derivatives along y.
        """
        (along_x, of_x), (along_y, of_y) = self._products(0, *x), self._products(1, *y)
        if isinstance(field, float):
            values = field * np.outer(along_y.sum(axis=1), along_x.sum(axis=1))
        else:
            values = along_y @ field @ along_x.T
        return self.scatter(values[of_y][:, of_x])

    def _products(self, axis: int, first: int, second: int) -> tuple[np.ndarray, np.ndarray | slice]:
        """Return (products, points) weighted products of derivatives of two functions of one direction, and which of
        them is that of each pair; of equal derivatives those of (i, k) and (k, i) are the same."""
        (rows, columns), of_pairs = self._unordered[axis] if first == second else (self.pairs[axis], slice(None))
        values = [self.along[axis].values(self.points[axis], derivative) for derivative in (first, second)]
        return values[0][rows] * values[1][columns] * self._weights[axis], of_pairs

    def scatter(self, values: np.ndarray) -> Matrix:
        """Return the sparse matrix of values (pairs of y, pairs of x)."""
        places = self._places
        return Matrix((values.ravel()[places.data], places.indices, places.indptr), places.shape)

    @cached_property
    def _places(self) -> Matrix:
        """Sparse matrix of the places of its entries among the pairs."""
        (row_x, column_x), (row_y, column_y) = self.pairs
        count, unknowns = self.along[0].functions, self.along[0].functions * self.along[1].functions
        rows, columns = row_y[:, None] * count + row_x, column_y[:, None] * count + column_x
        return Matrix((np.arange(rows.size), (rows.ravel(), columns.ravel())), (unknowns, unknowns))


def make_galerkin(scene: Scene, intervals: tuple[int, int]) -> Galerkin:
    """Return the matrices of a scene with about so many intervals between knots along x and along y.

    Raises:
        SceneError: A file of the scene's variation cannot be read.
    """
    degree = spline_degree(scene)
    along_x, along_y = (_splines(scene, axis, intervals[axis], degree) for axis in (0, 1))
    integrals, effects = Integrals(scene, along_x, along_y), scene.effects
    bend_xx, bend_xy, bend_yy, twist, density = integrals.fields()
    coupled = integrals.matrix(bend_xy, x=(2, 0), y=(0, 2))
    bending = (
        integrals.matrix(bend_xx, x=(2, 2))
        + integrals.matrix(bend_yy, y=(2, 2))
        + integrals.matrix(4 * twist, x=(1, 1), y=(1, 1))
        + coupled
        + coupled.T
    )
    stiffness, area = bending + _edge_springs(scene, integrals), integrals.matrix(1.0)
    if effects.tension is not None:
        stiffness += effects.tension.x * integrals.matrix(1.0, x=(1, 1))
        stiffness += effects.tension.y * integrals.matrix(1.0, y=(1, 1))
    viscous, retardation = (effects.damping, effects.material_damping)
    damping = (viscous.viscous if viscous else 0.0) * area + (retardation.time if retardation else 0.0) * bending
    if effects.foundation is not None:
        stiffness, damping = (
            stiffness + effects.foundation.stiffness * area,
            damping + effects.foundation.damping * area,
        )
    masses = [oscillator.mass for oscillator in effects.oscillators if oscillator.mass > 0]
    means = _patch_means(along_x, along_y, [oscillator.area for oscillator in effects.oscillators])
    return Galerkin(
        scene=scene,
        along_x=along_x,
        along_y=along_y,
        mass=scipy.sparse.block_diag([integrals.matrix(density), *masses], format="csr"),
        bending=_padded(bending, len(masses)),
        stiffness=_padded(stiffness, len(masses)) + _links(effects.oscillators, means, "stiffness"),
        damping=_padded(damping, len(masses)) + _links(effects.oscillators, means, "damping"),
        plate_mass=integrals.integral(density),
    )


def patch_integrals(along_x: Splines, along_y: Splines, areas: np.ndarray) -> np.ndarray:
    """Return (areas, unknowns of the plate) ∫ X_i Y_j dA over rectangles (areas, 4) x0, x1, y0, y1 [m]."""
    x0, x1, y0, y1 = np.asarray(areas, dtype=float).reshape(-1, 4).T
    products = along_y.integrals(y0, y1).T[:, :, None] * along_x.integrals(x0, x1).T[:, None, :]
    return np.asarray(products.reshape(len(x0), products.shape[1] * products.shape[2]))


def _splines(scene: Scene, axis: int, intervals: int, degree: int) -> Splines:
    edges, length = scene.edges, scene.plate.size[axis]
    ends, sides = ((edges.left, edges.right), (edges.bottom, edges.top))[:: 1 if axis == 0 else -1]
    corners = [line for line in lines(scene, axis, degree) if line[1] < degree]
    for end, place in zip(ends, (0.0, length), strict=True):
        if any(_singular(end, side) for side in sides):
            sign = 1 if place == 0 else -1
            corners += [(place + sign * part * length / intervals, degree - 1) for part in CORNER_INTERVALS]
    corners += [(place, degree - 1) for place in _near_layers(scene, axis, length / intervals)]
    low, high = ("free" if isinstance(end, ElasticEdge) else end for end in ends)
    return make_splines(length, (low, high), intervals, degree, corners)


def _near_layers(scene: Scene, axis: int, interval: float) -> list[float]:
    """Return positions of further knots along x (0) or y (1) [m] near the edges of layers that end inside the plate."""
    edges = [
        {place for layer in scene.effects.layers for place in layer.area[2 * i : 2 * i + 2] if 0 < place < side}
        for i, side in enumerate(scene.plate.size)
    ]
    if not all(edges):
        return []
    parts, found = LAYER_INTERVALS[: max(1, 4 - len(edges[axis]) // 2)], []
    for low, high in pairwise(sorted({0.0, scene.plate.size[axis], *edges[axis]})):
        steps = [part * min(interval, high - low) for part in parts]
        found += [low + step for step in steps if low in edges[axis]]
        found += [high - step for step in steps if high in edges[axis]]
    return found


def _singular(first: object, second: object) -> bool:
    """Return whether moments are singular at the corner of two edges: a clamped or elastic one meets another kind."""
    held = [edge == "clamped" or isinstance(edge, ElasticEdge) for edge in (first, second)]
    loose = [edge == "free" or isinstance(edge, ElasticEdge) for edge in (first, second)]
    return first != second and ((held[0] and loose[1]) or (held[1] and loose[0]))


def _edge_springs(scene: Scene, integrals: Integrals) -> Matrix:
    """Return the stiffness [N/m] of elastic edges, ∮ k u² + r u_n² ds."""
    along_x, along_y = integrals.along
    unknowns = along_x.functions * along_y.functions
    matrix = Matrix((unknowns, unknowns))
    for side, edge in scene.edges:
        if not isinstance(edge, ElasticEdge):
            continue
        axis = 0 if side in ("left", "right") else 1
        place = np.array([0.0 if side in ("left", "bottom") else scene.plate.size[axis]])
        value, slope = (integrals.along[axis].values(place, derivative)[:, 0] for derivative in (0, 1))
        across = Matrix(edge.translation * np.outer(value, value) + edge.rotation * np.outer(slope, slope))
        along = Matrix(integrals.along[1 - axis].products(0.0, scene.plate.size[1 - axis]))
        matrix = matrix + (scipy.sparse.kron(along, across) if axis == 0 else scipy.sparse.kron(across, along))
    return matrix


def _patch_means(along_x: Splines, along_y: Splines, areas: Iterable[Area]) -> np.ndarray:
    """Return (areas, unknowns of the plate) mean values of the functions over rectangles [m]."""
    rectangles = np.array(list(areas), dtype=float).reshape(-1, 4)
    size = (rectangles[:, 1] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 2])
    return patch_integrals(along_x, along_y, rectangles) / size[:, None]


def _links(oscillators: tuple[Oscillator, ...], means: np.ndarray, key: str) -> Matrix:
    """Return Σ value (ū − z)² as a matrix, for the springs or dampers ``key``; without a mass, z = 0."""
    masses = sum(oscillator.mass > 0 for oscillator in oscillators)
    rows, index = np.zeros((len(oscillators), means.shape[1] + masses)), 0
    rows[:, : means.shape[1]] = means
    for row, oscillator in zip(rows, oscillators, strict=True):
        if oscillator.mass > 0:
            row[means.shape[1] + index] = -1
            index += 1
    values = np.array([getattr(oscillator, key) for oscillator in oscillators])
    sparse = Matrix(rows)
    return Matrix(sparse.T @ (scipy.sparse.diags_array(values) @ sparse) if len(values) else (sparse.T @ sparse))


def _padded(matrix: Matrix, masses: int) -> Matrix:
    """Return a matrix of the plate with zeros for the oscillators' masses."""
    size = matrix.shape[0] + masses
    padded = Matrix(matrix)
    padded.resize(size, size)
    return padded


def _unordered(rows: np.ndarray, columns: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return each pair once, whatever its order, and which of them each pair is."""
    ordered = np.sort(np.stack([rows, columns]), axis=0)
    (first, second), of_pairs = np.unique(ordered, axis=1, return_inverse=True)
    return (first, second), of_pairs.ravel()


def _overlapping_pairs(splines: Splines) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of all pairs of functions that are not zero in a common interval."""
    index = np.arange(splines.functions)
    near = np.abs(index[:, None] - index) <= splines.degree
    rows, columns = np.nonzero(near)
    return rows, columns
