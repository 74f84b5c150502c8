"""Fits of responses by time stepping, from random panels; ``benchmarks/fits`` has many more."""

import math

import numpy as np
import pytest
from fits.campaign import ALLOWED, INSEPARABLE, measured, summary
from fits.stepping import extrapolated

# A panel with a loss factor, and one with springs and viscous damping.
PANELS = 16, 17


def test_resonances_that_move_are_extrapolated():
    frequencies, squares = np.linspace(0.5, 3, 40), lambda cells: np.array([1, 4]) * (1 - 3 / cells**2)
    shares = np.array([[1, 0.3], [-0.7, 1], [0.2, 0.5]])

    def responses(cells):
        return shares @ (1 / (squares(cells)[:, None] * (1 + 0.05j) - frequencies**2))

    cells = (4, 5, 6, 7)
    found = extrapolated(cells, [responses(each) for each in cells])
    assert found == pytest.approx(responses(math.inf), rel=1e-3)


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
