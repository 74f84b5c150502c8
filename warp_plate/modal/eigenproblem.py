"""Natural frequencies and shapes from the matrices of a plate.

The matrices' own rounding, some 1e-16 of their largest entries, would make the lowest frequencies of slender plates and
the rigid motions of free plates wrong in the fourth digit, for the stiffest splines are 1e16 times as stiff as the
plate. The lowest modes are therefore solved once more in the space that they span, with bending energies that are
integrated from their curvatures: these have small relative errors.
"""

import math

import numpy as np
import scipy

from warp_plate.effects.effect import IN_PLANE
from warp_plate.modal.assemble import Galerkin, make_galerkin, make_space
from warp_plate.modal.spaces.space import Matrix
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.stability_limit import buckled
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Modes that are solved for again.
LOWEST = 12
# All modes are computed unless fewer than one in SPARSE is wanted: then Lanczos' method takes less time.
SPARSE = 5
# Modes with less than this part of the largest flexibility 1/(ω² + scale) are left out: rounding couples their damping.
FLEXIBLE = 1e-9
# Matrices of all unknowns, and vectors of a wanted mode, that the two ways hold.
DENSE_MATRICES, LANCZOS_VECTORS = 7, 4
# Matrices with more entries than this part are multiplied as dense ones.
DENSE = 0.1
# A negative ω² beyond this part of the size of the lowest shows that the plate buckles.
BUCKLED = 1e-8
# Intervals along both sides for the critical load, and the least ratio to it of forces that make a plate buckle: the
# coarse functions overestimate it a little.
INTERVALS, LEAST_PRESSED = 18, 0.9


def solve_eigenproblem(
    galerkin: Galerkin,
    wanted: int,
    scale: float,
    least: float = 0.0,
    improve: bool = True,
    flexible: float = FLEXIBLE,
) -> tuple[np.ndarray, np.ndarray]:
    """Return ω² [1/s²], rising, and mass-normalised vectors (unknowns, modes) of at least the ``wanted`` lowest modes.

    ``scale`` is the size of the lowest ω²; all modes up to ``least`` [1/s²] are found, by Weyl's law ``wanted``.
    Of dense matrices those with less than a part ``flexible`` of the largest flexibility are left out. SceneError: the
    plate buckles, or the matrices do not fit into memory.
    """
    bases = _bases(galerkin)
    # Up to a frequency, nearly equal numbers of modes have each parity; the difference grows as the plate's perimeter.
    share = math.ceil(wanted / len(bases) + (len(bases) - 1) * math.sqrt(wanted) / 2)
    if least:
        # Edges that are neither clamped nor supported add modes to those of Weyl's law.
        edges = [not isinstance(edge, str) or edge == "free" for _, edge in galerkin.scene.edge_conditions]
        loose = sum(edges) / len(edges)
        share = math.ceil(wanted / len(bases) + (2 / len(bases) + 0.25) * math.sqrt(wanted) * loose + 5)
    parts = [_solve(galerkin, basis, share, scale, least, flexible) for basis in bases]
    sizes = [squares.size for squares, _ in parts]
    highest = min((squares[-1] for squares, _ in parts if squares.size == share), default=math.inf)
    squares, parity = np.concatenate([squares for squares, _ in parts]), np.repeat(range(len(parts)), sizes)
    order = np.argsort(squares, kind="stable")
    order = order[squares[order] <= highest]
    squares, vectors = squares[order], np.concatenate([vectors for _, vectors in parts], axis=1)[:, order]
    if improve:
        _improve_lowest(galerkin, squares, vectors, parity[order])
    order = np.argsort(squares, kind="stable")
    if squares[order[0]] < -BUCKLED * scale:
        raise _buckled(galerkin.scene)
    return squares[order], vectors[:, order]


def _bases(galerkin: Galerkin) -> list[Matrix]:
    """Return bases (unknowns, n) of motions that the modes do not mix."""
    scene = galerkin.scene
    if scene.layers or scene.effects.factor_maps or galerkin.attachments:
        return [scipy.sparse.eye_array(galerkin.mass.shape[0], format="csr")]
    return galerkin.space.parity_bases()


def _solve(
    galerkin: Galerkin, basis: Matrix, wanted: int, scale: float, least: float, flexible: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return ω², rising, and vectors (unknowns, modes) of the motions that a basis (unknowns, n) spans: of ``wanted``
    modes, or of more if they do not reach ``least``."""
    unknowns = basis.shape[1]
    few = galerkin.space.sparse and wanted * SPARSE < unknowns
    held = LANCZOS_VECTORS * wanted if few else DENSE_MATRICES * unknowns
    refuse_beyond_memory(8.0 * unknowns * held, f"plate.size: {unknowns} functions and {min(wanted, unknowns)} modes")
    rows = Matrix(basis.T)  # whose products copy no matrix into another format
    stiffness, mass = (Matrix(rows @ matrix @ basis) for matrix in (galerkin.stiffness, galerkin.mass))
    try:
        if few:
            squares, vectors = lowest_by_lanczos(stiffness, mass, wanted, scale)
        else:
            squares, vectors = all_modes(stiffness, mass, scale, flexible)
    except np.linalg.LinAlgError:
        raise _buckled(galerkin.scene) from None
    if squares.size == wanted and squares[-1] < least:
        return _solve(galerkin, basis, wanted + math.ceil(wanted / 4), scale, least, flexible)
    return squares, basis @ vectors


def lowest_by_lanczos(
    stiffness: scipy.sparse.sparray, mass: scipy.sparse.sparray | None, count: int, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest (count,) eigenvalues, rising, and vectors (unknowns, count) of Kφ = λMφ; no M is the identity.

    The negative shift, of the size of the lowest, makes the singular matrix of a free plate solvable.
    """
    identity = scipy.sparse.eye_array(stiffness.shape[0])
    shifted = scipy.sparse.csc_array(stiffness + scale * (identity if mass is None else mass))
    solve = factorised(shifted).solve
    inverse = scipy.sparse.linalg.LinearOperator(shifted.shape, matvec=solve, dtype=float)
    # Started from a vector without symmetry, which finds modes of every symmetry.
    start = np.random.default_rng(0).normal(size=shifted.shape[0])
    values, vectors = scipy.sparse.linalg.eigsh(stiffness, count, mass, sigma=-scale, OPinv=inverse, v0=start)
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


def factorised(matrix: scipy.sparse.csc_array) -> scipy.sparse.linalg.SuperLU:
    """Return the triangular factors of a symmetric matrix."""
    options = {"SymmetricMode": True}
    return scipy.sparse.linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def _improve_lowest(galerkin: Galerkin, squares: np.ndarray, vectors: np.ndarray, parity: np.ndarray) -> None:
    """Solve for the lowest modes once more, in the space that those of each parity (modes,) span; in place."""
    low = vectors[:, :LOWEST]
    energies = _from_curvatures(galerkin, low) + low.T @ (galerkin.support @ low)
    for index in np.unique(parity[: low.shape[1]]):
        alike = np.flatnonzero(parity[: low.shape[1]] == index)
        squares[alike], rotation = scipy.linalg.eigh(energies[np.ix_(alike, alike)])
        vectors[:, alike] = vectors[:, alike] @ rotation


def all_modes(
    stiffness: Matrix, mass: Matrix, scale: float, flexible: float = FLEXIBLE
) -> tuple[np.ndarray, np.ndarray]:
    """Return ω² [1/s²], rising, and vectors (unknowns, modes) of all modes with more than a part ``flexible`` of the
    largest flexibility, by dense matrices."""
    dense = mass.toarray()
    shifted = stiffness.toarray() + scale * dense
    # Eigenvalues of the inverse problem: the largest have small relative errors, and they belong to the lowest modes.
    if np.diag(shifted).min() <= 0:
        raise np.linalg.LinAlgError("not positive definite")
    units = 1 / np.sqrt(np.diag(shifted))
    inverse, vectors = scipy.linalg.eigh(dense * np.outer(units, units), shifted * np.outer(units, units), driver="gvd")
    inverse, vectors = inverse[::-1], (units[:, None] * vectors)[:, ::-1]
    kept = inverse > flexible * inverse[0]
    inverse, vectors = inverse[kept], vectors[:, kept]
    return 1 / inverse - scale, vectors / np.sqrt(inverse)


def bending_energies(galerkin: Galerkin, squares: np.ndarray, vectors: np.ndarray, improve: bool = True) -> np.ndarray:
    """Return (modes, modes) Φᵀ B Φ [1/s²] of all modes Φ (unknowns, modes) and their ω²; ``improve`` as for these."""
    if not galerkin.support.count_nonzero():
        return np.diag(np.maximum(squares, 0.0))
    energies = projected(galerkin.bending, vectors)
    if improve:
        energies[:LOWEST, :LOWEST] = _from_curvatures(galerkin, vectors[:, :LOWEST])
    return energies


def projected(matrix: Matrix, vectors: np.ndarray) -> np.ndarray:
    """Return (modes, modes) Φᵀ matrix Φ of vectors Φ (unknowns, modes)."""
    dense = matrix.nnz > DENSE * matrix.shape[0] ** 2
    return np.asarray(vectors.T @ ((matrix.toarray() if dense else matrix) @ vectors))


def _from_curvatures(galerkin: Galerkin, vectors: np.ndarray) -> np.ndarray:
    """Return (modes, modes) Φᵀ B Φ of vectors Φ (unknowns, modes), from their curvatures."""
    return galerkin.space.bending_energies(vectors[: galerkin.space.unknowns])


def _buckled(scene: Scene) -> SceneError:
    """Return the error for a plate that in-plane forces T buckle: for some μ < 1, K − T + μT is singular; or for one
    whose springs are too stiff for the precision."""
    forces = [term for term in scene.terms if term.factors in IN_PLANE]
    x, y = (sum((term.coefficient for term in forces if term.factors == one), 0.0) for one in IN_PLANE)
    rule = "leave out the stiffness of a rigid support, and write edges as clamped or supported"
    stiff = SceneError(f"supports, edges: a spring is too stiff beside the plate; {rule}")
    if min(x, y) >= 0:  # then rounding has made K indefinite
        return stiff
    free = scene.effects.keeping(lambda effect: all(term.factors not in IN_PLANE for term in effect.terms(scene.plate)))
    space = make_space(scene, (INTERVALS, INTERVALS))
    pressed, bare = (make_galerkin(one, space).stiffness for one in (scene, scene.model_copy(update={"effects": free})))
    # The rigid motion of a plate that nothing holds gets a stiffness of rounding's size.
    held = bare + 1e-12 * bare.diagonal().max() * scipy.sparse.eye_array(bare.shape[0])
    try:
        largest = scipy.sparse.linalg.eigsh(bare - pressed, 1, held.tocsc(), which="LA", return_eigenvectors=False)[0]
    except scipy.sparse.linalg.ArpackError:  # rounding has left nothing of the forces
        return stiff
    label = " and ".join(dict.fromkeys(term.label for term in forces))
    return buckled(label, (x, y), 1 / largest) if largest > LEAST_PRESSED else stiff
