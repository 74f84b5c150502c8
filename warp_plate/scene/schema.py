"""Descriptions and examples of the scene's keys, for its JSON schema and the reference."""

from __future__ import annotations

import inspect
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

FIELD = re.compile(r"    (\w+): [^#\n]*(?:\"[^\"]*\"[^#\n]*)*(?:# (.*))?")


def field_comments(table: type) -> dict[str, str]:
    """Return the comment of each field of a class, on its line or on those above it, by name; units are in brackets."""
    found: dict[str, str] = {}
    for each in reversed(table.__mro__[: table.__mro__.index(object)]):
        if not each.__module__.startswith("warp_plate."):
            continue
        above: list[str] = []
        for line in inspect.getsource(each).splitlines():
            if line.startswith("    # "):
                above.append(line[6:])
                continue
            if match := FIELD.fullmatch(line):
                found[match[1]] = match[2] or " ".join(above) or found.get(match[1], "")
            above = []
    return found


def field_examples(table: type) -> dict[str, Any]:
    """Return an example of the value of each key of a table that holds no table, by name."""
    known = _examples()
    return {key: value for each in reversed(table.__mro__) for key, value in known.get(each.__name__, {}).items()}


@cache
def _examples() -> dict[str, dict[str, Any]]:
    return tomllib.loads(Path(__file__).with_name("key_examples.toml").read_text(encoding="utf-8"))
