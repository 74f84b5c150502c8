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

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from warp_plate.modal.galerkin.integrals import Integrals, Matrix
from warp_plate.modal.galerkin.lines import plate_splines
from warp_plate.modal.galerkin.splines import Splines
from warp_plate.scene.effects import Oscillator
from warp_plate.scene.fields import Area
from warp_plate.scene.model import ElasticEdge, Scene
from warp_plate.scene.piezo import piezo_moments


@dataclass(frozen=True)
class Galerkin:
    """Matrices over the products of splines, x fastest, then over the oscillators' masses.

    Attributes:
        scene: Scene.
        along_x: Functions of x.
        along_y: Functions of y.
        mass: M [kg].
        bending: B, the stiffness of the plate without edges and attachments [N/m].
        support: K − B, of edges, tension, foundation and oscillators [N/m].
        damping: C [N·s/m] but for τB, the damping of the material.
        plate_mass: Mass of the plate with its layers, without oscillators [kg].
    """

    scene: Scene
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
        SceneError: A file of the scene's variation cannot be read.
    """
    along_x, along_y = (plate_splines(scene, axis, intervals[axis]) for axis in (0, 1))
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
    support, area = _edge_springs(scene, integrals), integrals.matrix(1.0)
    if effects.tension is not None:
        support += effects.tension.x * integrals.matrix(1.0, x=(1, 1))
        support += effects.tension.y * integrals.matrix(1.0, y=(1, 1))
    damping = (effects.damping.viscous if effects.damping else 0.0) * area
    if effects.foundation is not None:
        support += effects.foundation.stiffness * area
        damping += effects.foundation.damping * area
    masses = [oscillator.mass for oscillator in effects.oscillators if oscillator.mass > 0]
    means = _patch_means(along_x, along_y, [oscillator.area for oscillator in effects.oscillators])
    return Galerkin(
        scene=scene,
        along_x=along_x,
        along_y=along_y,
        mass=scipy.sparse.block_diag([integrals.matrix(density), *masses], format="csr"),
        bending=_padded(bending, len(masses)),
        support=_padded(support, len(masses)) + _links(effects.oscillators, means, "stiffness"),
        damping=_padded(damping, len(masses)) + _links(effects.oscillators, means, "damping"),
        plate_mass=integrals.integral(density),
    )


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
