"""The tables ``[grid]``, ``[window]`` and ``[record]``: how a run is discretised, timed and stored."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from warp_plate.scene.fields import Instant, Point, Positive, Table, Unit

# Relative error of a linear scene without ``[grid]``; for others, cells in a bending wave, and the cells of a side.
DEFAULT_ACCURACY = 0.01
CELLS_A_WAVE, FEWEST_CELLS, MOST_CELLS = 16.0, 12, 256


class Grid(Table):
    """The discretisation in space and time."""

    nodes: Annotated[
        tuple[Annotated[int, Field(ge=5, le=8193)], Annotated[int, Field(ge=5, le=8193)]], Field(examples=[[53, 33]])
    ] = (27, 27)
    """Nodes along x and y, edges included."""
    order: Annotated[Literal[2, 4], Field(examples=[4])] = 2
    """Spatial order of accuracy."""
    load: Annotated[Literal["overlap", "nodes", "moments"], Field(examples=["moments"])] = "overlap"
    """Weights of nodes in loads and regions: "overlap" of cells with the area, whole "nodes" inside it, or "moments",
    which keep its moments up to the third."""
    time_step: Annotated[Positive | None, Unit("s"), Field(examples=[1e-5])] = None
    """Time step (default: 0.9 of the stability limit, at most 1/20 of a period)."""
    precision: Annotated[Literal["float32", "float64"], Field(examples=["float64"])] = "float32"
    """Precision of the time steps."""
    modal_density: Annotated[float, Field(ge=0.25, le=4, examples=[1.5]), Unit("1")] = 1.0
    """Basis functions of the modal engine along each side, relative to the default; not used by time stepping."""
    accuracy: Annotated[Annotated[float, Field(ge=1e-4, le=0.5)] | None, Unit("1"), Field(examples=[0.01])] = None
    """Allowed relative error of localization factors; all keys above are chosen from it."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.order == 4 and min(self.nodes) < 9:
            raise ValueError(f"nodes: {list(self.nodes)} are too few for order = 4, which takes 9 or more a side")
        chosen = self.model_fields_set - {"accuracy"}
        if self.accuracy is not None and chosen:
            keys = ", ".join(sorted(chosen))
            raise ValueError(f"accuracy: {self.accuracy:g} chooses all other keys; delete it, or delete {keys}")
        return self


class Window(Table):
    """The interval of time over which kinetic energy is averaged."""

    start: Annotated[Instant, Field(examples=[0.05])] = 0.05
    """Start of the interval."""
    end: Annotated[Positive, Unit("s"), Field(examples=[0.1])] = 0.1
    """End of the interval and of the run."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.end <= self.start:
            raise ValueError(f"end: {self.end:g} s must be later than start = {self.start:g} s")
        return self


class Record(Table):
    """Outputs of a run besides energies."""

    times: Annotated[tuple[Instant, ...], Field(examples=[[0.05, 0.1]])] = ()
    """Times at which displacement fields are stored (default: the instant of the largest displacement in the last
    period, and a quarter period before it; for bursts, sweeps and other drives without a period, that in the run)."""
    points: Annotated[tuple[Point, ...], Field(examples=[[[0.1, 0.06]]])] = ()
    """Points (x, y) at which the displacement of every step is stored."""


def grid_by_waves(size: tuple[float, float], wavelength: float) -> Grid:
    """Return CELLS_A_WAVE cells in a bending wave [m], within limits, on a plate with these sides [m].

    Loads keep their moments, so that small patches beside an edge load nodes that can move.
    """
    cells = [min(max(math.ceil(CELLS_A_WAVE * side / wavelength), FEWEST_CELLS), MOST_CELLS) for side in size]
    return Grid(nodes=(cells[0] + 1, cells[1] + 1), load="moments")
