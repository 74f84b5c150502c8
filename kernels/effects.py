"""The compile key: what kernels are specialised for."""

from dataclasses import dataclass


@dataclass(frozen=True)
class KernelEffects:
    """Physics compiled into a kernel; what is off leaves no arithmetic behind.

    All but the first three fields belong to the moment form, see ``moment_form``.

    Attributes:
        damping: The rate decays at each step.
        square_cells: Spacings along x and y are equal, which saves an operation in each second-order Laplacian.
        order: Order of the differences in space, 2 or 4.
        terms: Terms of the load in time, see ``load``.
        moments: Bending stiffness varies over the plate, or an edge is free or elastic.
        material_damping: Stress follows the strain rate too (Kelvin–Voigt).
        tension: Constant membrane tension.
        foundation: Elastic bed or elastic edges.
        stretching: Tension that grows with the deflection (Berger).
        oscillators: Masses on springs.
        moving_load: A load that travels over the plate.
    """

    damping: bool = False
    square_cells: bool = True
    order: int = 2
    terms: int = 2
    moments: bool = False
    material_damping: bool = False
    tension: bool = False
    foundation: bool = False
    stretching: bool = False
    oscillators: bool = False
    moving_load: bool = False

    @property
    def plain(self) -> bool:
        """True for a uniform plate with clamped or supported edges, which needs no moment form."""
        return self == KernelEffects(self.damping, self.square_cells, self.order)
