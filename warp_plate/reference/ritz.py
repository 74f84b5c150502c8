"""Natural modes of rectangular plates with clamped, supported, free and sprung edges in any mix, by the Ritz method.

The modes make the elastic energy stationary against the kinetic one,

    U = D/2 ∫ u_xx² + u_yy² + 2ν u_xx u_yy + 2(1 − ν) u_xy² dA,   T = ρH/2 ∫ u̇² dA,   u = Σ q_ij φ_i(x) ψ_j(y),

the problem of A. W. Leissa, The free vibration of rectangular plates, J. Sound Vib. 31 (1973) 257-293. Only geometric
conditions must be built into the functions (u = 0 on a supported edge, u = u_n = 0 on a clamped one); moments and
forces of supported and free edges follow from U. An edge on springs is a free one whose energy ½∮ k u² + r u_n² ds is
added to U, with k [N/m²] and r [N] per length. Along one side, s = −1 ... 1, with p = 0, 1, 2 conditions at the low
end (free, supported, clamped) and q at the high one,

    φ_i(s) = (1 + s)^p (1 − s)^q P_i^(2q, 2p)(s) / norm,   i = 0, 1, ...,

P the Jacobi polynomials, which are orthogonal under the weight (1 − s)^2q (1 + s)^2p. So the φ_i are orthonormal
polynomials, those of Gram and Schmidt's process on (1 + s)^p (1 − s)^q s^i: the method of R. B. Bhat,
J. Sound Vib. 102 (1985) 493-499, in closed form. They are kept as sums of Legendre polynomials, as N. S. Bardell's
functions are (J. Sound Vib. 151 (1991) 263-289). The mass matrix is ρH times one; the stiffness matrix is a sum of
Kronecker products of one-dimensional integrals, for which Gauss's rule is exact.

Natural frequencies converge from above and fast, slowed only by the corners. Motion under a patch, whose load has
jumps, converges like a power of the number of functions; quadratic results, such as energies, have about the square of
its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial import legendre

from warp_plate.reference.thin_plate import Held, ThinPlate
from warp_plate.scene.fields import Area
from warp_plate.scene.model import ElasticEdge

# Number of geometric conditions of an edge: on the displacement, then on the slope. Springs have none.
CONDITIONS = {"free": 0, "supported": 1, "clamped": 2}


@dataclass(frozen=True)
class Line:
    """Orthonormal functions along one side: ∫ φ_i φ_j dx = δ_ij."""

    length: float  # Length of the side [m]
    coefficients: np.ndarray  # (functions, degree + 1) coefficients of Legendre polynomials in s = 2x/length − 1 [1/√m]
    even: bool  # True if both ends are held alike, so that φ_i is even or odd about the middle as i is

    @property
    def functions(self) -> int:
        """Number of functions."""
        return len(self.coefficients)

    def values(self, x: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return (functions, points) values of a derivative at x [m]."""
        coefficients = self.coefficients
        if derivative:
            coefficients = legendre.legder(coefficients, derivative, scl=2 / self.length, axis=1)
        s = 2 * np.asarray(x, dtype=float) / self.length - 1
        return np.asarray(coefficients @ legendre.legvander(s, coefficients.shape[1] - 1).T)

    def products(self, low: float, high: float, first: int = 0, second: int = 0) -> np.ndarray:
        """Return (functions, functions) ∫ of two derivatives, row times column, from low to high [m]."""
        x, weights = _gauss(self.coefficients.shape[1], low, high)
        return np.asarray((self.values(x, first) * weights) @ self.values(x, second).T)

    def integrals(self, low: float, high: float) -> np.ndarray:
        """Return (functions,) integrals from low to high [m]."""
        x, weights = _gauss(self.coefficients.shape[1], low, high)
        return np.asarray(self.values(x) @ weights)


@dataclass(frozen=True)
class Modes:
    """Natural modes of a plate, as many as there are functions, by rising frequency; only the lowest are accurate."""

    plate: ThinPlate  # The plate
    along_x: Line  # Functions of x
    along_y: Line  # Functions of y
    angular_frequencies: np.ndarray  # (modes,) ω [rad/s], zero for rigid motions
    # (modes, functions of y, functions of x); the shapes Φ have ∫ Φ_m Φ_n dA = δ_mn (shapes in 1/m, amplitudes in
    # m²)
    vectors: np.ndarray

    @property
    def rigid(self) -> int:
        """Number of rigid motions: 3 without any held edge, 1 with one supported edge."""
        left, bottom, right, top = self.plate.edges
        # Displacements of the corners of held edges, and slopes across these, of the motions 1, x/width and y/height.
        held = [np.zeros((1, 3))]
        for edge, x in ((left, 0.0), (right, 1.0)):
            held.append(_holds(edge)[0] * np.array([[1, x, 0], [1, x, 1]]))
            held.append(_holds(edge)[1] * np.array([[0, 1, 0]]))
        for edge, y in ((bottom, 0.0), (top, 1.0)):
            held.append(_holds(edge)[0] * np.array([[1, 0, y], [1, 1, y]]))
            held.append(_holds(edge)[1] * np.array([[0, 0, 1]]))
        return 3 - int(np.linalg.matrix_rank(np.concatenate(held)))

    def shapes(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (modes, points of y, points of x) shapes Φ [1/m] on the grid of x and y [m]."""
        return np.asarray(self.along_y.values(y).T @ self.vectors @ self.along_x.values(x))

    def patch_forces(self, areas: Sequence[Area]) -> np.ndarray:
        """Return (areas, modes) ∫ Φ dA [m] over rectangles x0, x1, y0, y1 [m]: modal forces of a pressure of one."""
        along_x = np.array([self.along_x.integrals(x0, x1) for x0, x1, _, _ in areas])
        along_y = np.array([self.along_y.integrals(y0, y1) for _, _, y0, y1 in areas])
        return np.einsum("mji,pj,pi->pm", self.vectors, along_y, along_x, optimize=True)

    def overlaps(self, area: Area) -> np.ndarray:
        """Return (modes, modes) ∫ Φ_m Φ_n dA over a rectangle: the Gram matrix of a region."""
        x0, x1, y0, y1 = area
        inside = self.along_y.products(y0, y1) @ self.vectors @ self.along_x.products(x0, x1)
        count = len(self.vectors)
        return np.asarray(inside.reshape(count, -1) @ self.vectors.reshape(count, -1).T)


def solve_modes(plate: ThinPlate, functions: int | tuple[int, int] = 32) -> Modes:
    """Return the modes of a plate from ``functions`` in each direction, or a pair for x and y.

    If both ends of a direction are held alike, even and odd functions do not mix, and are solved for apart. Rounding
    grows with the eighth power of the number of functions: the lowest frequencies keep 7 digits with 48 and 5 with 64.

    Raises:
        ValueError: There are fewer than 4 functions in a direction.
    """
    columns, rows = (functions, functions) if isinstance(functions, int) else functions
    if min(columns, rows) < 4:
        raise ValueError(f"functions = {functions}: must be at least 4")
    left, bottom, right, top = plate.edges
    along_x = make_line(plate.size[0], left, right, columns)
    along_y = make_line(plate.size[1], bottom, top, rows)
    matrix = stiffness_matrix(along_x, along_y, plate.poisson_ratio)
    matrix += np.kron(np.eye(rows), _springs(along_x, left, right) / plate.rigidity)
    matrix += np.kron(_springs(along_y, bottom, top) / plate.rigidity, np.eye(columns))
    symmetry = 2 * (np.arange(rows) % 2 * along_y.even)[:, None] + np.arange(columns) % 2 * along_x.even
    values, vectors = np.empty(0), np.empty((0, rows * columns))
    for kind in np.unique(symmetry):
        members = np.flatnonzero(symmetry == kind)
        some_values, some_vectors = scipy.linalg.eigh(matrix[np.ix_(members, members)])
        placed = np.zeros((members.size, rows * columns))
        placed[:, members] = some_vectors.T
        values, vectors = np.concatenate([values, some_values]), np.concatenate([vectors, placed])
    order = np.argsort(values, kind="stable")
    modes = Modes(
        plate=plate,
        along_x=along_x,
        along_y=along_y,
        angular_frequencies=np.sqrt(plate.rigidity / plate.surface_density * np.maximum(values[order], 0)),
        vectors=vectors[order].reshape(-1, rows, columns),
    )
    modes.angular_frequencies[: modes.rigid] = 0  # but for rounding
    return modes


def make_line(length: float, low: Held, high: Held, functions: int) -> Line:
    """Return the functions of one direction that satisfy the geometric conditions at its low and high end."""
    p, q = (0 if isinstance(edge, ElasticEdge) else CONDITIONS[edge] for edge in (low, high))
    degrees = np.arange(functions + p + q)
    s, weights = legendre.leggauss(degrees.size)
    order = np.arange(functions)[:, None]
    values = (1 + s) ** p * (1 - s) ** q * scipy.special.eval_jacobi(order, 2 * q, 2 * p, s)
    values /= np.sqrt((values**2 * weights).sum(axis=1))[:, None]
    # Gauss's rule with degree + 1 points is exact for products of two of these polynomials.
    coefficients = (values * weights) @ legendre.legvander(s, degrees[-1]) * (degrees + 0.5)
    return Line(length=length, coefficients=coefficients * np.sqrt(2 / length), even=low == high)


def stiffness_matrix(along_x: Line, along_y: Line, poisson_ratio: float) -> np.ndarray:
    """Return the square matrix of stiffnesses over D [1/m⁴], the functions of x counting fastest."""

    def of(line: Line, first: int, second: int) -> np.ndarray:
        return line.products(0, line.length, first, second)

    coupled = np.kron(of(along_y, 0, 2), of(along_x, 2, 0))
    identity_x, identity_y = np.eye(along_x.functions), np.eye(along_y.functions)
    matrix: np.ndarray = (
        np.kron(identity_y, of(along_x, 2, 2))
        + np.kron(of(along_y, 2, 2), identity_x)
        + poisson_ratio * (coupled + coupled.T)
        + 2 * (1 - poisson_ratio) * np.kron(of(along_y, 1, 1), of(along_x, 1, 1))
    )
    return matrix


def _springs(line: Line, low: Held, high: Held) -> np.ndarray:
    """Return (functions, functions) stiffness [N/m³] of the springs at both ends: k φ_i φ_j + r φ_i' φ_j'."""
    matrix = np.zeros((line.functions, line.functions))
    for edge, place in ((low, 0.0), (high, line.length)):
        if isinstance(edge, ElasticEdge):
            value, slope = (line.values(np.array([place]), derivative)[:, 0] for derivative in (0, 1))
            matrix += edge.translation * np.outer(value, value) + edge.rotation * np.outer(slope, slope)
    return matrix


def _holds(edge: Held) -> tuple[bool, bool]:
    """Return whether an edge resists displacement, and slope across it."""
    if isinstance(edge, ElasticEdge):
        return edge.translation > 0, edge.rotation > 0
    return CONDITIONS[edge] >= 1, CONDITIONS[edge] == 2


def _gauss(count: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points and weights from low to high, exact up to degree 2·count − 1."""
    s, weights = legendre.leggauss(count)
    return (low + high) / 2 + (high - low) / 2 * s, (high - low) / 2 * weights
