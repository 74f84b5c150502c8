"""The compile key: what the kernels are specialised for."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Effects:
    """One compiled kernel a value of this; a field that is off leaves no arithmetic behind.

    damping: the rate decays by ``Parameters.decay`` a step.
    square_cells: equal spacing along x and y, which saves an operation in each Laplacian of second order.
    order: of the differences in space, 2 or 4.
    """

    damping: bool = False
    square_cells: bool = True
    order: int = 2
