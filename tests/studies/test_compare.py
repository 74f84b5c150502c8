"""Comparisons of methods: their bound, and what is said of it."""

import pytest

from warp_plate.scene.model import Scene
from warp_plate.studies.compare import compare
from warp_plate.studies.localize import localize

# Without damping the start-up motion never ends, and a phase that all actuators have in common counts.
UNDAMPED = {
    "plate": {
        "size": (0.2, 0.12),
        "thickness": 7e-4,
        "young_modulus": 7e10,
        "poisson_ratio": 0.22,
        "density": 2500.0,
    },
    "drive": {"frequency": 300.0},
    "window": {"start": 0.0, "end": 0.03},
    "target": {"area": (0.02, 0.06, 0.02, 0.06)},
    "actuators": [
        {"name": "a", "area": (0.03, 0.05, 0.03, 0.05)},
        {"name": "b", "area": (0.15, 0.17, 0.03, 0.05)},
        {"name": "c", "area": (0.03, 0.05, 0.09, 0.11)},
    ],
}


@pytest.mark.parametrize("method", ["exact", "pso"])
def test_bound_of_an_undamped_plate_is_attained_and_says_what_a_free_phase_adds(method: str) -> None:
    scene = Scene.model_validate(UNDAMPED | {"search": {"method": method}})
    found = compare(scene, methods=["exact"], evaluator="modal")
    assert found.bound_kind == "attained"
    assert found.trials[0].best_loss == pytest.approx(found.bound, abs=1e-9)
    best = localize(Scene.model_validate(UNDAMPED), evaluator="modal", estimate=False).main_case.localization_factor
    assert (f"{best:.6f}" in found.bound_sentence) == (method == "pso")
    assert (1 - found.bound == pytest.approx(best, abs=1e-9)) == (method == "exact")
