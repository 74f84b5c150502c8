"""What every table of the scene file has in common."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class Table(BaseModel):
    """A table of the scene file: unknown keys are refused, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
# Far beyond any panel, and small enough that products of three of them are still numbers.
Moderate = Annotated[float, Field(ge=-1e30, le=1e30)]
Area = tuple[float, float, float, float]
# HDF5 cannot keep a text with a NUL in it.
Text = Annotated[str, Field(pattern=r"^[^\x00]*$")]
Name = Annotated[Text, Field(min_length=1)]
