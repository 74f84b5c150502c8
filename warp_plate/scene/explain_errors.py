"""Validation errors of pydantic as one line in terms of the scene file: key, value, and what would be valid."""

import difflib
import re
import types
from collections.abc import Mapping
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError

from warp_plate.scene.errors import toml_text

Location = tuple[int | str, ...]
_LONGEST_LINE, _LONGEST_VALUE = 500, 60
# The requirement by pydantic's error type; braces hold fields of the error's context.
_REQUIREMENTS = {
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    "int_parsing_size": "a whole number nearer to 0",
    "finite_number": "a finite number",
    "greater_than": "greater than {gt}",
    "greater_than_equal": "{ge} or more",
    "less_than": "less than {lt}",
    "less_than_equal": "{le} or less",
    "dict_type": "a table",
    "literal_error": "{expected}",
    "string_type": "a text in quotes",
    "string_pattern_mismatch": "the number of a mode, from 1 to 999",
    "string_too_short": "a text of {min_length} or more characters",
}
# Error types for which the requirement follows from the annotation of the field.
_SHAPE_ERRORS = ("tuple_type", "too_short", "too_long", "model_type")
# What a plate cannot have.
_OUTLINE = re.compile("corner|radius|outline|disc|diameter|shape|polygon|points|mask|hole")
_NOUNS: dict[Any, str] = {float: "numbers", int: "whole numbers", str: "texts"}


def explain_error(error: ValidationError, model: type[BaseModel]) -> str:
    """Return the first error of a validation of ``model`` as one line, with the number of further errors."""
    errors = _errors_by_location(error)
    for location in [location for location, details in errors.items() if details["type"] == "extra_forbidden"]:
        meant = (*location[:-1], _closest(str(location[-1]), _key_and_annotation(location[:-1], model)[1]))
        if errors.get(meant, {}).get("type") == "missing":  # follows from the misspelt key
            del errors[meant]
    # Unknown keys come first, because they are often the cause of others ("is missing").
    location, first = min(errors.items(), key=lambda item: item[1]["type"] != "extra_forbidden")
    line = _line(location, first, model)
    line = line if len(line) <= _LONGEST_LINE else line[: _LONGEST_LINE - 3] + "..."
    return line + (f" (and {len(errors) - 1} more)" if len(errors) > 1 else "")


def _errors_by_location(error: ValidationError) -> dict[Location, Mapping[str, Any]]:
    """Return one error for each location, without those that only follow from errors further inside."""
    errors: dict[Location, Mapping[str, Any]] = {}
    for details in error.errors():
        location = details["loc"]
        if location[-1:] == ("[key]",):  # of a table of any keys, which pydantic names here
            location = location[:-1]
        if details["type"] == "missing" and isinstance(location[-1], int):  # the list is too short
            location, details = location[:-1], {**details, "type": "too_short"}
        errors.setdefault(location, details)
    enclosing = {location[:length] for location in errors for length in range(len(location))}
    return {location: details for location, details in errors.items() if location not in enclosing}


def _line(location: Location, error: Mapping[str, Any], model: type[BaseModel]) -> str:
    key, annotation = _key_and_annotation(location, model)
    table = _key_and_annotation(location[:-1], model)[1]
    if error["type"] == "extra_forbidden":
        return f"{key}: unknown key{suggestion(str(location[-1]), table)}"
    if error["type"] == "missing":
        examples = table.model_fields[str(location[-1])].examples if is_table(table) else None
        shown = f", write for example {toml_text(examples[0])}" if examples else ""
        return f"{key}: is missing; it has no default{shown}"
    if error["type"] == "value_error":
        message = str(error["ctx"]["error"])
        return f"{key}.{message}" if key else message
    context = {
        name: f"{value:g}" if isinstance(value, float) else str(value) for name, value in error.get("ctx", {}).items()
    }
    if error["type"] in _SHAPE_ERRORS:
        requirement = f"must be {_required_shape(annotation, key, context)}"
    elif error["type"] in _REQUIREMENTS:
        requirement = f"must be {_REQUIREMENTS[error['type']].format(**context)}"
    else:  # a PydanticCustomError of the tables
        requirement = error["msg"]
    return f"{key} = {_shown(error['input'])}: {requirement}"


def _key_and_annotation(location: Location, model: type[BaseModel]) -> tuple[str, Any]:
    """Return the dotted key of a location and the annotation of its field (None if there is no such field)."""
    key, annotation = "", _bare(model)
    for part in location:
        tagged = [option for option in get_args(annotation) if Tag(str(part)) in getattr(option, "__metadata__", ())]
        if tagged:  # the tag of a discriminated union is not a key
            annotation = _bare(tagged[0])
        elif isinstance(part, int):
            key += f"[{part}]"
            items = get_args(annotation)
            annotation = _bare(items[min(part, len(items) - 1) if items[-1] is not Ellipsis else 0]) if items else None
        else:
            name = part if re.fullmatch(r"[\w-]+", part) else repr(part)
            key += f".{name}" if key else name
            field = annotation.model_fields.get(part) if is_table(annotation) else None
            ranges = get_args(annotation)[1] if get_origin(annotation) is dict else None
            annotation = _bare(field.annotation if field else ranges)
    return key, annotation


def _bare(annotation: Any) -> Any:
    """Return an annotation without its metadata and without None."""
    if get_origin(annotation) is Annotated:
        return _bare(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        options = [option for option in get_args(annotation) if option is not types.NoneType]
        return _bare(options[0]) if len(options) == 1 else annotation
    return annotation


def is_table(annotation: Any) -> bool:
    """Return whether an annotation is that of a table."""
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _required_shape(annotation: Any, key: str, context: Mapping[str, str]) -> str:
    """Describe the table or list that a key must hold."""
    if is_table(annotation):
        return f"a table, [[{key.rpartition('[')[0]}]]" if key.endswith("]") else f"a table, [{key}]"
    *_, last = items = get_args(annotation)
    item = _bare(items[0])
    if last is not Ellipsis:
        count = f"{len(items)} "
    elif "min_length" in context:
        count = f"{context['min_length']} or more "
    else:
        count = f"{context['max_length']} or fewer " if "max_length" in context else ""
    if is_table(item):
        return f"a list of {count}tables, [[{key}]]"
    return f"a list of {count}{'points [x, y]' if get_origin(item) is tuple else _NOUNS.get(item, 'values')}"


def suggestion(name: str, table: Any) -> str:
    """Return what follows "unknown key": names of keys of the table that may have been meant."""
    if is_table(table) and table.__name__ == "Plate" and _OUTLINE.search(name):
        return "; write size = [length along x, length along y] (metres), or another shape in [plate.outline]"
    if close := _closest(name, table):
        return f"; did you mean {close!r}?"
    return f"; known here: {', '.join(table.model_fields)}" if is_table(table) else ""


def _closest(name: str, table: Any) -> str:
    """Return the key of a table that a name resembles, or ""."""
    close = difflib.get_close_matches(name, list(table.model_fields) if is_table(table) else [], n=1)
    return close[0] if close else ""


def _shown(value: object) -> str:
    """Return a value as TOML text, shortened to fit a line."""
    try:
        text = toml_text(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, or as many nested tables
        return "a value too large to show"
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."
