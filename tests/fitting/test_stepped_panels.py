"""Fits of responses by time stepping, from random panels; ``benchmarks/fits`` has many more."""

import pytest
from fits.campaign import ALLOWED, INSEPARABLE, measured, summary

# A panel with a loss factor, and one with springs and viscous damping.
PANELS = 16, 17


@pytest.mark.slow
def test_fits_of_stepped_panels():
    rows = [measured(number) for number in PANELS]
    found = summary(rows)
    assert found["said_inseparable"] == len(rows)
    assert found["rigidity_within"] == len(rows)
    for kind in ("modulus", "damping", "springs"):
        assert found[kind]["within"] == found[kind]["determined"] == found[kind]["numbers"]
    for row in rows:
        assert not row["inseparable"]
        assert max(abs(row["numbers"][key]["value"] / row["numbers"][key]["truth"] - 1) / limit
                   for key, limit in ALLOWED.items() if key in row["numbers"]) < 0.1  # fmt: skip
        assert set(INSEPARABLE) == {key for group in row["told_apart"] for key in group}
