"""Natural frequencies and mode shapes of the discretized plate, K φ = ω² M φ: what other ways are compared with.

K and M are the matrices that the kernels step with, with edges, layers, in-plane forces, springs and attached masses.
Damping is left out, and so is the membrane stiffness of large motion. Time is continuous: a run with steps of Δt
rings at asin(ωΔt/2)/(πΔt) instead, see :attr:`GridModes.stepped`.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.modal.continuous_modes import NaturalModes, normalised_shapes, separated
from warp_plate.modal.eigenproblem import lowest_by_lanczos
from warp_plate.plate.bending import make_bending, system
from warp_plate.plate.operator import biharmonic
from warp_plate.plate.scheme import Scheme, make_scheme
from warp_plate.scene.model import Scene

# Up to this many unknowns all modes are computed by a dense solver; above, the lowest by Lanczos' method.
DENSE = 300
# Further modes asked of Lanczos' method, which may miss the last of several modes of the same frequency.
SPARE = 4
# ω² is zero below this part of κ²(π/longer side)⁴, the order of the lowest of a plate, or this part of the largest,
# which rounding leaves of a rigid motion.
STILL, RELATIVE_ZERO = 1e-8, 1e-14


@dataclass(frozen=True, eq=False)
class GridModes(NaturalModes):
    """The lowest modes of a scene's grid, by rising frequency; without loss factors."""

    time_step: float  # time step of the scene [s]

    @property
    def stepped(self) -> np.ndarray:
        """(count,) frequencies at which a run with this time step rings [Hz]."""
        stepped: np.ndarray = np.arcsin(math.pi * self.frequencies * self.time_step) / (math.pi * self.time_step)
        return stepped


def natural_modes(scene: Scene, count: int) -> GridModes:
    """Return the first ``count`` undamped modes of the scene's grid, or all if the grid has fewer.

    Modes of one frequency are turned as by ``separated``; the peak of a shape is positive.
    """
    scene = scene.model_copy(update={"effects": scene.effects.keeping(lambda effect: effect.stepped)})
    scheme = make_scheme(scene)
    stiffness, masses, moving = _matrices(scene, scheme)
    scale = (scheme.kappa * (math.pi / max(scene.plate.size)) ** 2) ** 2
    root = scipy.sparse.diags_array(1 / np.sqrt(masses))
    operator = scipy.sparse.csc_array(root @ stiffness @ root)
    squares, vectors = _lowest(operator, min(count, len(masses)), scale)
    squares = np.where(squares > max(STILL * scale, RELATIVE_ZERO * abs(operator).max()), squares, 0.0)
    x, y = (np.linspace(-1, 1, nodes) for nodes in scene.grid.nodes)
    weight = np.zeros(len(masses))
    weight[: np.count_nonzero(moving)] = (x**2 + (y**2)[:, None] / 2)[moving]
    vectors = root @ separated(squares, vectors, weight)
    shapes, motions = normalised_shapes(scene, vectors[:, :count], moving)
    frequencies = np.sqrt(squares[:count]) / (2 * math.pi)
    return GridModes(frequencies, shapes, motions, np.zeros_like(frequencies), scheme.time_step)


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
