"""Values set from outside a scene file: ``KEY=VALUE`` put into its tables before they are checked."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import ALTERNATIVES, NAMED
from warp_plate.scene.load import parse_toml

# Keys of which a target has one.
SHAPES = ("area", "disc", "polygon", "mask")
_KEY = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*|\[\d{1,9}\])*")
_PART = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")


def assign(tables: dict[str, Any], assignments: Iterable[str]) -> None:
    """Put values into the tables of a scene, one ``KEY=VALUE`` after the other; new tables are made as needed.

    VALUE is TOML, such as 300, [0.1, 0.2] or {eta = 0.02}; anything else is a text. A key that excludes another one
    replaces it: ``grid.accuracy`` the rest of the grid, ``force`` ``magnitude``, and each shape of a target the others.

    Raises:
        SceneError: it is not KEY=VALUE, or the key does not lead into the tables.
    """
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        key = _without_names(tables, name.strip())
        if not equals or not _KEY.fullmatch(key):
            raise SceneError(f"--set {assignment}: must be KEY=VALUE, such as drive.frequency=300")
        *path, last = [name or int(index) for name, index in _PART.findall(key)]
        holder: Any = tables
        for depth, part in enumerate(path):
            holder = _entered(holder, part, {} if isinstance(last, str) or depth < len(path) - 1 else [], assignment)
        _put(holder, last, _value(text.strip()), assignment)
        for other in _excluded(path, last, holder):
            holder.pop(other, None)


def _without_names(tables: dict[str, Any], key: str) -> str:
    """Return the key with the indices of named rows: ``actuators[0].phase`` for ``actuators.lower left.phase``."""
    for table in NAMED:
        rows = tables.get(table)
        for index, row in enumerate(rows if isinstance(rows, list) else []):
            head = f"{table}.{row.get('name') if isinstance(row, dict) else ''}."
            if key.startswith(head):
                return f"{table}[{index}].{key[len(head) :]}"
    return key


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}", "")["value"] if "\n" not in text else text
    except SceneError:
        return text


def _entered(holder: Any, part: str | int, empty: dict[str, Any] | list[Any], assignment: str) -> Any:
    """Return what a table or list holds, by default a new table."""
    if isinstance(part, str) and isinstance(holder, dict):
        return holder.setdefault(part, empty)
    _check_index(holder, part, assignment)
    return holder[part]


def _put(holder: Any, part: str | int, value: Any, assignment: str) -> None:
    if not (isinstance(part, str) and isinstance(holder, dict)):
        _check_index(holder, part, assignment)
    holder[part] = value


def _check_index(holder: Any, part: str | int, assignment: str) -> None:
    if isinstance(holder, list) and isinstance(part, int) and part < len(holder):
        return
    held = (
        f"a list of {len(holder)}" if isinstance(holder, list) else "no list" if isinstance(part, int) else "no table"
    )
    raise SceneError(
        f"--set {assignment}: the scene file has {held} before {f'[{part}]' if held[0] == 'a' else part!r}"
    )


def _excluded(path: list[str | int], last: str | int, holder: Any) -> list[str]:
    """Return the keys beside ``last`` that a scene cannot have together with it."""
    if path == ["grid"]:
        return [key for key in holder if key != "accuracy"] if last == "accuracy" else ["accuracy"]
    if path[:1] == ["actuators"] and last in ALTERNATIVES:
        return [ALTERNATIVES[str(last)]]
    if path[:1] in (["target"], ["targets"]) and last in SHAPES:
        return [shape for shape in SHAPES if shape != last]
    return []
