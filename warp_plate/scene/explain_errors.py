"""pydantic's faults as one line in the words of the file: key, value, what would be right."""

from __future__ import annotations

import datetime
import difflib
import re
import types
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError

Place = tuple[int | str, ...]
_LONGEST_LINE, _LONGEST_VALUE = 500, 60
# By pydantic's types of faults, what a value must be; with the numbers that pydantic gives.
_RIGHT = {
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    "int_parsing_size": "a whole number nearer to 0",
    "finite_number": "a finite number",
    "greater_than": "greater than {gt}",
    "greater_than_equal": "{ge} or more",
    "less_than": "less than {lt}",
    "less_than_equal": "{le} or less",
    "literal_error": "{expected}",
    "string_type": "a text in quotes",
    "string_too_short": "a text of {min_length} or more characters",
}
# Of which the annotation says what it must be.
_OF_THE_KIND = ("tuple_type", "too_short", "too_long", "model_type")
_NOUNS: dict[Any, str] = {float: "number", int: "whole number", str: "text"}


def explain_error(error: ValidationError, model: type[BaseModel]) -> str:
    """The first fault of a validation of this model as one line, and how many more there are."""
    faults = _faults_by_place(error)
    # Keys that do not exist come first: they are often the cause of the others ("is missing").
    place, fault = min(faults.items(), key=lambda one: one[1]["type"] != "extra_forbidden")
    line = _line(place, fault, model)
    line = line if len(line) <= _LONGEST_LINE else line[: _LONGEST_LINE - 3] + "..."
    return line + (f" (and {len(faults) - 1} more)" if len(faults) > 1 else "")


def _faults_by_place(error: ValidationError) -> dict[Place, Mapping[str, Any]]:
    """One for each place. A number that a list lacks is the list's fault, and what is wrong inside of something makes
    pydantic find fault with the whole too (a list of nothing that is right is empty), which says nothing more."""
    faults: dict[Place, Mapping[str, Any]] = {}
    for fault in error.errors():
        place = fault["loc"]
        if fault["type"] == "missing" and isinstance(place[-1], int):
            place, fault = place[:-1], {**fault, "type": "too_short"}
        faults.setdefault(place, fault)
    around = {place[:length] for place in faults for length in range(len(place))}
    return {place: fault for place, fault in faults.items() if place not in around}


def _line(place: Place, fault: Mapping[str, Any], model: type[BaseModel]) -> str:
    key, kind = _key_and_kind(place, model)
    if fault["type"] == "extra_forbidden":
        return f"{key}: unknown key{_suggestion(str(place[-1]), _key_and_kind(place[:-1], model)[1])}"
    if fault["type"] == "missing":
        return f"{key}: is missing; it has no default"
    if fault["type"] == "value_error":
        message = str(fault["ctx"]["error"])
        return f"{key}.{message}" if key else message
    context = {name: _number(value) for name, value in fault.get("ctx", {}).items()}
    if fault["type"] in _OF_THE_KIND:
        right = f"must be {_words(kind, key, context)}"
    elif fault["type"] in _RIGHT:
        right = f"must be {_RIGHT[fault['type']].format(**context)}"
    else:  # our own, see PydanticCustomError
        right = fault["msg"]
    return f"{key} = {_short(fault['input'])}: {right}"


def _key_and_kind(place: Place, model: type[BaseModel]) -> tuple[str, Any]:
    """The key of a fault's place as the file has it, and what it is annotated as (None: there is no such key)."""
    key, kind = "", _bare(model)
    for part in place:
        tagged = [one for one in get_args(kind) if Tag(str(part)) in getattr(one, "__metadata__", ())]
        if tagged:  # a kind of an edge or an array, which is no key
            kind = _bare(tagged[0])
            continue
        if isinstance(part, int):
            key += f"[{part}]"
            inside = get_args(kind)
            kind = _bare(inside[min(part, len(inside) - 1) if inside[-1] is not Ellipsis else 0]) if inside else None
        else:
            name = part if re.fullmatch(r"[\w-]+", part) else repr(part)
            key += f".{name}" if key else name
            field = kind.model_fields.get(part) if _is_table(kind) else None
            kind = _bare(field.annotation) if field else None
    return key, kind


def _bare(kind: Any) -> Any:
    """An annotation without what is said about it, and without None."""
    if get_origin(kind) is Annotated:
        return _bare(get_args(kind)[0])
    if get_origin(kind) in (Union, types.UnionType):
        some = [one for one in get_args(kind) if one is not types.NoneType]
        return _bare(some[0]) if len(some) == 1 else kind
    return kind


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _words(kind: Any, key: str, context: Mapping[str, str]) -> str:
    """What a key that holds a table or a list must be."""
    if _is_table(kind):
        return f"a table, [[{key.rpartition('[')[0]}]]" if key.endswith("]") else f"a table, [{key}]"
    inside = get_args(kind)
    amount = "" if inside[-1] is Ellipsis else str(len(inside))
    if not amount and context.get("field_type"):
        amount = f"at least {context['min_length']}" if "min_length" in context else f"at most {context['max_length']}"
    item, ending = _bare(inside[0]), ""
    if _is_table(item):
        noun, ending = "table", f", [[{key}]]"
    elif get_origin(item) is tuple:
        noun, ending = "point", " [x, y]"
    else:
        noun = _NOUNS.get(item, "value")
    several = "" if amount.split(" ")[-1] == "1" else "s"
    return f"a list of {amount}{' ' if amount else ''}{noun}{several}{ending}"


def _suggestion(name: str, table: Any) -> str:
    """'; did you mean ...' or the keys that the table knows."""
    known = list(table.model_fields) if _is_table(table) else []
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; known here: {', '.join(known)}" if known else ""


def _short(value: object) -> str:
    try:
        text = _shown(value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits, or as many tables in each other
        return "what is too large to be shown"
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def _shown(value: object) -> str:
    """A value as TOML has it, or nearly so."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {_shown(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return "[" + ", ".join(_shown(item) for item in value) + "]"
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return repr(value)


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
