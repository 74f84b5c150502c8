"""Protocol of function spaces: what the modal engine asks of the functions whose sum is the displacement.

A new shape of plate is a new implementation in this folder. The functions keep the displacement of supported edges and
the slope of clamped ones; other conditions follow from the energies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, Self, TypeAlias

import numpy as np
import scipy

from warp_plate.effects.effect import DISPLACEMENT, Factors, Term
from warp_plate.plate.section import Laminate
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion, Target

Matrix: TypeAlias = scipy.sparse.csr_array


class FunctionSpace(Protocol):
    """A finite number of functions on a plate, and integrals of their products."""

    laminate: Laminate  # The plate with its layers and maps

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""

    @property
    def sparse(self) -> bool:
        """True if most entries of the matrices of many functions are zero."""

    @property
    def unknowns(self) -> int:
        """Number of functions."""

    @property
    def plate_mass(self) -> float:
        """Mass of the plate with its layers [kg]."""

    @property
    def interval_sizes(self) -> tuple[float, float]:
        """Mean sizes of the functions' pieces along x and along y [m]."""

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of points along y and along x that resolve the functions."""

    def of_scene(self, scene: Scene) -> Self:
        """Return the space of another scene, with as many functions where its lines are the same."""

    def is_near(self, other: Self, share: float) -> bool:
        """Return whether another space has the same functions up to a share of the size of their pieces."""

    def bending_terms(self) -> Iterable[Term]:
        """Yield the terms of the plate's own bending."""

    def mass_matrix(self) -> Matrix:
        """Return the mass matrix of the plate [kg]."""

    def form(self, coefficient: Any, factors: Factors = DISPLACEMENT) -> np.ndarray:
        """Return the integral of a term over the plate, as an array that may be added to others."""

    def edge_form(self, side: str, coefficients: Mapping[Factors, float]) -> np.ndarray:
        """Return the integral along an edge of terms, whose coefficients are given by their factors."""

    def scatter(self, values: np.ndarray) -> Matrix:
        """Return the sparse matrix (unknowns, unknowns) of a sum of arrays by :meth:`form`."""

    def bending_energies(self, vectors: np.ndarray) -> np.ndarray:
        """Return (n, n) bending energies of vectors (unknowns, n) from their curvatures, with small relative errors."""

    def density(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the mass per area [kg/m²] on the grid (y, x) of points [m]."""

    def at_points(self, points: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
        """Return (points, unknowns) values at points (x, y) [m]."""

    def sums_at_points(self, coefficients: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return (n, points) values of sums of functions (n, unknowns) at points (points, 2) [m]."""

    def on_grid(self, coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (..., ny, nx) values of sums of functions (..., unknowns) on the grid of x and y [m]."""

    def patch_integrals(self, areas: np.ndarray) -> np.ndarray:
        """Return (areas, unknowns) integrals over rectangles (areas, 4) x0, x1, y0, y1 [m]."""

    def region_integrals(self, regions: Sequence[PlateRegion]) -> np.ndarray:
        """Return (regions, unknowns) integrals over the parts of regions on the plate."""

    def region_areas(self, regions: Sequence[PlateRegion]) -> np.ndarray:
        """Return (regions,) areas [m²] of the parts of regions on the plate."""

    def patch_slopes(self, areas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (areas, unknowns) derivatives of :meth:`patch_integrals` by the rectangles' places."""

    def curvature_integrals(self, areas: np.ndarray) -> np.ndarray:
        """Return (areas, unknowns) integrals of the functions' Laplacians over rectangles [m]."""

    def moments(self, counts: tuple[int, int]) -> np.ndarray:
        """Return (count along y, count along x, unknowns) integrals over the plate of the functions times Legendre
        polynomials P_i(x) P_j(y) of so many degrees along x and y over the sides of ``plate.size``."""

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, 2) [m] and weights (n,) [m²] that integrate a function times a smooth one."""

    def region_matrix(self, region: Area | Target, within: Area | None = None) -> Matrix:
        """Return the mass matrix [kg] of a rectangle or target, or of its part in the rectangle ``within``."""

    def region_mass(self, region: Area | Target) -> float:
        """Return the mass [kg] of a rectangle or target, without what is attached."""

    def parity_bases(self) -> list[Matrix]:
        """Return bases (unknowns, n) of motions that the modes of a uniform plate do not mix."""
