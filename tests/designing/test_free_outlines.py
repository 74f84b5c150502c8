"""Slopes of designs by pieces of the outline, by ends of parts of its edge and by supports, against differences of
values, within ranges and at their ends."""

import numpy as np
import pytest

import warp_plate as wpl
from support.designs import error_at_end, errors_of_slopes
from support.scenes import MATERIAL, scene_of
from warp_plate.designing.numbers import stencils
from warp_plate.designing.panel import FreePanel

RADIUS = {"radius": {"keys": [f"plate.outline.disc[{index}]" for index in range(3)]}}
ROUND = {**MATERIAL, "outline": {"disc": (0.1, 0.1, 0.1)}}
DISCS = [{"name": str(index), "disc": (0.07 + 0.05 * index, 0.1, 0.012)} for index in range(2)]
OSCILLATOR = {"area": (0.12, 0.14, 0.1, 0.12), "mass": 2e-3, "stiffness": 3e3, "damping": 0.5}
HELD_DISC = {"plate": ROUND, "edges": {"outline": "clamped"}, "links": RADIUS, "actuators": DISCS}
CLAMPED = {"edges": {"outline": "clamped"}, "actuators": DISCS, "drive": {"frequency": 60.0}}
STEADY = {"objective": "velocity", "steady": True}
ROUND_HOLE = {"disc": (0.14, 0.07, 0.015), "edge": "clamped"}
SLOT = {"rectangle": (0.05, 0.02), "centre": (0.14, 0.06)}
PART = {"from_point": (0.05, 0.0), "to_point": (0.13, 0.0), "edge": "clamped"}


def outlined(holes=()):
    return {**CLAMPED, "plate": {**MATERIAL, "outline": {"rectangle": (0.2, 0.18)}, "holes": holes}}


SHAPES = {
    "size": {"design": {"free": {"plate.size[0]": [0.19, 0.22]}, "limits": {"mass": 0.03}}},
    "strip": {
        "plate": {**MATERIAL, "size": (0.031, 0.29)},
        "edges": {"left": "free", "bottom": "clamped", "right": "supported", "top": {"translation": 640.0}},
        "target": {"area": (0.005, 0.02, 0.2, 0.27)},
        "actuators": [{"name": str(y), "area": (0.004, 0.02, y, y + 0.03)} for y in (0.03, 0.1, 0.15)],
        "drive": {"frequency": 300.0},
        "grid": {"modal_density": 0.7},
        "design": {"free": {"plate.size[0]": [0.031, 0.034]}},
    },
    "disc": {**HELD_DISC, "design": {"free": {"radius": [0.095, 0.11], "plate.thickness": [4e-4, 6e-4]}}},
    "support": {
        "supports": [{"point": (0.13, 0.12)}],
        "design": {"free": {"supports[0].point[0]": [0.11, 0.145]}, "objective": "velocity"},
    },
    "screw": {
        **outlined([{"disc": (0.13, 0.06, 0.015)}]),
        "supports": [{"point": (0.13, 0.12)}],
        "links": {"both": {"keys": ["plate.holes[0].disc[0]", "supports[0].point[0]"]}},
        "design": {"free": {"both": [0.12, 0.14]}, **STEADY},
    },
    "side": {**outlined(), "design": {"free": {"plate.outline.rectangle[0]": [0.19, 0.21]}, **STEADY}},
    "hole": {**outlined([ROUND_HOLE]), "design": {"free": {"plate.holes[0].disc[2]": [0.0135, 0.018]}, **STEADY}},
    "slot": {**outlined([SLOT]), "design": {"free": {"plate.holes[0].rectangle[0]": [0.04, 0.06]}, **STEADY}},
    "part": {
        **outlined(),
        "edges": {"outline": "free", "parts": [PART]},
        "design": {"free": {"edges.parts[0].to_point[0]": [0.125, 0.138]}, **STEADY},
    },
}
# Parts of slopes by which they may differ where more functions of less energy turned by rounding, and where steps that
# suit a hole alone were too short for the support that moves with it.
SMOOTH = {"part": 3e-7, "screw": 3e-7}


def panel_of(**tables):
    base = scene_of(modal_density=0.3, damping=60.0).model_dump(mode="json", exclude_none=True)
    return FreePanel(wpl.Scene.model_validate({**base, **tables}))


@pytest.mark.parametrize("name", SHAPES)
def test_slopes_by_pieces_of_the_outline_are_those_of_differences(name):
    panel = panel_of(**SHAPES[name])
    numbers, direction = np.full(panel.count, 0.4), np.eye(panel.count)[0]
    errors, sizes = errors_of_slopes(panel, numbers, direction, 2e-3, "smooth")
    assert (errors <= SMOOTH.get(name, 2e-6) * sizes).all()


def test_slopes_by_a_support_beside_a_knot_are_those_of_differences():
    """What splines follow of the motion about the support changes within its distance to the knot."""
    key, tables = "supports[0].point[1]", SHAPES["support"]
    *_, y = panel_of(**tables)._functions.space.along
    knot = y.breaks[np.abs(y.breaks - 0.12).argmin()]
    x, place = 0.13, float(knot + 0.02 * np.diff(y.breaks).min())
    design = {**tables["design"], "free": {key: [place - 4e-3, place + 6e-3]}}
    panel = panel_of(supports=[{"point": (x, place)}], design=design)
    errors, sizes = errors_of_slopes(panel, np.array([0.4]), np.ones(1), 2e-3, "smooth")
    assert (errors <= 1e-6 * sizes).all()


@pytest.mark.parametrize("end", [0.0, 1.0])
@pytest.mark.parametrize("name", ["size", "support", "side", "part", pytest.param("hole", marks=pytest.mark.slow)])
def test_slopes_at_ends_of_ranges_are_those_of_differences(name, end):
    panel = panel_of(**SHAPES[name])
    assert error_at_end(panel, np.append(end, np.full(panel.count - 1, 0.4))) <= SMOOTH.get(name, 1e-5)


@pytest.mark.parametrize("end", [0.0, 1.0])
@pytest.mark.parametrize("patch", ["effects.oscillators[0]", "actuators[0]"])
def test_slopes_of_patches_at_the_edge_of_the_plate_are_those_of_differences(patch, end):
    effects = {"oscillators": [OSCILLATOR], "damping": {"viscous": 60.0}}
    edges = {"left": "free", "right": "free", "bottom": "clamped", "top": "clamped"}
    design = {"places": {patch: [0.0, 0.2, 0.08, 0.13]}}
    panel = panel_of(effects=effects, edges=edges, actuators=DISCS, drive={"frequency": 290.0}, design=design)
    assert error_at_end(panel, np.array([end, 0.4]), 1e-4) <= 1e-7


@pytest.mark.parametrize("free", [{"area[0]": [0.11, 0.125]}, {"disc[2]": [0.008, 0.02]}], ids=["area", "disc"])
def test_slopes_by_shapes_of_attachments_are_those_of_differences(free):
    key, ends = next(iter(free.items()))
    oscillator = {**OSCILLATOR, "area": None, "disc": (0.13, 0.11, 0.01)} if "disc" in key else OSCILLATOR
    design = {"free": {f"effects.oscillators[0].{key}": ends}}
    panel = panel_of(effects={"oscillators": [oscillator], "damping": {"viscous": 60.0}}, design=design)
    errors, sizes = errors_of_slopes(panel, np.array([0.4]), np.ones(1), 1e-3, "smooth")
    assert (errors <= 1e-5 * sizes).all()


def test_slopes_by_places_of_layers_are_those_of_differences_and_free_of_rounding(monkeypatch):
    """They come from the edges of the layer; in differences of sums over the plate rounding was 1e-5 of some, and the
    larger, the smaller the step."""
    layer = {"area": (0.02, 0.12, 0.05, 0.08), "thickness": 1e-4, "young_modulus": 2e9, "density": 1800.0}
    effects, design = {"layers": [layer]}, {"places": {"effects.layers[0]": [0.02, 0.18, 0.03, 0.17]}}
    panel, numbers = panel_of(effects={**effects, "damping": {"viscous": 60.0}}, design=design), np.array([0.4, 0.3])
    slopes = panel.evaluate(numbers).slopes
    for direction in np.eye(2):
        errors, sizes = errors_of_slopes(panel, numbers, direction, 1e-3, "smooth")
        assert (errors <= 1e-6 * sizes).all()
    monkeypatch.setattr("warp_plate.designing.panel.STEP", 1e-5)
    assert panel.evaluate(numbers).slopes == pytest.approx(slopes, rel=0, abs=2e-7 * np.abs(slopes).max())


@pytest.mark.parametrize("count", [3, 5])
@pytest.mark.parametrize("share", [0.0, 5e-5, 0.3, 1.0])
def test_stencils_stay_in_the_range_and_are_exact_for_polynomials(share, count):
    coefficients = np.arange(1.0, count + 1.0)
    for points, weights in stencils(share, 1e-3, count):
        assert points.min() >= 0
        assert points.max() <= 1
        slope = np.polyval(np.polyder(coefficients), share)
        assert weights @ np.polyval(coefficients, points) == pytest.approx(slope, rel=1e-9)
