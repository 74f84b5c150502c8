"""The catalogue of hard cases (docs/hard-cases.md): every case keeps to its bound, and all figures are committed.

Paths and precisions take turns over the cases; ``benchmarks/hard_cases`` measures all of them on all.
"""

import json
from pathlib import Path

import pytest
from hard_cases.case import Where
from hard_cases.catalogue import CASES

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=case.name, marks=[pytest.mark.slow] if case.slow else []) for case in CASES]
)
def test_case(case, pairs):
    turn = CASES.index(case)
    for device in {device for device, _ in pairs}:
        paths = [path for name, path in pairs if name == device]
        precision = ("float64", "float32")[turn // 2 % 2]
        found = case.measure(Where(device, paths[turn % len(paths)], precision))
        print(case.quantity, found.value)
        assert found.value <= case.allowed[precision]


def test_the_catalogue_is_the_page():
    """Every case has a row in the page, and committed figures that are within its bound."""
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    page = (ROOT / "docs" / "hard-cases.md").read_text(encoding="utf-8")
    assert not [name for name in names if f"| {name} |" not in page]
    for file in (ROOT / "benchmarks" / "results").glob("hard-cases-*.json"):
        rows = {row["name"]: row for row in json.loads(file.read_text(encoding="utf-8"))["cases"]}
        assert set(rows) == set(names)
        assert all(row["kept"] for row in rows.values())
