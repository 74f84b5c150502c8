"""What every table of the scene file has in common."""

from __future__ import annotations

import re
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
