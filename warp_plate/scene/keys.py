"""Dotted keys of a scene such as ``plate.thickness``, ``actuators[0].phase`` or ``edges.left``.

They name numbers and texts of a scene, with units and labels, and in ``KEY=VALUE`` what is put into its tables before
these are checked.
"""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from warp_plate.scene.errors import SceneError, check_type
from warp_plate.scene.fields import shown_unit, unit_in
from warp_plate.scene.load import parse_toml
from warp_plate.scene.tables import SceneTables
from warp_plate.scene.target import PlateRegion, Target

# Lists of named tables; a key may have the name in place of the index.
NAMED = ("actuators", "targets")
# Names of the indices that follow a name.
INDEX_NAMES = {
    **dict.fromkeys(("size", "nodes", "velocity", "start", "point", "force_at"), ("x", "y")),
    "area": ("x0", "x1", "y0", "y1"),
    "disc": ("x", "y", "radius"),
    "range": ("smallest", "largest"),
}
# Tables with properties of the panel, which a fit may change; keys of actuators there that searches change, too.
PANEL = ("plate.", "edges.", "supports[", "effects.", "actuators[", "measurement[")
# Keys of an actuator that exclude each other.
ALTERNATIVES = {"magnitude": "force", "force": "magnitude", "voltage": "current", "current": "voltage"}
DRIVEN = (*PlateRegion.model_fields, *ALTERNATIVES, "phase", "frequency", "delay")
FREE = "fit.free."  # start of a key of [fit.free], whose rest is itself a key
_PART = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")
_KEY = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*|\[\d{1,9}\])*")


def scalar_keys(scene: SceneTables) -> dict[str, type]:
    """Return the type, int, float or str, of every key that holds one number or text or is optional and would hold one.

    The names of ``[links]`` are keys, too. Of several targets, ``target`` is one, and an outline sets the size,
    so that their keys are left out.
    """
    derived = ("target.",) * bool(scene.targets) + ("plate.size",) * (scene.plate.outline is not None)
    kinds = {key: kind for key, kind in _numbers_in(scene, "") if not key.startswith(derived)}
    linked = {name: kinds.get(linked_keys(scene, name)[0]) for name in scene.links}
    return kinds | {name: kind for name, kind in linked.items() if kind is not None}


def linked_keys(scene: SceneTables, key: str) -> list[str]:
    """Return the keys of a link by its name; of any other key, the key alone."""
    names = {table: [row.name for row in getattr(scene, table)] for table in NAMED}
    return [_without_names(names, inner) for inner in scene.links[key].keys] if key in scene.links else [key]


def check_links(scene: SceneTables) -> None:
    """Raise ValueError, naming the link, unless every link has keys that hold the same number."""
    kinds = {key: kind for key, kind in scalar_keys(scene).items() if key not in scene.links}
    for name in scene.links:
        head = f"links.{name}"
        if not re.fullmatch(r"[A-Za-z_]\w*", name) or name in type(scene).model_fields:
            raise ValueError(f"{head}: write a name of letters, digits and _ that is no table of a scene")
        for key in linked_keys(scene, name):
            if kinds.get(key) not in (int, float):
                raise ValueError(f"{head}.keys: {key}: is not a key of this scene that holds a number")
            if not key.startswith(PANEL) or (key.startswith("actuators[") and key_parts(key)[2] in DRIVEN):
                raise ValueError(f"{head}.keys: {key}: is no property of the panel, as of plate, edges or effects")
        values = {key: value_of(scene, key) for key in linked_keys(scene, name)}
        if len(set(values.values())) > 1:
            shown = ", ".join(f"{key} = {value}" for key, value in values.items())
            raise ValueError(f"{head}.keys: hold different numbers, {shown}; write the same in all of them")


def resolved_key(scene: SceneTables, key: str, kinds: Mapping[str, type] | None = None) -> str:
    """Return the key with names replaced by indices: ``actuators[0].phase`` for ``actuators.lower left.phase``.

    ``kinds`` are the ``scalar_keys`` of the scene, if these are at hand.

    Raises:
        SceneError: the scene has no such key, or it holds no number or text; the message suggests similar keys.
    """
    kinds = scalar_keys(scene) if kinds is None else kinds
    resolved = _without_names({table: [row.name for row in getattr(scene, table)] for table in NAMED}, key.strip())
    if resolved in kinds:
        return resolved
    if inside := [other for other in kinds if other.startswith((f"{resolved}.", f"{resolved}["))]:
        raise SceneError(f"{key}: is not a single value; write {_listed(inside)}")
    similar = sorted(difflib.get_close_matches(resolved, kinds, n=4), key=list(kinds).index) or list(kinds)
    what = "is not a key of this scene that holds a number or a text"
    raise SceneError(f"{key}: {what}; similar keys: {_listed(similar)}")


def value_of(scene: SceneTables, key: str) -> Any:
    """Return the value at one of ``scalar_keys``; None if it is optional and absent."""
    value: Any = scene
    for part in key_parts(linked_keys(scene, key)[0]):
        value = value[part] if isinstance(part, int) else getattr(value, part)
    return value


def unit_of(scene: SceneTables, key: str) -> str:
    """Return the unit of the number at one of ``scalar_keys``; "1" if it has none."""
    holder: Any = scene
    unit: str | None = None
    for part in key_parts(linked_keys(scene, key)[0]):
        if isinstance(part, str):
            field = type(holder).model_fields[part]
            unit = unit_in(field.annotation, field.metadata)
        holder = holder[part] if isinstance(part, int) else getattr(holder, part)
    return shown_unit(unit or "1", scene.drive_unit)


def label_of(scene: SceneTables, key: str) -> str:
    """Return the key as an axis label: "actuator lower left phase"."""
    words: list[str] = []
    parts = key_parts(key)
    for before, part in zip([None, *parts], parts, strict=False):
        if isinstance(part, str):
            words.append(part.replace("_", " "))
        elif before in NAMED:
            words[-1] = f"{words[-1].removesuffix('s')} {getattr(scene, str(before))[part].name}"
        else:
            words.append(INDEX_NAMES[before][part] if isinstance(before, str) and before in INDEX_NAMES else str(part))
    return " ".join(words[1:] if words[0] == "effects" else words)


def _numbers_in(value: object, key: str, annotation: Any = None) -> Iterator[tuple[str, type]]:
    if isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield from _numbers_in(getattr(value, name), f"{key}.{name}" if key else name, field.annotation)
    elif isinstance(value, tuple):
        for index, inner in enumerate(value):
            yield from _numbers_in(inner, f"{key}[{index}]")
    elif isinstance(value, int | float | str) and not isinstance(value, bool):
        yield key, type(value)
    elif value is None:  # the first of X | None, which may be Annotated
        kind = get_args(annotation)[0]
        kind = getattr(kind, "__origin__", kind)
        if get_origin(kind) is Literal:
            kind = str
        if kind in (int, float, str):
            yield key, kind


def key_parts(key: str) -> list[str | int]:
    """Return the names and indices of a dotted key."""
    return [name or int(index) for name, index in _PART.findall(key)]


def _listed(keys: list[str]) -> str:
    return ", ".join(keys[:6]) + (", ..." if len(keys) > 6 else "")


def assign(tables: dict[str, Any], assignments: Iterable[str]) -> None:
    """Put values into the tables of a scene, one ``KEY=VALUE`` after the other; see :func:`put`.

    VALUE is TOML, such as 300, [0.1, 0.2] or {eta = 0.02}; anything else is a text.

    Raises:
        SceneError: it is not KEY=VALUE, or the key does not lead into the tables.
    """
    check_type("assignments", assignments, list, tuple)
    for index, assignment in enumerate(assignments):
        check_type(f"assignments[{index}]", assignment, str)
        key, equals, text = assignment.partition("=")
        if not equals or not key.strip():
            raise SceneError(f"--set {assignment}: must be KEY=VALUE, such as drive.frequency=300")
        put(tables, key, _value(text.strip()), f"--set {assignment}")


def put(tables: dict[str, Any], key: str, value: Any, shown: str) -> None:
    """Put a value into the tables of a scene; new tables are made as needed.

    A key that excludes another one replaces it: ``grid.accuracy`` the rest of the grid, ``force`` ``magnitude``, and
    each shape of a target the others.

    Raises:
        SceneError: the key does not lead into the tables; the message begins with ``shown``.
    """
    check_type("key", key, str)
    if key.strip().startswith(FREE):  # a table of keys
        free = _entered(_entered(tables, "fit", {}, shown), "free", {}, shown)
        if not isinstance(free, dict):
            raise SceneError(f"{shown}: fit.free is no table")
        free[key.strip().removeprefix(FREE).strip("\"'")] = value
        return
    rows = {table: tables[table] for table in NAMED if isinstance(tables.get(table), list)}
    names = {table: [str(row.get("name")) if isinstance(row, dict) else "" for row in rows[table]] for table in rows}
    key = _without_names(names, key.strip())
    if not _KEY.fullmatch(key):
        raise SceneError(f"{shown}: must have a key such as drive.frequency or actuators[0].area")
    links = tables.get("links")
    if isinstance(links, dict) and isinstance(links.get(key), dict):
        inner = links[key].get("keys")
        for other in inner if isinstance(inner, list) else []:
            if other not in links:  # a link of links is refused once the scene is whole
                put(tables, str(other), value, shown)
        return
    *path, last = key_parts(key)
    holder: Any = tables
    for depth, part in enumerate(path):
        holder = _entered(holder, part, {} if isinstance(last, str) or depth < len(path) - 1 else [], shown)
    if not (isinstance(last, str) and isinstance(holder, dict)):
        _check_index(holder, last, shown)
    holder[last] = value
    for other in _excluded(path, last, holder):
        holder.pop(other, None)


def _without_names(names: Mapping[str, list[str]], key: str) -> str:
    """Return the key with indices in place of names: ``actuators[0].phase`` for ``actuators.lower left.phase``."""
    for table, rows in names.items():
        for index, name in sorted(enumerate(rows), key=lambda row: -len(row[1])):  # a name may begin with another
            if key.startswith(head := f"{table}.{name}."):
                return f"{table}[{index}].{key[len(head) :]}"
    return key


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}", "")["value"] if "\n" not in text else text
    except SceneError:
        return text


def _entered(holder: Any, part: str | int, empty: dict[str, Any] | list[Any], shown: str) -> Any:
    """Return what a table or list holds, by default a new table."""
    if isinstance(part, str) and isinstance(holder, dict):
        return holder.setdefault(part, empty)
    _check_index(holder, part, shown)
    return holder[part]


def _check_index(holder: Any, part: str | int, shown: str) -> None:
    """Raise SceneError unless a part of a key is an index into a list."""
    if isinstance(holder, list) and isinstance(part, int) and part < len(holder):
        return
    held, at = "no list" if isinstance(part, int) else "no table", repr(part)
    if isinstance(holder, list) and isinstance(part, int):
        held, at = f"a list of {len(holder)}", f"[{part}]"
    elif isinstance(holder, list):
        names = [str(row["name"]) for row in holder if isinstance(row, dict) and "name" in row]
        held = f"a list of {', '.join(names) or len(holder)}"
    raise SceneError(f"{shown}: the scene has {held} before {at}")


def _excluded(path: list[str | int], last: str | int, holder: Any) -> list[str]:
    """Return the keys beside ``last`` that a scene cannot have together with it."""
    if path == ["grid"]:
        return [key for key in holder if key != "accuracy"] if last == "accuracy" else ["accuracy"]
    if path[:1] == ["actuators"] and last in ALTERNATIVES:
        return [ALTERNATIVES[str(last)]]
    if path[:1] in (["target"], ["targets"], ["actuators"], ["effects"]) and last in Target.shapes:
        return [shape for shape in Target.shapes if shape != last]
    return []
