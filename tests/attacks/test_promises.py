"""Each sentence of three pages names the tests that fail where it is false, or promises nothing; see promises.toml."""

import re
import tomllib
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
PROMISES = tomllib.loads(Path(__file__).with_name("promises.toml").read_text(encoding="utf-8"))
# Parts of pages that hold figures which were measured or estimated, and of whose sentences only some are in the list.
FIGURES = ("## Cost of communication", "## Estimate: a thousand GPUs")


def sentences_of(page):
    """Return the sentences and cells of tables of a page, each on one line, without headings and code."""
    bare = re.sub(r"^```.*?^```|^#.*?$|^ {4}.*?$|^\|[-| ]+\|$|\*\*", "", page, flags=re.M | re.S)
    parts = [" ".join(part.split()) for part in re.split(r"\n\s*\n|\n(?=- |\|)", bare)]
    return [text for part in parts for text in re.split(r"(?<=[.?]) (?=[A-Z`\[0-9])", part) if text]


@pytest.mark.parametrize("name", PROMISES)
def test_every_sentence_is_tested_or_promises_nothing(name):
    page = (TESTS.parent / "docs" / name).read_text(encoding="utf-8")
    sentences = sentences_of(page)
    places = {words: [at for at, text in enumerate(sentences) if words in text] for words in PROMISES[name]}
    assert not {words: at for words, at in places.items() if len(at) != 1}  # gone, or in several sentences
    for part in re.split(r"\n(?=## )", page):
        if not part.startswith(FIGURES):
            assert not [text for text in sentences_of(part) if not any(words in text for words in places)]


def test_tests_of_promises_exist():
    for promises in PROMISES.values():
        for test in (test for tests in promises.values() if tests != "NONE" for test in tests):
            file, function = test.split("::")
            assert f"\ndef {function}(" in (TESTS / file).read_text(encoding="utf-8"), test
