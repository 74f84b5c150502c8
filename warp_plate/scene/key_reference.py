"""The keys of scene files, by table, with type, unit, default, range, example and meaning: for help and the docs."""

import inspect
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, get_args

from warp_plate.scene.errors import toml_text
from warp_plate.scene.fields import LARGEST, Table, explain_key, shown_unit
from warp_plate.scene.measured import MeasuredScene
from warp_plate.scene.model import Scene

BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}


@dataclass(frozen=True)
class Key:
    """A key of a table, as texts."""

    name: str  # in its table
    type: str  # type of the value in words, or the possible values
    unit: str  # SI unit; empty for numbers without a unit
    default: str  # as TOML, "required", or empty where the default is to leave it out
    range: str  # limits of the numbers
    example: str  # as TOML
    meaning: str


@dataclass(frozen=True)
class TableReference:
    """A table of scene files."""

    headings: tuple[str, ...]  # such as "[plate]" and "[[actuators]]"; "Top level" for the first
    model: type[Table]
    description: str  # docstring of the model
    keys: tuple[Key, ...]  # those that hold no table


def table_references() -> list[TableReference]:
    """Return all tables, in the order of the scene's fields, then those of scenes of measured responses alone."""
    models, references = _subclasses(Table), []
    seen = {MeasuredScene.__name__}
    for scene in (Scene, MeasuredScene):
        schema = scene.model_json_schema()
        headings: dict[str, list[str]] = {}
        _collect(schema, "", scene.__name__, False, headings)
        own = {name: tuple(paths) for name, paths in headings.items() if name not in seen}
        references += [_reference(models[name], paths, _definition(schema, name)) for name, paths in own.items()]
        seen |= set(own)
    return references


def _definition(schema: dict[str, Any], name: str) -> dict[str, Any]:
    definition: dict[str, Any] = schema if name == schema["title"] else schema["$defs"][name]
    return definition


def _collect(schema: dict[str, Any], path: str, name: str, repeated: bool, headings: dict[str, list[str]]) -> None:
    """Add the heading of a table of the schema, and those of all tables in it."""
    headings.setdefault(name, []).append(f"[[{path}]]" if repeated else f"[{path}]" if path else "Top level")
    for key, field in _definition(schema, name)["properties"].items():
        inner = [field, field.get("items", {}), *field.get("anyOf", []), *field.get("oneOf", [])]
        for table in (entry["$ref"].rpartition("/")[2] for entry in inner if "$ref" in entry):
            _collect(schema, f"{path}.{key}".strip("."), table, "items" in field, headings)
        by_name = field.get("additionalProperties")
        if isinstance(by_name, dict) and "$ref" in by_name:
            _collect(schema, f"{path}.{key}.NAME".strip("."), by_name["$ref"].rpartition("/")[2], False, headings)


def _subclasses(model: type[Table]) -> dict[str, type[Table]]:
    """Return a model and all its subclasses by their names."""
    models = {model.__name__: model}
    for subclass in model.__subclasses__():
        models |= _subclasses(subclass)
    return models


def _reference(model: type[Table], headings: tuple[str, ...], definition: dict[str, Any]) -> TableReference:
    keys = []
    for name, field in definition["properties"].items():
        if (headings[0].startswith("[") or name == "title") and ("$ref" not in str(field) or "enum" in str(field)):
            keys.append(_key(model, name, field))
    description = re.sub(r":\w+:`([^`]+)`", r"`\1`", inspect.cleandoc(vars(model)["__doc__"] or "").replace("``", "`"))
    return TableReference(headings, model, description, tuple(keys))


def _key(model: type[Table], name: str, field: dict[str, Any]) -> Key:
    info, default = model.model_fields[name], field.get("default")
    meaning, unit, examples = explain_key(model, name)
    return Key(
        name=name,
        type=_type(field),
        unit="" if unit in (None, "1") else shown_unit(unit),
        default="required" if info.is_required() else "" if default is None else f"`{toml_text(default)}`",
        range=_range(info.annotation, info.metadata),
        example=f"`{toml_text(examples[0])}`" if examples else "",
        meaning=meaning.removesuffix(".").replace("``", "`"),
    )


def _type(field: dict[str, Any]) -> str:
    """Return the type of a field of the schema in words."""
    if "enum" in field or "const" in field:
        return ", ".join(f"`{toml_text(value)}`" for value in field.get("enum", [field.get("const")]))
    if "anyOf" in field or "oneOf" in field:
        options = field.get("anyOf") or field.get("oneOf", [])
        return " or ".join(_type(option) for option in options if option.get("type") != "null")
    if "$ref" in field:
        return "table"
    if "prefixItems" in field:
        return f"{len(field['prefixItems'])} {_plural(_type(field['prefixItems'][0]))}"
    if field.get("type") == "array":
        return f"list of {_plural(_type(field['items']))}"
    if field.get("type") == "object":
        inner = field.get("additionalProperties") or next(iter(field["patternProperties"].values()))
        return f"table of {_type(inner)} by key"
    words: dict[str, str] = {"boolean": "true or false", "string": "text"}
    return words.get(field["type"], field["type"])


def _plural(words: str) -> str:
    if words.startswith("list of"):
        return words.replace("list", "lists", 1)
    return f"lists of {words}" if words[0].isdigit() else f"{words}s"


def _range(annotation: Any, metadata: Sequence[Any] = ()) -> str:
    """Return the limits of the numbers of an annotation, or of the first type in it that has any."""
    for part in (annotation, *get_args(annotation)):
        metadata = [*metadata, *getattr(part, "metadata", []), *getattr(part, "__metadata__", [])]
    flat = [inner for item in metadata for inner in getattr(item, "metadata", [item])]
    limits = [(sign, getattr(item, name)) for item in flat for name, sign in BOUNDS.items() if hasattr(item, name)]
    text = ", ".join(dict.fromkeys(f"{sign} {value:g}" for sign, value in limits if abs(value) < LARGEST))
    return text or next((inner for part in get_args(annotation) if (inner := _range(part))), "")
