"""The numbers and texts of a scene by dotted keys such as ``plate.thickness``, ``actuators[0].phase`` or
``edges.left``: lookup, units, labels and replacement."""

from __future__ import annotations

import difflib
import operator
import re
from collections.abc import Iterator, Mapping
from functools import reduce
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from pydantic import BaseModel

from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.scene.model import Scene

# Lists of named tables; a key may have the name in place of the index.
NAMED = ("actuators", "targets")
# Units by the end of a key without indices; the longest end that fits holds, and keys without one have the unit "1".
# "drive" stands for the unit of the actuators' magnitudes.
UNITS = {
    **dict.fromkeys(("size", "thickness", "area", "clearance", "disc", "polygon", "points", "start", "place"), "m"),
    **dict.fromkeys(("point", "force_at"), "m"),
    **dict.fromkeys(("time", "end", "duration", "ramp", "period", "delay", "delay.range"), "s"),
    **dict.fromkeys(
        ("time_step", "times", "from_time", "to_time", "segment", "window.start", "burst.start", "signal.start"), "s"
    ),
    **dict.fromkeys(("frequency", "end_frequency", "frequency.range", "fit.range", "lowest", "highest"), "Hz"),
    **dict.fromkeys(("variation.thickness", "variation.young_modulus", "variation.density"), "1"),
    **dict.fromkeys(("robust.thickness", "robust.young_modulus", "robust.damping"), "1"),
    **dict.fromkeys(("Dx", "Dy", "D1", "Dxy"), "N·m"),
    **dict.fromkeys(("tension.x", "tension.y"), "N/m"),
    "young_modulus": "Pa",
    "density": "kg/m³",
    "d31": "m/V",
    "capacitance": "F",
    "translation": "N/m²",
    "rotation": "N·m/(rad·m)",
    **dict.fromkeys(("signal.rate", "focus.rate", "wish.rate"), "1/s"),
    "electrostatic.bias": "V",
    "electrostatic.gain": "N/(m²·V²)",
    "viscous": "N·s/m³",
    "foundation.stiffness": "N/m³",
    "foundation.damping": "N·s/m³",
    "oscillators.mass": "kg",
    "oscillators.stiffness": "N/m",
    "oscillators.damping": "N·s/m",
    "wish.start": "s",
    "force": "N",
    "velocity": "m/s",
    "phase": "rad",
    "magnitude": "drive",
    "magnitude.range": "drive",
    "power": "(drive)²",
    "objectives.rest_limit": "m/s or m",
    "signals.force_gain": "1/N",
    "focus.rest.radius": "m",
    "focus.rest.contrast": "dB",
    "focus.peak": "drive",
    "focus.energy": "(drive)²·s",
}
# Names of the indices that follow a name.
INDEX_NAMES = {
    **dict.fromkeys(("size", "nodes", "velocity", "start", "point", "force_at"), ("x", "y")),
    "area": ("x0", "x1", "y0", "y1"),
    "disc": ("x", "y", "radius"),
    "range": ("smallest", "largest"),
}
# Keys of an actuator that exclude each other.
ALTERNATIVES = {"magnitude": "force", "force": "magnitude"}
_PART = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")


def scalar_keys(scene: Scene) -> dict[str, type]:
    """Return the type, int, float or str, of every key that holds one number or text or is optional and would hold one.

    Of several targets, ``target`` is one, so its keys are left out.
    """
    return {key: kind for key, kind in _numbers_in(scene, "") if not (scene.targets and key.startswith("target."))}


def resolved_key(scene: Scene, key: str, known: Mapping[str, type] | None = None) -> str:
    """Return the key with names replaced by indices: ``actuators[0].phase`` for ``actuators.lower left.phase``.

    Args:
        scene: Scene.
        key: Key.
        known: Its ``scalar_keys``, if these are at hand.

    Raises:
        SceneError: the scene has no such key, or it holds no number or text; the message suggests similar keys.
    """
    known, resolved = scalar_keys(scene) if known is None else known, key.strip()
    for table in NAMED:
        names = [(row.name, index) for index, row in enumerate(getattr(scene, table))]
        for name, index in sorted(names, key=lambda item: -len(item[0])):  # a name may begin with another
            if resolved.startswith(f"{table}.{name}."):
                resolved = f"{table}[{index}].{resolved[len(table) + len(name) + 2 :]}"
                break
    if resolved in known:
        return resolved
    raise SceneError(f"{key}: {_why_unknown(scene, resolved, list(known))}")


def with_values(scene: Scene, values: Mapping[str, float | str]) -> Scene:
    """Return the scene, checked again, with other values at some of ``scalar_keys``; integers where these are kept.

    ``grid.accuracy`` replaces the other keys of the grid, the force of an actuator its magnitude and the other way
    round.

    Raises:
        SceneError: the values are not valid; the message names the key at fault.
    """
    tables: Any = scene.model_dump(mode="json")
    if scene.targets:
        del tables["target"]
    if scene.gridded_by_waves and not any(key.startswith("grid.") for key in values):
        del tables["grid"]
    elif scene.grid.accuracy is not None or "grid.accuracy" in values:
        changed = {"accuracy", *(_parts(key)[1] for key in values if key.startswith("grid."))}
        tables["grid"] = {key: value for key, value in tables["grid"].items() if key in changed}
    kinds = scalar_keys(scene)
    places = {key: (reduce(operator.getitem, path, tables), last) for key in values for *path, last in [_parts(key)]}
    for key, (table, last) in places.items():
        if key.startswith("actuators") and last in ALTERNATIVES:
            table.pop(ALTERNATIVES[last], None)
    for key, (table, last) in places.items():
        value = values[key]
        whole = kinds[key] is int and isinstance(value, float) and value.is_integer()
        table[last] = int(value) if whole else value
    return scene.from_tables(tables).in_folder(scene.folder)


def value_of(scene: Scene, key: str) -> Any:
    """Return the value at one of ``scalar_keys``; None if it is optional and absent."""
    value: Any = scene
    for part in _parts(key):
        value = value[part] if isinstance(part, int) else getattr(value, part)
    return value


def unit_of(scene: Scene, key: str) -> str:
    """Return the unit of the number at one of ``scalar_keys``; "1" if it has none."""
    names = [part for part in _parts(key) if isinstance(part, str)]
    ends = (".".join(names[index:]) for index in range(len(names)))
    return UNITS.get(next((end for end in ends if end in UNITS), ""), "1").replace("drive", scene.drive_unit)


def label_of(scene: Scene, key: str) -> str:
    """Return the key as an axis label: "actuator lower left phase"."""
    words: list[str] = []
    parts = _parts(key)
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


def _parts(key: str) -> list[str | int]:
    return [name or int(index) for name, index in _PART.findall(key)]


def _why_unknown(scene: Scene, key: str, known: list[str]) -> str:
    inside = [other for other in known if other.startswith((f"{key}.", f"{key}["))]
    if inside:
        return f"is not a single value; write {_listed(inside)}"
    optional = _optional_table(scene, key)
    if optional:
        return f"the scene has no {optional}; write it in the scene file to vary what is in it"
    close = difflib.get_close_matches(key, known, n=4)
    head, tail = re.split(r"[.\[]", key)[0], re.split(r"[.\]]", key)[-1]
    similar = (
        sorted(close, key=known.index)
        or [other for other in known if tail and other.endswith(f".{tail}")]
        or [other for other in known if other.startswith((f"{head}.", f"{head}["))]
        or known
    )
    return f"is not a key of this scene that holds a number or a text; similar keys: {_listed(similar)}"


def _optional_table(scene: Scene, key: str) -> str | None:
    """Return the optional table or list that a key lies in and the scene lacks; None if there is none."""
    value: Any = scene
    names = [str(part) for part in _parts(key)[:-1]]
    for depth, name in enumerate(names, 1):
        if not isinstance(value, BaseModel) or name not in type(value).model_fields:
            return None
        value = getattr(value, name)
        if value in (None, ()):
            return ".".join(names[:depth])
    return None


def _listed(keys: list[str]) -> str:
    return ", ".join(keys[:6]) + (", ..." if len(keys) > 6 else "")
