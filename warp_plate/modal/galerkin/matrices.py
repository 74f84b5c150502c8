"""Matrices of a scene's plate in products of splines.

With u = Σ q_ij X_i(x) Y_j(y), the energies of the plate, its edges and what is attached to it are quadratic forms,

    T = ½ ∫ ρH u̇² dA + Σ ½ m ż²                                                          mass M
    U = ½ ∫ Dx u_xx² + 2 D1 u_xx u_yy + Dy u_yy² + 4 Dxy u_xy² dA                          bending B, part of K
      + ½ ∫ Tx u_x² + Ty u_y² + k u² dA + ½ ∮ k u² + r u_n² ds + Σ ½ s (ū − z)²            stiffness K
    F = ½ ∫ c u̇² dA + Σ ½ d (ū̇ − ż)² + τ B                                               viscous damping C

in which ū is the mean displacement of an oscillator's patch and z that of its mass. Only the displacement of a
supported edge and the slope of a clamped one need functions that keep them; moments and forces of all other edges
follow from the energies (A. W. Leissa, J. Sound Vib. 31, 1973, pp. 257-293).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from warp_plate.modal.galerkin.integrals import Integrals, Matrix, end_products, side_products
from warp_plate.modal.galerkin.lines import plate_splines
from warp_plate.modal.galerkin.splines import Splines
from warp_plate.scene.effects import Oscillator
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import ElasticEdge, Scene
from warp_plate.scene.piezo import piezo_moments

# Springs of oscillators that are stiffer than this, relative to the largest entry of the plate's own stiffness, would
# hide it in rounding; those of a thousandth already hold their patch as a rigid one.
STIFFEST = 1e10


@dataclass(frozen=True)
class Galerkin:
    """Matrices over the products of splines, x fastest, then over the oscillators' masses.

    Attributes:
        scene: Scene.
        intervals: Intervals between knots along x and along y that were asked for.
        along_x: Functions of x.
        along_y: Functions of y.
        mass: M [kg].
        bending: B, the stiffness of the plate without edges and attachments [N/m].
        support: K − B, of edges, tension, foundation and oscillators [N/m].
        damping: C [N·s/m] but for τB, the damping of the material.
        plate_mass: Mass of the plate with its layers, without oscillators [kg].
    """

    scene: Scene
    intervals: tuple[int, int]
    along_x: Splines
    along_y: Splines
    mass: Matrix
    bending: Matrix
    support: Matrix
    damping: Matrix
    plate_mass: float

    @cached_property
    def stiffness(self) -> Matrix:
        """K [N/m]."""
        return self.bending + self.support

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of functions along y and along x."""
        return self.along_y.functions, self.along_x.functions

    @cached_property
    def masses(self) -> list[Oscillator]:
        """Oscillators that have a mass, in the order of their unknowns."""
        return [oscillator for oscillator in self.scene.effects.oscillators if oscillator.mass > 0]


def make_galerkin(scene: Scene, intervals: tuple[int, int]) -> Galerkin:
    """Return the matrices of a scene with about a number of intervals between knots along x and along y.

    Raises:
        SceneError: A file of the scene's variation cannot be read, or an oscillator's spring is too stiff.
    """
    along_x, along_y = (plate_splines(scene, axis, intervals[axis]) for axis in (0, 1))
    integrals, effects = Integrals(scene, along_x, along_y), scene.effects
    bend_xx, bend_xy, bend_yy, twist, density = integrals.fields()
    bending = (
        integrals.values(bend_xx, x=(2, 2))
        + integrals.values(bend_yy, y=(2, 2))
        + integrals.values(4 * twist, x=(1, 1), y=(1, 1))
        + integrals.values(bend_xy, x=(2, 0), y=(0, 2))
        + integrals.values(bend_xy, x=(0, 2), y=(2, 0))
    )
    support, area = _edge_springs(scene, integrals), integrals.values(1.0)
    if effects.tension is not None:
        support += integrals.values(effects.tension.x, x=(1, 1)) + integrals.values(effects.tension.y, y=(1, 1))
    damping = (effects.damping.viscous if effects.damping else 0.0) * area
    if effects.foundation is not None:
        support += effects.foundation.stiffness * area
        damping += effects.foundation.damping * area
    masses = [oscillator.mass for oscillator in effects.oscillators if oscillator.mass > 0]
    _check_springs(integrals, float(bending.max()))
    return Galerkin(
        scene=scene,
        intervals=intervals,
        along_x=along_x,
        along_y=along_y,
        mass=_with_masses(integrals.matrix(density), masses),
        bending=_with_masses(integrals.scatter(bending), np.zeros(len(masses))),
        support=_with_links(integrals, support, "stiffness"),
        damping=_with_links(integrals, damping, "damping"),
        plate_mass=integrals.integral(density),
    )


def point_values(galerkin: Galerkin, points: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
    """Return (points, unknowns of the plate) values of the functions at points (x, y) [m]."""
    x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
    products = galerkin.along_y.values(y).T[:, :, None] * galerkin.along_x.values(x).T[:, None, :]
    return np.asarray(products.reshape(len(x), -1))


def load_integrals(galerkin: Galerkin, areas: np.ndarray) -> np.ndarray:
    """Return (rectangles, unknowns of the plate) loads of unit drives of the scene's actuators.

    Args:
        galerkin: Plate.
        areas: (..., actuators, 4) rectangles x0, x1, y0, y1 [m] of the actuators.
    """
    scene, along = galerkin.scene, (galerkin.along_x, galerkin.along_y)
    if not scene.piezo:
        return patch_integrals(*along, areas)
    rectangles = np.asarray(areas, dtype=float).reshape(-1, 4)
    moments = np.resize(piezo_moments(scene), len(rectangles))
    return -moments[:, None] * curvature_integrals(*along, rectangles)


def curvature_integrals(along_x: Splines, along_y: Splines, areas: np.ndarray) -> np.ndarray:
    """Return (areas, unknowns of the plate) ∫ ∇²(X_i Y_j) dA over rectangles (areas, 4) x0, x1, y0, y1 [m]."""
    x0, x1, y0, y1 = areas.T
    bent_x, bent_y = along_x.values(x1, 1) - along_x.values(x0, 1), along_y.values(y1, 1) - along_y.values(y0, 1)
    products = along_y.integrals(y0, y1).T[:, :, None] * bent_x.T[:, None, :]
    products = products + bent_y.T[:, :, None] * along_x.integrals(x0, x1).T[:, None, :]
    return np.asarray(products.reshape(len(areas), -1))


def patch_integrals(along_x: Splines, along_y: Splines, areas: np.ndarray) -> np.ndarray:
    """Return (areas, unknowns of the plate) ∫ X_i Y_j dA over rectangles (areas, 4) x0, x1, y0, y1 [m]."""
    x0, x1, y0, y1 = np.asarray(areas, dtype=float).reshape(-1, 4).T
    products = along_y.integrals(y0, y1).T[:, :, None] * along_x.integrals(x0, x1).T[:, None, :]
    return np.asarray(products.reshape(len(x0), products.shape[1] * products.shape[2]))


def _edge_springs(scene: Scene, integrals: Integrals) -> np.ndarray:
    """Return the stiffness [N/m] of elastic edges, ∮ k u² + r u_n² ds, of each pair of functions."""
    total = np.zeros([rows.size for rows, _ in integrals.pairs][::-1])
    for side, edge in scene.edges:
        if not isinstance(edge, ElasticEdge):
            continue
        axis = 0 if side in ("left", "right") else 1
        value, slope = (end_products(integrals.along[axis], side in ("right", "top"), each) for each in (0, 1))
        across = edge.translation * value + edge.rotation * slope
        along = side_products(integrals.along[1 - axis], 0, 0)
        total += np.outer(along, across) if axis == 0 else np.outer(across, along)
    return total


def _patch_means(along_x: Splines, along_y: Splines, areas: Iterable[Area]) -> np.ndarray:
    """Return (areas, unknowns of the plate) mean values of the functions over rectangles [m]."""
    rectangles = np.array(list(areas), dtype=float).reshape(-1, 4)
    size = (rectangles[:, 1] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 2])
    return patch_integrals(along_x, along_y, rectangles) / size[:, None]


def _with_links(integrals: Integrals, values: np.ndarray, key: str) -> Matrix:
    """Return the matrix of values of the plate's pairs and Σ value (ū − z)², for the oscillators' springs or dampers.

    Those without a mass have z = 0.
    """
    oscillators, matrix = integrals.scene.effects.oscillators, integrals.scatter(values)
    if not oscillators:
        return matrix
    means = _patch_means(*integrals.along, [oscillator.area for oscillator in oscillators])
    masses = sum(oscillator.mass > 0 for oscillator in oscillators)
    rows, index = np.zeros((len(oscillators), means.shape[1] + masses)), 0
    rows[:, : means.shape[1]] = means
    for row, oscillator in zip(rows, oscillators, strict=True):
        if oscillator.mass > 0:
            row[means.shape[1] + index] = -1
            index += 1
    sparse, factors = Matrix(rows), np.array([getattr(oscillator, key) for oscillator in oscillators])
    padded = _with_masses(matrix, np.zeros(masses))
    return Matrix(padded + sparse.T @ (scipy.sparse.diags_array(factors) @ sparse))


def _check_springs(integrals: Integrals, largest: float) -> None:
    """Raise a SceneError if an oscillator's spring is too stiff beside the ``largest`` stiffness of two functions."""
    oscillators = integrals.scene.effects.oscillators
    means = _patch_means(*integrals.along, [oscillator.area for oscillator in oscillators])
    for index, (oscillator, row) in enumerate(zip(oscillators, means, strict=True)):
        limit = STIFFEST * largest / (1.0 if oscillator.mass > 0 else float(np.max(row**2)))
        if oscillator.stiffness > limit:
            key = f"effects.oscillators[{index}].stiffness = {oscillator.stiffness:g}"
            raise SceneError(f"{key}: hides the plate in rounding; {limit / 1000:.1g} N/m are as good as rigid")


def _with_masses(matrix: Matrix, masses: Sequence[float] | np.ndarray) -> Matrix:
    """Return a matrix of the plate with further unknowns, the motions of masses, and these on its diagonal."""
    if not len(masses):
        return matrix
    return Matrix(scipy.sparse.block_diag([matrix, scipy.sparse.diags_array(masses)], format="csr"))
