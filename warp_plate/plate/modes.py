"""Natural frequencies and mode shapes of the discretized plate.

    K φ = ω² M φ

K and M are the matrices that the kernels step with, with edges, layers, in-plane forces, springs and attached masses.
Damping is left out, and so is the membrane stiffness of large motion. Time is continuous: a run with steps of Δt
rings at asin(ωΔt/2)/(πΔt) instead, see :attr:`NaturalModes.stepped`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.effects.effect import attachments
from warp_plate.plate.bending import make_bending, system
from warp_plate.plate.operator import biharmonic
from warp_plate.plate.scheme import Scheme, make_scheme
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Up to this many unknowns all modes are computed by a dense solver; above, the lowest by Lanczos' method.
DENSE = 300
# The factorised matrix takes some 4 kB per node; 174 000 nodes take some 15 s.
MOST_NODES = 400_000
# Further modes asked of Lanczos' method, which may miss the last of several modes of the same frequency.
SPARE = 4
# ω² is zero below this part of κ²(π/longer side)⁴, the order of the lowest of a plate, or this part of the largest,
# which rounding leaves of a rigid motion.
STILL, ROUNDING = 1e-8, 1e-14
# Frequencies of a relative difference below this are equal.
SAME = 1e-7
# Half-waves are counted in shapes whose share PRODUCT is a product X(x)·Y(y), where they exceed ABOVE of their peak.
PRODUCT, ABOVE = 0.8, 0.03


@dataclass(frozen=True, eq=False)
class NaturalModes:
    """The lowest modes of a scene's plate or of its grid, by rising frequency."""

    frequencies: np.ndarray  # (count,) [Hz], 0 for rigid motions
    shapes: np.ndarray  # (count, ny, nx) displacements, edges included, the largest being 1
    # (count, oscillators) motion of the oscillators' masses in the same unit; NaN without a mass
    oscillators: np.ndarray
    time_step: float = math.nan  # Time step of the scene [s]; NaN without a grid
    loss_factors: np.ndarray | None = None  # (count,) loss factors, twice the damping ratios; None for those of a grid

    @property
    def stepped(self) -> np.ndarray:
        """(count,) frequencies at which a run with this time step rings [Hz]."""
        stepped: np.ndarray = np.arcsin(math.pi * self.frequencies * self.time_step) / (math.pi * self.time_step)
        return stepped

    def half_waves(self) -> list[tuple[int, int] | None]:
        """Return the numbers of lobes of each shape along x and y, one more than the nodal lines across them; None if
        nodal lines run askew. Between clamped or supported edges they are half-waves."""
        return [_half_waves(shape) for shape in self.shapes]


def natural_modes(scene: Scene, count: int) -> NaturalModes:
    """Return the first ``count`` undamped modes of the scene's grid, or all if the grid has fewer.

    Modes of one frequency are turned so that a weight of x² + y²/2 about the middle does not couple them: sides stay
    recognizable and every machine gives the same. The peak of a shape is positive. SceneError: see ``make_scheme``, or
    there are too many nodes, or count is below 1.
    """
    if count < 1:
        raise SceneError(f"count = {count}: must be at least 1")
    if (nodes := math.prod(scene.grid.nodes)) > MOST_NODES:
        raise SceneError(
            f"grid.nodes = {list(scene.grid.nodes)}: {nodes} are too many for their modes; write at most {MOST_NODES} "
            "(the error of a frequency falls with the square of the spacing, or the fourth power)"
        )
    scene = scene.model_copy(update={"effects": scene.effects.keeping(lambda effect: effect.stepped)})
    scheme = make_scheme(scene)
    stiffness, masses, moving = _matrices(scene, scheme)
    scale = (scheme.kappa * (math.pi / max(scene.plate.size)) ** 2) ** 2
    root = scipy.sparse.diags_array(1 / np.sqrt(masses))
    operator = scipy.sparse.csc_array(root @ stiffness @ root)
    squares, vectors = _lowest(operator, min(count, len(masses)), scale)
    squares = np.where(squares > max(STILL * scale, ROUNDING * abs(operator).max()), squares, 0.0)
    x, y = (np.linspace(-1, 1, nodes) for nodes in scene.grid.nodes)
    weight = np.zeros(len(masses))
    weight[: np.count_nonzero(moving)] = (x**2 + (y**2)[:, None] / 2)[moving]
    vectors = root @ separated(squares, vectors, weight)
    shapes, motions = normalised_shapes(scene, vectors[:, :count], moving)
    return NaturalModes(np.sqrt(squares[:count]) / (2 * math.pi), shapes, motions, scheme.time_step)


def _matrices(scene: Scene, scheme: Scheme) -> tuple[scipy.sparse.csc_array, np.ndarray, np.ndarray]:
    """Return stiffness [N/m] and masses [kg] of the moving nodes, then of masses on springs; (ny, nx) which move."""
    if scheme.order == 2:
        bending = make_bending(scene)
        stiffness, masses = system(bending)
        nodes = np.count_nonzero(bending.moves)
        # A mass that only a damper holds is at rest in every mode.
        swinging = [attachment.stiffness > 0 for attachment in bending.attachments if attachment.mass > 0]
        kept = np.flatnonzero([True] * nodes + swinging)
        return scipy.sparse.csc_array(stiffness[kept][:, kept]), masses[kept], bending.moves
    moves = np.zeros(scheme.nodes[::-1], dtype=bool)
    moves[1:-1, 1:-1] = True
    cell = scheme.spacing[0] * scheme.spacing[1]
    stiffness = scheme.rigidity * cell * biharmonic(scheme.taps_x, scheme.taps_y, scheme.spacing, scheme.order)
    return stiffness, np.full(stiffness.shape[0], scheme.surface_density * cell), moves


def _lowest(operator: scipy.sparse.csc_array, count: int, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (modes,) lowest eigenvalues and (unknowns, modes) vectors of a symmetric matrix, ``count`` or more."""
    unknowns = operator.shape[0]
    if unknowns <= max(DENSE, 3 * (count + SPARE)):
        values, vectors = scipy.linalg.eigh(operator.toarray())
        return values[: count + SPARE], vectors[:, : count + SPARE]
    return lowest_by_lanczos(operator, None, count + SPARE, scale)


def lowest_by_lanczos(
    stiffness: scipy.sparse.sparray, mass: scipy.sparse.sparray | None, count: int, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest (count,) eigenvalues, rising, and vectors (unknowns, count) of Kφ = λMφ; no M is the identity.

    The negative shift, of the size of the lowest, makes the singular matrix of a free plate solvable.
    """
    identity = scipy.sparse.eye_array(stiffness.shape[0])
    shifted = scipy.sparse.csc_array(stiffness + scale * (identity if mass is None else mass))
    solve = scipy.sparse.linalg.splu(
        shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    ).solve
    inverse = scipy.sparse.linalg.LinearOperator(shifted.shape, matvec=solve, dtype=float)
    # Started from a vector without symmetry, which finds modes of every symmetry.
    start = np.random.default_rng(0).normal(size=shifted.shape[0])
    values, vectors = scipy.sparse.linalg.eigsh(stiffness, count, mass, sigma=-scale, OPinv=inverse, v0=start)
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


def separated(squares: np.ndarray, vectors: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the vectors, those of one frequency turned among each other so that the weight does not couple them."""
    groups = np.split(vectors, 1 + np.flatnonzero(squares[1:] > squares[:-1] * (1 + 2 * SAME)), axis=1)
    return np.hstack([
        group if group.shape[1] == 1 else group @ np.linalg.eigh(group.T @ (weight[:, None] * group))[1]
        for group in groups
    ])  # fmt: skip


def normalised_shapes(scene: Scene, vectors: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return shapes (modes, ny, nx) and motions of attached masses (modes, attachments), the largest displacement 1, of
    vectors (unknowns, modes) over the moving nodes (ny, nx), then over the masses on springs."""
    nodes, count = np.count_nonzero(moving), vectors.shape[1]
    shapes = np.zeros((count, *moving.shape))
    shapes[:, moving] = vectors[:nodes].T
    attached = attachments(scene.terms)
    motions = np.tile([0.0 if attachment.mass > 0 else math.nan for attachment in attached], (count, 1))
    swinging = [attachment.mass > 0 and attachment.stiffness > 0 for attachment in attached]
    motions[:, swinging] = vectors[nodes:].T
    for shape, motion in zip(shapes, motions, strict=True):
        peak = _peak(shape)
        # A mass on a patch at rest oscillates by itself.
        if abs(peak) < 1e-9 * np.nanmax(np.abs(motion), initial=0):
            peak = _peak(motion[swinging])
        shape /= peak
        motion /= peak
    return shapes, motions


def _peak(values: np.ndarray) -> float:
    """Return the value of the largest magnitude; of several equal up to rounding, the first."""
    sizes = np.abs(values)
    return float(values.flat[np.argmax(sizes >= (1 - 1e-6) * sizes.max())])


def _half_waves(shape: np.ndarray) -> tuple[int, int] | None:
    along_y, sizes, along_x = np.linalg.svd(shape, full_matrices=False)
    if sizes[0] ** 2 < PRODUCT * (sizes**2).sum() or sizes[0] == 0:
        return None
    lines = (line[np.abs(line) > ABOVE * np.abs(line).max()] for line in (along_x[0], along_y[:, 0]))
    count_x, count_y = (1 + int(np.count_nonzero(np.diff(np.sign(line)))) for line in lines)
    return count_x, count_y
