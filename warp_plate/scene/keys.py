"""The numbers of a scene by their dotted keys, such as ``plate.thickness`` or ``actuators[0].phase``: found, changed,
with unit and words."""

from __future__ import annotations

import difflib
import re
import types
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Tables of which there may be several with names, by which their keys may be written too.
NAMED = ("actuators", "targets")
# By the last words of a key without indices; the longest that fits holds. What is not here has no unit, "1"; a
# magnitude has the drive's.
UNITS = {
    **dict.fromkeys(("size", "thickness", "area", "disc", "polygon", "points", "start", "place"), "m"),
    **dict.fromkeys(("time", "end", "duration", "ramp", "period", "delay", "delay.range"), "s"),
    **dict.fromkeys(("time_step", "times", "from_time", "to_time", "window.start", "burst.start"), "s"),
    **dict.fromkeys(("frequency", "end_frequency", "frequency.range"), "Hz"),
    **dict.fromkeys(("variation.thickness", "variation.young_modulus", "variation.density"), "1"),
    **dict.fromkeys(("robust.thickness", "robust.young_modulus", "robust.damping"), "1"),
    **dict.fromkeys(("Dx", "Dy", "D1", "Dxy"), "N·m"),
    **dict.fromkeys(("tension.x", "tension.y"), "N/m"),
    "young_modulus": "Pa",
    "density": "kg/m³",
    "translation": "N/m²",
    "rotation": "N·m/(rad·m)",
    "signal.rate": "1/s",
    "electrostatic.bias": "V",
    "electrostatic.gain": "N/(m²·V²)",
    "viscous": "N·s/m³",
    "foundation.stiffness": "N/m³",
    "foundation.damping": "N·s/m³",
    "oscillators.mass": "kg",
    "oscillators.stiffness": "N/m",
    "oscillators.damping": "N·s/m",
    "force": "N",
    "velocity": "m/s",
    "phase": "rad",
    "magnitude": "drive",
    "magnitude.range": "drive",
    "power": "(drive)²",
    "objectives.rest_limit": "m/s or m",
}
# What stands for an index, by the name that it follows.
PLACES = {
    **dict.fromkeys(("size", "nodes", "velocity", "start"), ("x", "y")),
    "area": ("x0", "x1", "y0", "y1"),
    "disc": ("x", "y", "radius"),
    "range": ("smallest", "largest"),
}
_PART = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")


def numeric_keys(scene: Scene) -> dict[str, type]:
    """Every key of a scene's tables that holds one number, or may and is left out, with int or float.

    Of several targets, ``target`` is one: its keys are those of ``targets``.
    """
    return {key: kind for key, kind in _numbers(scene, "") if not (scene.targets and key.startswith("target."))}


def resolved_key(scene: Scene, key: str) -> str:
    """The key with indices in the place of names: ``actuators[0].phase`` for ``actuators.lower left.phase``.

    Raises:
        SceneError: the scene has no such key, or it holds no number; names those near it.
    """
    known, asked = numeric_keys(scene), key.strip()
    for table in NAMED:
        rows = [(row.name, index) for index, row in enumerate(getattr(scene, table))]
        for name, index in sorted(rows, key=lambda row: -len(row[0])):
            if asked.startswith(f"{table}.{name}."):
                asked = f"{table}[{index}].{asked[len(table) + len(name) + 2 :]}"
                break
    if asked in known:
        return asked
    raise SceneError(f"{key}: {_what_is_near(scene, asked, list(known))}")


def with_numbers(scene: Scene, numbers: Mapping[str, float]) -> Scene:
    """The scene with other numbers at some of ``numeric_keys``, checked again; whole ones where such are kept.

    ``grid.accuracy`` takes the place of the grid's other keys.

    Raises:
        SceneError: the numbers make no scene; one line that names the key at fault.
    """
    given, whole = scene.model_dump(exclude_unset=True), scene.model_dump()
    if scene.targets:
        given.pop("target", None)
    if "grid.accuracy" in numbers:
        given["grid"] = {}
    kinds = numeric_keys(scene)
    for key, value in numbers.items():
        given = _with(given, whole, _parts(key), kinds[key](value))
    return Scene.from_tables(given).in_folder(scene.folder)


def unit_of(scene: Scene, key: str) -> str:
    """Of the number at one of ``numeric_keys``; "1" where it has none."""
    names = [part for part in _parts(key) if isinstance(part, str)]
    endings = (".".join(names[index:]) for index in range(len(names)))
    return UNITS.get(next((one for one in endings if one in UNITS), ""), "1").replace("drive", scene.drive_unit)


def label_of(scene: Scene, key: str) -> str:
    """The key in words, for axes: "actuator lower left phase"."""
    words: list[str] = []
    parts = _parts(key)
    for before, part in zip([None, *parts], parts, strict=False):
        if isinstance(part, str):
            words.append(part.replace("_", " "))
        elif before in NAMED:
            words[-1] = f"{words[-1].removesuffix('s')} {getattr(scene, str(before))[part].name}"
        else:
            words.append(PLACES[before][part] if isinstance(before, str) and before in PLACES else str(part))
    return " ".join(words[1:] if words[0] == "effects" else words)


def _numbers(value: object, at: str) -> Iterator[tuple[str, type]]:
    if isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            inner, key = getattr(value, name), f"{at}.{name}" if at else name
            kind = _number_kind(field.annotation) if inner is None else None
            if kind is not None:
                yield key, kind
            else:
                yield from _numbers(inner, key)
    elif isinstance(value, tuple):
        for index, inner in enumerate(value):
            yield from _numbers(inner, f"{at}[{index}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield at, type(value)


def _number_kind(annotation: Any) -> type | None:
    """int or float, where that is what a key that may be left out holds."""
    if annotation in (int, float):
        return annotation
    if get_origin(annotation) is Annotated:
        return _number_kind(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return next((kind for kind in map(_number_kind, get_args(annotation)) if kind), None)
    return None


def _parts(key: str) -> list[str | int]:
    return [name or int(index) for name, index in _PART.findall(key)]


def _with(given: Any, whole: Any, parts: list[str | int], value: float) -> Any:
    """A copy of tables with one number changed; ``whole``: the same tables with what they leave out."""
    first, *rest = parts
    made: Any = dict(given) if isinstance(whole, dict) else list(given)
    if rest:
        inside = whole[first]
        held = made.get(first, inside) if isinstance(made, dict) else made[first]
        value = _with(held, inside, rest, value)
    made[first] = value
    return made


def _what_is_near(scene: Scene, key: str, known: list[str]) -> str:
    """For people: why there is no such key, and those that may be meant."""
    below = [one for one in known if one.startswith((f"{key}.", f"{key}["))]
    if below:
        return f"is no single number; write {_listed(below)}"
    absent = _absent(scene, key)
    if absent:
        return f"the scene has no {absent} into the scene file to vary what is in it"
    close = set(difflib.get_close_matches(key, known, n=4, cutoff=0.6))
    near = [one for one in known if one in close]
    head, tail = re.split(r"[.\[]", key)[0], re.split(r"[.\]]", key)[-1]
    beside = [one for one in known if one.startswith((f"{head}.", f"{head}["))]
    same = [one for one in known if tail and one.endswith(f".{tail}")]
    return f"is no key of this scene that holds a number; near it: {_listed(near or same or beside or known)}"


def _absent(scene: Scene, key: str) -> str | None:
    """The table or list that the key names and the scene leaves out, and what to write; None where that is not why it
    is unknown."""
    value: Any = scene
    parts = _parts(key)
    for index, part in enumerate(parts[:-1]):
        if not isinstance(part, str) or not isinstance(value, BaseModel) or part not in type(value).model_fields:
            return None
        value, name = getattr(value, part), ".".join(str(one) for one in parts[: index + 1])
        if value is None:
            return f"[{name}]; write that table"
        if value == ():
            tables = any(isinstance(one, str) for one in parts[index + 1 :])
            return f"[[{name}]]; write such tables" if tables else f"{name}, which is a list; write it"
    return None


def _listed(keys: list[str]) -> str:
    return ", ".join(keys[:6]) + (", ..." if len(keys) > 6 else "")
