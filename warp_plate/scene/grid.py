"""The table ``[grid]``, and what holds for a scene without it."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from warp_plate.scene.fields import Positive, Table

# Relative error of a linear scene without ``[grid]``; for others, cells in a bending wave, and the cells of a side.
DEFAULT_ACCURACY = 0.01
CELLS_A_WAVE, FEWEST_CELLS, MOST_CELLS = 16.0, 12, 256


class Grid(Table):
    """The discretisation in space and time."""

    # Nodes along x and y, edges included
    nodes: tuple[Annotated[int, Field(ge=5, le=8193)], Annotated[int, Field(ge=5, le=8193)]] = (27, 27)
    order: Literal[2, 4] = 2  # spatial order of accuracy
    # Weights of nodes in loads and regions: "overlap" of cells with the area, whole "nodes" inside it, or "moments",
    # which keep its moments up to the third
    load: Literal["overlap", "nodes", "moments"] = "overlap"
    time_step: Positive | None = None  # time step [s] (default: 0.9 of the stability limit, at most 1/20 of a period)
    precision: Literal["float32", "float64"] = "float32"  # precision of the time steps
    # Basis functions of the modal engine along each side, relative to the default; not used by time stepping [1]
    modal_density: Annotated[float, Field(ge=0.25, le=4)] = 1.0
    # Allowed relative error of localization factors; all keys above are chosen from it [1]
    accuracy: Annotated[float, Field(ge=1e-4, le=0.5)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Grid:
        if self.order == 4 and min(self.nodes) < 9:
            raise ValueError(f"nodes: {list(self.nodes)} are too few for order = 4, which takes 9 or more a side")
        chosen = self.model_fields_set - {"accuracy"}
        if self.accuracy is not None and chosen:
            keys = ", ".join(sorted(chosen))
            raise ValueError(f"accuracy: {self.accuracy:g} chooses all other keys; delete it, or delete {keys}")
        return self


def grid_by_waves(size: tuple[float, float], wavelength: float) -> Grid:
    """Return CELLS_A_WAVE cells in a bending wave [m], within limits, on a plate with these sides [m]."""
    cells = [min(max(math.ceil(CELLS_A_WAVE * side / wavelength), FEWEST_CELLS), MOST_CELLS) for side in size]
    return Grid(nodes=(cells[0] + 1, cells[1] + 1))
