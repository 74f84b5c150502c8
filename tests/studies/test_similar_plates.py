"""A plate turned over its diagonal, and larger and smaller ones, move alike, by both engines.

In a plate of another size all lengths and times have the same factor; moduli and densities stay as they are.
"""

import pytest

from warp_plate import Scene
from warp_plate.studies.simulate import simulate

A, B, SPRINGS = 0.2, 0.15, {"translation": 3e4, "rotation": 5.0}
TABLES = {
    "plate": {"size": [A, B], "thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1e3},
    "edges": {"left": "clamped", "bottom": SPRINGS, "right": "free", "top": "supported"},
    "grid": {"nodes": [17, 13], "precision": "float64", "modal_density": 0.25},
    "window": {"start": 0.004, "end": 0.012},
    "drive": {"frequency": 290.0, "burst": {"start": 0.001, "duration": 0.009, "ramp": 0.002}},
    "target": {"polygon": [[0.1, 0.01], [0.19, 0.05], [0.12, 0.13]]},
    "effects": {
        "damping": {"viscous": 50.0},
        "material_damping": {"time": 1e-5},
        "tension": {"x": 5.0, "y": -0.5},
        "foundation": {"stiffness": 1e4},
        "orthotropic": {"Dx": 0.28, "Dy": 0.2, "D1": 0.06, "Dxy": 0.08},
        "variation": {"thickness": [[1.0, 1.2, 0.9], [0.9, 1.0, 1.1]]},
        "layers": [{"area": [0.03, 0.09, 0.0, 0.06], "thickness": 1e-4, "young_modulus": 2e9, "density": 1800.0}],
        "oscillators": [
            {"area": [0.1, 0.14, 0.05, 0.1], "mass": 1e-3, "stiffness": 900.0, "damping": 0.2}
        ],
    },
    "actuators": [
        {"name": "1", "area": [0.03, 0.06, 0.02, 0.05]},
        {"name": "2", "area": [0.12, 0.17, 0.06, 0.13], "phase": 1.0, "magnitude": 0.7},
    ],
}  # fmt: skip
# Powers of the factor that differ from 1: of the numbers in some tables, and of single numbers.
OF_TABLES = {"foundation": -1, "orthotropic": 3, "variation": 0}
OF_NUMBERS = {
    "density": 0, "young_modulus": 0, "poisson_ratio": 0, "viscous": 0, "translation": 0, "magnitude": 0, "phase": 0,
    "nodes": 0, "modal_density": 0, "frequency": -1, "rotation": 2, "damping": 2, "mass": 3,
}  # fmt: skip


def scaled(part, factor, power=1):
    """Return a part of the tables with all lengths multiplied by a factor."""
    if isinstance(part, dict):
        return {
            key: scaled(value, factor, (OF_TABLES if isinstance(value, dict) else OF_NUMBERS).get(key, power))
            for key, value in part.items()
        }
    if isinstance(part, list):
        return [scaled(value, factor, power) for value in part]
    return part if isinstance(part, str) or not power else part * factor**power


EXCHANGED = {
    "area": lambda area: [*area[2:], *area[:2]],
    "polygon": lambda points: [[y, x] for x, y in points],
    "thickness": lambda rows: [list(column) for column in zip(*rows, strict=True)],
}


def exchanged(part):
    """Return a part of the tables with areas, points and maps turned over the diagonal."""
    if isinstance(part, dict):
        return {
            key: EXCHANGED[key](value) if key in EXCHANGED and isinstance(value, list) else exchanged(value)
            for key, value in part.items()
        }
    return [exchanged(value) for value in part] if isinstance(part, list) else part


def turned(tables):
    """Return the tables with x and y exchanged."""
    tables = exchanged(tables)
    edges, effects = tables["edges"], tables["effects"]
    pairs = (edges, "left", "bottom"), (edges, "right", "top"), (effects["tension"], "x", "y")
    for table, first, second in (*pairs, (effects["orthotropic"], "Dx", "Dy")):
        table[first], table[second] = table[second], table[first]
    tables["plate"]["size"], tables["grid"]["nodes"] = [B, A], TABLES["grid"]["nodes"][::-1]
    return tables


def factor_of(tables, path):
    result = simulate(Scene.from_tables(tables), device="cpu", path=path, estimate=False)
    return result.cases["drive"].localization_factor


@pytest.mark.parametrize(("path", "scale"), [("auto", 37.0), pytest.param("modal", 0.02, marks=pytest.mark.slow)])
def test_turned_plates_of_another_size_have_the_same_localization_factor(path, scale):
    factor = factor_of(TABLES, path)
    assert 0.05 < factor < 0.95
    assert factor_of(scaled(turned(TABLES), scale), path) == pytest.approx(factor, rel=1e-7)
