"""What every table of the scene file has in common."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

# Far beyond any panel on both sides, and so near to one that fourth powers and products of several are still numbers.
SMALLEST, LARGEST = 1e-30, 1e30


class Table(BaseModel):
    """A table of the scene file: unknown keys are refused, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _moderate(value: float) -> float:
    if value and not SMALLEST <= abs(value) <= LARGEST:
        raise PydanticCustomError("moderate", f"its size should be 0 or from {SMALLEST:g} to {LARGEST:g}")
    return value


def _not_zero(value: float) -> float:
    if value == 0:
        raise PydanticCustomError("not_zero", "must not be 0, which leaves nothing of the drive")
    return value


Moderate = Annotated[float, AfterValidator(_moderate)]
Gain = Annotated[Moderate, AfterValidator(_not_zero)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_moderate)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_moderate)]
# What nothing is divided by may be as small as it likes.
Coordinate = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Instant = Annotated[float, Field(ge=0, le=LARGEST)]
Area = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
# HDF5 cannot keep a text with a NUL in it.
Text = Annotated[str, Field(pattern=r"^[^\x00]*$")]
Name = Annotated[Text, Field(min_length=1)]


# A name, not a way: no folders, no drive letters, no line breaks.
_NAME = re.compile(r"[^/\\:\x00-\x1f\x7f]+")


def check_file_name(key: str, name: str, endings: tuple[str, ...]) -> None:
    """Raise ValueError, naming ``key``, unless this is a name without folders and with one of these endings."""
    if not _NAME.fullmatch(name) or not name.lower().endswith(endings) or name.lower() in endings:
        shown = name if len(name) <= 60 else name[:57] + "..."
        raise ValueError(
            f"{key}: {shown!r} is not the name of a {' or '.join(endings)} file; it lies beside the scene file, and is "
            "written without folders"
        )
