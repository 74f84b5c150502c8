"""Kinds of options that more than one command has."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated

import cyclopts


def _whole(kind: object, tokens: Sequence[cyclopts.Token]) -> int:
    """1.5 is no seed; what reads options would round it."""
    text = tokens[0].value
    if not re.fullmatch(r"[-+]?[0-9]{1,30}", text):
        raise ValueError(f"{text[:60]!r} is no whole number")
    return int(text)


Whole = Annotated[int, cyclopts.Parameter(converter=_whole)]
