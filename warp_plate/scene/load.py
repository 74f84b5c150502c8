"""The TOML text of scenes, read from presets and files and written from tables; and the files that scenes name."""

import os
import re
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from warp_plate.scene.errors import SceneError, toml_text

# A scene is about a page long; a larger file is something else. Maps belong in files of their own.
SCENE_BYTES = 2**22
# Largest file that a scene may name.
FILE_BYTES = 2**27
# The TOML parser takes minutes for a dotted key of very many parts, so these are refused first, outside of texts and
# comments. What is not closed ends with its line or the file: whatever begins matches, which keeps the search linear.
_TEXT = re.compile(
    r""""{3}(?:[^\\]|\\.)*?(?:"{3,5}|\\?\Z)|"(?:[^"\\\n]|\\.)*"?""" r"""|'{3}.*?(?:'{3,5}|\Z)|'[^'\n]*'?|\#[^\n]*""",
    re.DOTALL,
)
_DEEP_KEY = re.compile(r"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){9}")
_PRESETS = resources.files("warp_plate.scene.presets")


def preset_names() -> list[str]:
    """Return the names of the scenes that come with the package."""
    return sorted(item.name[: -len(".toml")] for item in _PRESETS.iterdir() if item.name.endswith(".toml"))


def preset_text(name: str) -> str:
    """Return the TOML text of a preset, or raise a SceneError if no preset has this name."""
    if name not in preset_names():
        raise SceneError(f"{name!r} is not a preset; the presets are: {', '.join(preset_names())}")
    return (_PRESETS / f"{name}.toml").read_text(encoding="utf-8")


def read_scene_text(source: str | Path) -> tuple[str, Path | None]:
    """Return the text of a preset or a file, or raise a SceneError; with the folder of the file (None for a preset)."""
    name, path = str(source), Path(source)
    if name in preset_names():
        return preset_text(name), None
    try:
        if path.exists() and not path.is_file():
            raise SceneError(f"{name}: is a folder, a pipe or a device; scenes are read from files")
        if not path.is_file():
            hint = " (the name of a preset has no suffix)" if path.stem in preset_names() else ""
            raise SceneError(
                f"{name}: no such preset or file{hint}; presets: {', '.join(preset_names())}; "
                "'warp-plate init paper' writes one to a file for editing"
            )
        if path.stat().st_size > SCENE_BYTES:
            raise SceneError(f"{name}: {path.stat().st_size} bytes; a scene file has at most {SCENE_BYTES}")
        return path.read_text(encoding="utf-8-sig"), path.parent
    except OSError as error:
        raise SceneError(f"{name}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise SceneError(f"{name}: cannot be read as UTF-8 text: {error}") from None


def read_beside(key: str, name: str, folder: Path | None) -> bytes:
    """Return the content of a file in the scene's folder, None if the scene was not read from a file; ``key`` names it.

    Raises:
        SceneError: There is no folder, the file is not in it, or it is too large.
    """
    head = f"{key} = {name!r}"
    if folder is None:
        raise SceneError(f"{head}: this scene was not read from a file, so its folder is unknown; give one")
    try:
        path = Path(os.path.realpath(folder / name))
        if path.parent != folder.resolve():
            raise SceneError(f"{head}: leads out of the scene's folder; put a copy of the file there")
        if not path.is_file() and not path.is_symlink():  # one that leads to itself cannot be read
            raise SceneError(f"{head}: {'is no file' if path.exists() else 'no such file beside the scene file'}")
        if path.stat().st_size > FILE_BYTES:
            raise SceneError(f"{head}: {path.stat().st_size} bytes; at most {FILE_BYTES} are read")
        return path.read_bytes()
    except OSError as error:
        raise SceneError(f"{head}: cannot be read: {error.strerror}") from None


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML text, or raise a SceneError that begins with ``name``."""
    if _DEEP_KEY.search(_TEXT.sub("s", text)):
        raise SceneError(f"{name}: a key has ten parts or more; the tables of a scene have at most three")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise SceneError(f"{name}: arrays or tables are nested too deeply") from None
    except ValueError as error:  # invalid TOML, or an integer of thousands of digits
        raise SceneError(f"{name}: not TOML: {error}") from None


def dump_toml(tables: dict[str, Any]) -> str:
    """Return nested tables as TOML text; empty tuples are left out."""
    return "\n".join(_lines("", tables)) + "\n"


def _lines(name: str, table: dict[str, Any]) -> list[str]:
    """Return the lines of a table without its heading: its own keys first, then the tables inside it."""
    lines_here: list[str] = []
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
            lines_here.append(f"{key} = {toml_text(value)}")
    return lines_here + nested
