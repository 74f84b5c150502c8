"""Write a scene as TOML text."""

from __future__ import annotations

from typing import Any

from warp_plate.scene.model import Scene


def dump_scene(scene: Scene) -> str:
    """Return the scene, defaults included, as TOML text that reads back to an equal scene."""
    data = scene.model_dump(exclude_none=True)
    if scene.grid.accuracy is not None:
        data["grid"] = {"accuracy": scene.grid.accuracy}
    if scene.targets and scene.target == scene.targets[0].unnamed:
        del data["target"]
    lines = [f"title = {_toml(data.pop('title'))}"]
    lists = {key: data.pop(key) for key in ("targets", "actuators")}
    for name, table in data.items():
        lines += _table_lines(name, table)
    for name, rows in lists.items():
        for row in rows:
            lines += ["", f"[[{name}]]", *_assignments(row)]
    return "\n".join(lines) + "\n"


def _table_lines(name: str, table: dict[str, Any]) -> list[str]:
    """Return the lines of a table: its own keys first, then the tables inside it."""
    plain: dict[str, Any] = {}
    nested: list[str] = []
    for key, value in table.items():
        if isinstance(value, dict):
            nested += _table_lines(f"{name}.{key}", value)
        elif isinstance(value, list | tuple) and value and all(isinstance(item, dict) for item in value):
            for row in value:
                nested += ["", f"[[{name}.{key}]]", *_assignments(row)]
        elif value != ():
            plain[key] = value
    return (["", f"[{name}]", *_assignments(plain)] if plain or not nested else []) + nested


def _assignments(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = "".join(
            f"\\u{ord(c):04x}" if ord(c) < 0x20 or ord(c) == 0x7F else "\\" + c if c in '"\\' else c for c in value
        )
        return f'"{escaped}"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return repr(value)
