"""``choose`` keeps what it promises: ten scenes unlike the paper's, held against Ritz's method with many functions."""

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene
from warp_plate.accuracy.choose import choose
from warp_plate.plate.weights import localization_factor
from warp_plate.reference.forced import bound, converge, localization_factors, transient_matrices
from warp_plate.reference.ritz import solve_modes
from warp_plate.reference.thin_plate import thin_plate
from warp_plate.solve.response import measure_response

C, S = "clamped", "supported"
ALUMINIUM = {"thickness": 1e-3, "young_modulus": 7e10, "poisson_ratio": 0.34, "density": 2700.0}
GLASS = {"thickness": 7e-4, "young_modulus": 7e10, "poisson_ratio": 0.22, "density": 2500.0}
ACRYLIC = {"thickness": 2e-3, "young_modulus": 3e9, "poisson_ratio": 0.37, "density": 1180.0}
PAPER = {"thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1000.0}
# Name: size [m], material, edges left, bottom, right, top, damping [N·s/m³], frequency [Hz], window [s], target and
# actuators as parts of the plate's sides.
SCENES = {
    "small, light damping": (
        (0.1, 0.1), GLASS, (C, C, C, C), 40.0, 900.0, (0.02, 0.05), (0, 0.5, 0, 0.5),
        [(0.15, 0.25, 0.2, 0.3), (0.7, 0.85, 0.6, 0.75)],
    ),
    "oblong, supported": (
        (0.3, 0.12), ALUMINIUM, (S, S, S, S), 400.0, 500.0, (0.02, 0.04), (0.5, 1, 0, 1),
        [(0.1, 0.2, 0.3, 0.6), (0.75, 0.85, 0.4, 0.7), (0.45, 0.55, 0.1, 0.3)],
    ),
    "mixed edges, a strip as target": (
        (0.2, 0.15), ACRYLIC, (C, S, S, C), 300.0, 400.0, (0.02, 0.05), (0.35, 0.6, 0, 1),
        [(0.1, 0.22, 0.1, 0.25), (0.6, 0.75, 0.55, 0.8)],
    ),
    "clamped on one side": (
        (0.16, 0.2), GLASS, (C, S, S, S), 150.0, 350.0, (0.03, 0.06), (0.5, 1, 0.5, 1),
        [(0.2, 0.35, 0.2, 0.3), (0.7, 0.8, 0.7, 0.85)],
    ),
    "undamped": (
        (0.2, 0.2), ACRYLIC, (C, C, C, C), None, 200.0, (0.005, 0.015), (0, 0.5, 0, 1),
        [(0.2, 0.35, 0.3, 0.45), (0.6, 0.7, 0.6, 0.75)],
    ),
    "heavy damping": (
        (0.25, 0.2), PAPER, (S, C, S, C), 2000.0, 150.0, (0.01, 0.03), (0, 0.4, 0, 0.4),
        [(0.1, 0.2, 0.1, 0.2), (0.6, 0.7, 0.5, 0.65), (0.3, 0.4, 0.7, 0.8)],
    ),
    "one actuator": (
        (0.15, 0.15), ALUMINIUM, (S, C, C, C), 500.0, 1000.0, (0.01, 0.025), (0, 0.5, 0.5, 1),
        [(0.3, 0.5, 0.55, 0.75)],
    ),
    "low frequency": (
        (0.4, 0.3), ACRYLIC, (C, C, S, S), 100.0, 60.0, (0.1, 0.2), (0.6, 1, 0, 0.5),
        [(0.05, 0.15, 0.1, 0.2), (0.8, 0.9, 0.7, 0.85), (0.4, 0.6, 0.4, 0.6)],
    ),
    "four actuators, a target off the middle": (
        (0.22, 0.18), GLASS, (C, C, C, C), 250.0, 450.0, (0.02, 0.04), (0.13, 0.47, 0.21, 0.68),
        [(0.15, 0.25, 0.15, 0.25), (0.75, 0.85, 0.2, 0.3), (0.2, 0.3, 0.75, 0.85), (0.7, 0.85, 0.7, 0.8)],
    ),
    "large patches at the edge": (
        (0.3, 0.3), ALUMINIUM, (S, S, C, C), 600.0, 300.0, (0.015, 0.04), (0, 1, 0, 0.33),
        [(0.0, 0.3, 0.0, 0.2), (0.5, 1.0, 0.6, 1.0)],
    ),
}  # fmt: skip
QUICK = ("oblong, supported",)
ASKED = 0.01


def scene_called(name):
    """The scene of a name."""
    size, material, edges, damping, frequency, window, target, actuators = SCENES[name]
    scale = np.repeat(size, 2)
    return Scene.model_validate(
        {
            "plate": {"size": size, **material},
            "edges": dict(zip(("left", "bottom", "right", "top"), edges, strict=True)),
            "window": {"start": window[0], "end": window[1]},
            "drive": {"frequency": frequency},
            "target": {"area": tuple(scale * target)},
            "effects": {} if damping is None else {"damping": {"viscous": damping}},
            "actuators": [
                {"name": str(index), "area": tuple(scale * area)} for index, area in enumerate(actuators)
            ],
        }
    )


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SCENES]
)
def test_the_promise_is_kept(name):
    """Equal drive, single, best drive and bound are right to 1 %, against many more functions than ``choose`` takes."""
    scene = scene_called(name)
    choice = choose(scene, ASKED, "cpu")
    right = transient_matrices(solve_modes(thin_plate(scene), 40), scene)
    largest, best = bound(right)
    singles = np.eye(len(scene.actuators), dtype=complex)
    single = singles[int(np.argmax(localization_factors(right, singles)))]
    drives = np.array([single, best, np.ones(len(singles))])
    known_to = converge(scene, drives, counts=(24, 32, 40))[-1].error
    assert known_to < 0.15 * ASKED
    solver = PlateSolver(choice.scene, "cpu")
    found = localization_factor(solver.run(drives).energy)
    exact = choice.scene.model_copy(update={"grid": choice.scene.grid.model_copy(update={"precision": "float64"})})
    found_bound = measure_response(PlateSolver(exact, "cpu")).bound()
    errors = [*np.abs(found / localization_factors(right, drives) - 1), abs(found_bound / largest - 1)]
    assert max(errors) < ASKED + known_to
    assert max(errors) < choice.error + known_to
    assert choice.error <= ASKED
    assert choice.scene.grid.accuracy is None
