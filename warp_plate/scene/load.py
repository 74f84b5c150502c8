"""From a preset's name or a TOML file to a checked scene, and back to TOML."""

from __future__ import annotations

import re
import sys
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from warp_plate.scene.errors import SceneError
from warp_plate.scene.faults import explain
from warp_plate.scene.model import Grid, Scene

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# A scene is a page; what is larger is another file. Keys of more parts than any table has take the TOML parser minutes.
MOST_BYTES = 2**24
_TEXT = re.compile(r"""\"{3}.*?\"{3}|'{3}.*?'{3}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|\#[^\n]*""", re.DOTALL)
_DEEP_KEY = re.compile(r"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){9}")
_PRESETS = resources.files("warp_plate.scene.presets")


def preset_names() -> list[str]:
    """The names that ``Scene.load`` knows without a file."""
    return sorted(item.name[: -len(".toml")] for item in _PRESETS.iterdir() if item.name.endswith(".toml"))


def preset_text(name: str) -> str:
    """The TOML of a preset, comments included.

    Raises:
        SceneError: no preset has this name.
    """
    if name not in preset_names():
        raise SceneError(f"{name!r} is no preset; there are: {', '.join(preset_names())}")
    return (_PRESETS / f"{name}.toml").read_text(encoding="utf-8")


def load_scene(source: str | Path) -> Scene:
    """See :meth:`warp_plate.scene.Scene.load`."""
    text = str(source)
    if text in preset_names():
        return parse_scene(preset_text(text), text)
    path = Path(source)
    try:
        if not path.is_file():
            hint = " (a preset's name has no ending)" if path.stem in preset_names() else ""
            raise SceneError(
                f"{text}: no such preset or file{hint}; presets: {', '.join(preset_names())}; "
                "'warp-plate init paper' writes one as a file to edit"
            )
        if path.stat().st_size > MOST_BYTES:
            raise SceneError(f"{text}: {path.stat().st_size} bytes; a scene has at most {MOST_BYTES}")
        content = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{text}: cannot be read as UTF-8 text: {error}") from None
    return parse_scene(content, text).in_folder(path.parent)


def parse_scene(text: str, name: str) -> Scene:
    """The scene in a TOML text; ``name`` stands at the head of an error's line.

    Raises:
        SceneError: not TOML, or a key that is unknown or wrong.
    """
    if _DEEP_KEY.search(_TEXT.sub("s", text)):
        raise SceneError(f"{name}: a key of ten parts or more; the scene's tables have at most three")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise SceneError(f"{name}: arrays or tables inside each other, too many of them") from None
    except ValueError as error:  # a wrong TOML, or a whole number of thousands of digits
        raise SceneError(f"{name}: not TOML: {error}") from None
    try:
        return checked_scene(data)
    except SceneError as error:
        raise SceneError(f"{name}: {error}") from None


def checked_scene(tables: dict[str, Any]) -> Scene:
    """The scene of tables by their names.

    Raises:
        SceneError: a key is unknown or wrong.
    """
    try:
        return Scene.model_validate(tables)
    except ValidationError as error:
        raise SceneError(explain(error, Scene)) from None


def with_accuracy(scene: Scene, accuracy: float) -> Scene:
    """The scene with an accuracy asked for instead of its grid.

    Raises:
        SceneError: an accuracy out of range.
    """
    try:
        return scene.model_copy(update={"grid": Grid(accuracy=accuracy)})
    except ValidationError as error:
        raise SceneError(f"grid.{explain(error, Grid)}") from None


def dump_scene(scene: Scene) -> str:
    """The resolved scene as TOML text that reads back to an equal scene."""
    data = scene.model_dump(exclude_none=True)
    if scene.grid.accuracy is not None:
        data["grid"] = {"accuracy": scene.grid.accuracy}
    several = {key: data.pop(key) for key in ("targets", "actuators")}
    if scene.targets and scene.target == scene.targets[0].unnamed:
        del data["target"]
    lines = [f"title = {_toml(data.pop('title'))}"]
    for table, keys in data.items():
        lines += _table_lines(table, keys)
    for table, rows in several.items():
        for row in rows:
            lines += ["", f"[[{table}]]", *(f"{key} = {_toml(value)}" for key, value in row.items())]
    return "\n".join(lines) + "\n"


def _table_lines(name: str, keys: dict[str, Any]) -> list[str]:
    plain = [
        f"{key} = {_toml(value)}"
        for key, value in keys.items()
        if not isinstance(value, dict) and not _is_tables(value) and value != ()
    ]
    nested = [
        line
        for key, value in keys.items()
        if isinstance(value, dict)
        for line in _table_lines(f"{name}.{key}", value)
    ]
    for key, value in keys.items():
        if _is_tables(value):
            for item in value:
                nested += ["", f"[[{name}.{key}]]", *(f"{inner} = {_toml(one)}" for inner, one in item.items())]
    return (["", f"[{name}]", *plain] if plain or not nested else []) + nested


def _is_tables(value: object) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(item, dict) for item in value)


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
