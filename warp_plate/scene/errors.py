"""The one kind of error that bad input raises, and how texts from files are shown."""

from __future__ import annotations

import unicodedata


class SceneError(ValueError):
    """Bad input: one line that names the key or file at fault, its value and what would be right."""

    def __init__(self, message: str) -> None:
        super().__init__(printable(" ".join(line.strip() for line in message.splitlines())))


def printable(text: str) -> str:
    """The text with whatever would move the cursor, colour the terminal or turn the reading direction written out.

    Escape sequences and the like become what a Python literal has for them, ``\\x1b``; line ends stay.
    """
    return "".join(one if _harmless(one) else ascii(one)[1:-1] for one in text)


def _harmless(letter: str) -> bool:
    return letter.isprintable() or letter == "\n" or unicodedata.category(letter) == "Zs"
