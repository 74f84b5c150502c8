"""The exception for invalid input, and the escaping of text from files."""

from __future__ import annotations

import unicodedata


class SceneError(ValueError):
    """Invalid input: one line that names the key or file at fault, its value and what would be valid."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(" ".join(line.strip() for line in message.splitlines())))


def printable(text: str) -> str:
    """Return the text with control characters escaped as in a Python literal (``\\x1b``); line ends stay."""
    return "".join(
        c if c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs" else ascii(c)[1:-1] for c in text
    )
