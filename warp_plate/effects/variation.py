"""Maps of thickness, Young's modulus and density over the plate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from warp_plate.effects.effect import Effect, Setting
from warp_plate.scene.fields import Unit, check_file_name

LEAST_FACTOR, MOST_FACTOR = 1e-3, 1e3  # larger variations are mistakes, or make the time step vanish


def _rows(value: object) -> object:
    if not isinstance(value, list | tuple) or not value or not all(isinstance(row, list | tuple) for row in value):
        raise PydanticCustomError("rows", "must be a list of rows such as [[1.0, 1.0]], or the name of a file")
    return value


Factor = Annotated[float, Field(ge=LEAST_FACTOR, le=MOST_FACTOR)]
FactorRow = Annotated[tuple[Factor, ...], Field(min_length=1)]
FactorRows = Annotated[tuple[FactorRow, ...], Field(min_length=1), BeforeValidator(_rows)]
FactorMap = Annotated[
    Annotated[str, Tag("word")] | Annotated[FactorRows, Tag("rows")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "rows"),
]


class Variation(Effect):
    """Thickness, Young's modulus and density that vary over the plate, as factors on those of ``[plate]``.

    Each is an array, or the name of a CSV file beside the scene file with one: rows along y, columns along x, evenly
    spaced from edge to edge, with bilinear interpolation. A single row holds for all y, a single column for all x.
    Columns are separated by commas, semicolons or tabs, with decimal points. An array finer than the grid is sampled
    at its nodes, not averaged. Layers lie on the local thickness; ``[effects.orthotropic]`` is multiplied as well.
    """

    thickness: Annotated[FactorMap | None, Unit("1"), Field(examples=[[[1.0, 0.8]]])] = None
    """Factor on the thickness."""
    young_modulus: Annotated[FactorMap | None, Unit("1"), Field(examples=[[[1.0, 1.1], [0.9, 1.0]]])] = None
    """Factor on Young's modulus."""
    density: Annotated[FactorMap | None, Unit("1"), Field(examples=["density.csv"])] = None
    """Factor on the density."""

    in_kernels = False

    @model_validator(mode="after")
    def _consistent(self) -> Variation:
        named = dict(self.maps)
        if not named:
            raise ValueError("thickness: no array is given; write one, or one of young_modulus and density")
        for key, value in named.items():
            if isinstance(value, str):
                check_file_name(key, value, (".csv",))
            elif any(len(row) != len(value[0]) for row in value):
                raise ValueError(f"{key}: its rows differ in length; write the same number of factors in each")
        return self

    @property
    def maps(self) -> Iterator[tuple[str, Any]]:
        """The maps that are given, by key: rows of factors, or the name of a file."""
        return ((key, value) for key, value in self if value is not None)

    @property
    def section_keys(self) -> tuple[str, ...]:
        return tuple(key for key, _ in self.maps)

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(thickness=((0.95, 1.05),)), "thickness from 0.95 at x = 0 to 1.05"
