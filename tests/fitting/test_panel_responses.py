"""Derivatives of responses against central differences of responses."""

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate.fitting.fitted_panel import FreeNumbers
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.panel_responses import PanelResponses
from warp_plate.scene.keys import value_of

DATA = MeasuredResponses("data.csv", np.linspace(6.0, 60.0, 9), np.ones((2, 9)))
SPRING = {"translation": 2e3, "rotation": 0.05}
EDGES = SPRING, "clamped", "supported", "free"
MASS = {"area": [0.1, 0.12, 0.05, 0.07], "mass": 1e-3, "stiffness": 300.0, "damping": 0.02}
EFFECTS = {
    "loss_factor": {"eta": 0.03},
    "damping": {"viscous": 2.0},
    "material_damping": {"time": 1e-5},
    "tension": {"x": 4.0, "y": 2.0},
    "foundation": {"stiffness": 500.0, "damping": 1.0},
    "oscillators": [MASS],
}
KEYS = """
    plate.young_modulus plate.poisson_ratio plate.density plate.thickness plate.size[0] edges.left.translation
    edges.left.rotation effects.loss_factor.eta effects.damping.viscous effects.material_damping.time effects.tension.x
    effects.foundation.stiffness effects.foundation.damping effects.oscillators[0].mass
    effects.oscillators[0].stiffness effects.oscillators[0].damping effects.oscillators[0].area[1] actuators[0].area[0]
    measurement[0].point[0] measurement[1].force_at[1] measurement[1].gain
"""
QUICK = ("plate.young_modulus", "plate.thickness", "edges.left.rotation")


def measured_panel(**effects):
    rows = [{"actuator": "0", "point": (0.15, 0.08), "gain": 1.2}, {"force_at": (0.05, 0.06), "point": (0.1, 0.1)}]
    rows[1]["quantity"] = "mobility"
    return scene_of(effects={**EFFECTS, **effects}, edges=EDGES, measurement=rows, grid={"modal_density": 0.4})


def compare(scene, key, tolerance, coarse=False):
    """Compare the derivative by a logarithm of a value with differences over one part in 1e4 of it."""
    value = value_of(scene, key)
    free = FreeNumbers(scene, (key,), np.array([value / 2]), np.array([value * 2]))
    found = PanelResponses(scene, DATA, coarse).slopes([free.neighbours(np.array([0.5]), 0, central=True)])[0]
    step = 1e-4 / np.log(4)
    above, below = (
        PanelResponses(free.scene_at(np.array([0.5 + sign * step])), DATA, coarse).values for sign in (1, -1)
    )
    expected = (above - below) / (2 * step)
    assert np.any(expected)
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * abs(expected).max())


LAYER = {"area": [0.05, 0.15, 0.08, 0.12], "thickness": 3e-4, "young_modulus": 2e9, "density": 1500.0}
RIGIDITIES = {"Dx": 0.02, "Dy": 0.01, "D1": 3e-3, "Dxy": 5e-3}
CASES = [
    *((key, {}) for key in KEYS.split()),
    *((f"effects.orthotropic.{name}", {"orthotropic": RIGIDITIES}) for name in RIGIDITIES),
    *((f"effects.layers[0].{name}", {"layers": [LAYER]}) for name in ("thickness", "young_modulus", "density")),
    # Damping mode by mode.
    ("plate.young_modulus", {"loss_factor": {"eta": [0.03, 0.02]}}),
    ("plate.young_modulus", {"modal_damping": {"ratio": 0.01}}),
]


@pytest.mark.parametrize(
    ("key", "effects"),
    [pytest.param(*case, marks=() if case[0] in QUICK and not case[1] else pytest.mark.slow) for case in CASES],
)
def test_derivatives(key, effects):
    compare(measured_panel(**effects), key, 5e-4 if "modal_damping" in effects or "loss_factor" in effects else 3e-4)


@pytest.mark.parametrize("width", [0.3999, 0.4001])
def test_functions_that_change_between_neighbours(width):
    """A patch whose edges cross the middles of two intervals changes the functions, but not their number."""
    patch = {**MASS, "area": [1 / 9, 0.4 - 1 / 9, 0.05, 0.07]}
    effects = {"loss_factor": {"eta": 0.03}, "oscillators": [patch]}
    rows = [{"force_at": (0.05, 0.06), "point": (0.1, 0.1)}]
    scene = scene_of(size=(width, 0.3), effects=effects, measurement=rows, modal_density=1.0)
    free = FreeNumbers(scene, ("plate.size[0]",), np.array([0.38]), np.array([0.42]))
    unknown = np.log(np.array([width]) / 0.38) / np.log(0.42 / 0.38)
    data = MeasuredResponses("data.csv", DATA.frequencies, np.ones((1, 9)))
    found = PanelResponses(scene, data, coarse=True).slopes([free.neighbours(unknown, 0, central=True)])[0]
    above, below = (PanelResponses(free.scene_at(unknown + step), data).values for step in (0.02, -0.02))
    expected = (above - below) / 0.04
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.05 * abs(expected).max())
