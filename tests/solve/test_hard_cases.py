"""The catalogue of hard cases (docs/hard-cases.md): every case keeps to what is asked of it, on every path and in both
precisions, the slow tests with as many steps as the catalogue asks for; the figures of all are committed."""

import json
from pathlib import Path

import pytest
from hard_cases import energies, odd
from hard_cases.case import Where
from hard_cases.catalogue import CASES

from warp_plate.solve import status

ROOT = Path(__file__).parents[2]
PRECISIONS = ("float32", "float64")
# Cases that take more steps there; not those on the finest grids, which take minutes.
IN_FULL = [
    case
    for case in CASES
    if case.group in ("The stability limit", "Energy", "Inside the plate")
    and not case.name.startswith(("1.01", "rounding on 257", "rounding on 513"))
]


def marked():
    """Every case, the slow ones marked."""
    return [pytest.param(case, id=case.name, marks=[pytest.mark.slow] if case.slow else []) for case in CASES]


@pytest.mark.parametrize("precision", [pytest.param("float32", marks=pytest.mark.slow), "float64"])
@pytest.mark.parametrize("case", marked())
def test_case(case, precision, device, path):
    found = case.measure(Where(device, path, precision))
    print(case.quantity, found.value)
    assert found.value <= case.allowed[precision]


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("case", IN_FULL, ids=lambda case: case.name)
def test_case_in_full(case, precision, pairs):
    for device in dict.fromkeys(device for device, _ in pairs):
        found = case.measure(Where(device, "resident", precision, long=True))
        print(case.quantity, found.value)
        assert found.value <= case.allowed[precision]


def test_the_catalogue_is_the_page():
    """Every case has a row in the page and committed figures, all of them as asked; names are told apart."""
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    page = (ROOT / "docs" / "hard-cases.md").read_text(encoding="utf-8")
    assert not [name for name in names if f"| {name} |" not in page]
    for file in (ROOT / "benchmarks" / "results").glob("hard-cases-*.json"):
        rows = {row["name"]: row for row in json.loads(file.read_text(encoding="utf-8"))["cases"]}
        assert set(rows) == set(names)
        assert all(row["kept"] for row in rows.values())


def test_cases_can_fail(monkeypatch):
    """A plate that loses energy is not lossless, and a bad plate that nobody flags is seen."""
    monkeypatch.setitem(energies.FREE, "damped", {"effects": {"damping": {"viscous": 0.01}}})
    assert energies.conserved("damped", Where()).value > 1e-5
    monkeypatch.setattr(status, "NO_DRIVE", status.OK)
    assert odd.bad_neighbours({}, 7, Where()).value > 0
