"""Write a scene as TOML text."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from warp_plate.scene.errors import toml_text

if TYPE_CHECKING:
    from warp_plate.scene.model import Scene


def dump_scene(scene: Scene) -> str:
    """Return the scene, defaults included, as TOML text that reads back to an equal scene."""
    data = scene.model_dump(exclude_none=True)
    if scene.grid.accuracy is not None:
        data["grid"] = {"accuracy": scene.grid.accuracy}
    if scene.targets and scene.target == scene.targets[0].unnamed:
        del data["target"]
    data |= {key: data.pop(key) for key in ("targets", "actuators", "measurement")}  # at the end
    return "\n".join(_lines("", data)) + "\n"


def _lines(name: str, table: dict[str, Any]) -> list[str]:
    """Return the lines of a table without its heading: its own keys first, then the tables inside it."""
    own: list[str] = []
    nested: list[str] = []
    for key, value in table.items():
        key = key if re.fullmatch(r"[\w-]+", key, re.ASCII) else toml_text(key)
        path = f"{name}.{key}" if name else key
        if isinstance(value, dict):
            lines = _lines(path, value)
            heading = ["", f"[{path}]"] if not lines or lines[0] else []  # not over tables alone
            nested += heading + lines
        elif isinstance(value, tuple) and value and isinstance(value[0], dict):
            for row in value:
                nested += ["", f"[[{path}]]", *_lines(path, row)]
        elif value != ():
            own.append(f"{key} = {toml_text(value)}")
    return own + nested
