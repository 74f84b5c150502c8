"""The exception for invalid input, and text for messages and files: escaped, or as TOML."""

import datetime
import json
import math
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral
from typing import Any, cast

# Characters of an error; files from others may have as many names as they like.
LONGEST = 10_000
# Largest magnitude of a number, as in scenes.
MOST = 1e30


class SceneError(ValueError):
    """Invalid input: one line that names the key or file at fault, its value and what would be valid."""

    def __init__(self, message: str) -> None:
        line = printable(" ".join(line.strip() for line in message.splitlines()))
        super().__init__(line if len(line) <= LONGEST else f"{line[:LONGEST]} ...")


@contextmanager
def under(head: str) -> Iterator[None]:
    """Begin errors with the key or file, if one is given, whose value led to what they name; or a decorator."""
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{head}: {error}" if head else str(error)) from None


def check_type(key: str, value: object, *kinds: type) -> None:
    """Raise a SceneError that names the argument ``key`` unless its value is of one of the kinds."""
    if not isinstance(value, kinds):
        names = " or ".join(kind.__name__.removesuffix("Type") for kind in kinds)
        raise SceneError(f"{key}: must be a {names}, not a {type(value).__name__}")


def check_function(key: str, value: object) -> None:
    """Raise a SceneError that names the argument ``key`` unless its value is a function or None."""
    if value is not None and not callable(value):
        raise SceneError(f"{key}: must be a function or None, not a {type(value).__name__}")


def check_whole(key: str, value: object, highest: float = math.inf) -> None:
    """Raise a SceneError that names the argument ``key`` unless its value is a whole number from 1 to ``highest``."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not 1 <= int(value) <= highest:
        end = "on" if highest == math.inf else f"to {highest:g}"
        raise SceneError(f"{key} = {value!r}: must be a whole number from 1 {end}")


def numbers_of(key: str, value: object, count: int, what: str) -> list[float]:
    """Return so many numbers of a sequence, finite ones; a SceneError names the argument ``key`` and says ``what`` it
    must be."""
    try:
        items = [] if isinstance(value, str | bytes | Mapping) else list(cast(Any, value))
        numbers = [float(item) for item in items if not isinstance(item, str | bytes | bool)]
    except (TypeError, ValueError, OverflowError):
        numbers = []
    if len(numbers) != count or not all(abs(number) <= MOST for number in numbers):
        raise SceneError(f"{key} = {value!r}: must be {what}")
    return numbers


def plain_number(text: str) -> float:
    """Return the number that a text holds; ValueError: it is none, or has underscores or digits other than 0 to 9,
    which float() takes."""
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


def printable(text: str) -> str:
    """Return the text with control characters escaped as in a Python literal (``\\x1b``); line ends stay."""
    return "".join(
        c if c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs" else ascii(c)[1:-1] for c in text
    )


def printable_line(text: str) -> str:
    """Return the text as one line, with control characters and line ends escaped."""
    return printable(text).replace("\n", "\\n")


def toml_comment(*lines: str) -> str:
    """Return texts as the lines of a comment in TOML."""
    return "".join(f"# {printable_line(line)}\n" for line in lines)


def number_text(value: object, digits: str, unit: str = "") -> str:
    """Format a number; "none" if it is missing or not finite."""
    missing = value is None or (isinstance(value, float) and not math.isfinite(value))
    return "none" if missing else f"{value:{digits}}{unit}"


def toml_text(value: object) -> str:
    """Return a value as TOML, tables inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {toml_text(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_text, value)) + "]"
    if isinstance(value, float) and float(short := f"{value:g}") == value and "e" in short:
        return short  # 7.2e+10, not 72000000000.0
    return value.isoformat() if isinstance(value, datetime.date | datetime.time) else repr(value)
