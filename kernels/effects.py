"""The compile key: what kernels are specialised for."""

from dataclasses import dataclass


@dataclass(frozen=True)
class KernelEffects:
    """Physics compiled into a kernel; what is off leaves no arithmetic behind."""

    damping: bool = False  # The rate decays at each step
    square_cells: bool = True  # Spacings along x and y are equal, which saves an operation in each Laplacian of order 2
    order: int = 2  # Order of the differences in space, 2 or 4
    # The moment form alone has these, see ``moment_form``
    terms: int = 2  # Terms of the load in time, see ``load``
    moments: bool = False  # Bending stiffness varies over the plate, or an edge is free or elastic
    material_damping: bool = False  # Stress follows the strain rate too (Kelvin–Voigt)
    tension: bool = False  # Constant membrane tension
    foundation: bool = False  # Elastic bed or elastic edges
    stretching: bool = False  # Tension that grows with the deflection (Berger)
    oscillators: bool = False  # Masses on springs
    moving_load: bool = False  # A load that travels over the plate

    @property
    def plain(self) -> bool:
        """True for a uniform plate with clamped or supported edges, which needs no moment form."""
        return self == KernelEffects(self.damping, self.square_cells, self.order)
