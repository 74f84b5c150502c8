"""The compile key: what the kernels are specialised for."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Effects:
    """One compiled kernel a value of this; a field that is off leaves no arithmetic behind.

    damping: the rate decays by ``Parameters.decay`` a step.
    square_cells: equal spacing along x and y, which saves an operation in each Laplacian of second order.
    order: of the differences in space, 2 or 4.

    The rest is for the general paths alone (see ``general``). terms: of the load in time (see ``load``); moments:
    bending varies over the plate, or an edge is free or elastic; material_damping, tension, foundation (elastic edges
    too), stretching, oscillators, moving_load.
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
        """Whether the paths of the uniform plate with clamped and supported edges can take it."""
        return self == Effects(self.damping, self.square_cells, self.order)
