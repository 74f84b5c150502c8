"""Comparisons of methods: their bound, and what is said of it."""

import pytest

from support.scenes import scene_of
from warp_plate.studies.compare import compare
from warp_plate.studies.localize import localize


@pytest.mark.parametrize("method", ["exact", "pso"])
def test_bound_of_an_undamped_plate_is_attained_and_says_what_a_free_phase_adds(method):
    undamped = scene_of(window=(0.0, 0.03))  # the start-up motion never ends, so a common phase counts
    scene = undamped.with_tables(search={"method": method})
    found = compare(scene, methods=["exact"], evaluator="modal")
    assert found.bound_kind == "attained"
    assert found.trials[0].best_loss == pytest.approx(found.bound, abs=1e-9)
    best = localize(undamped, evaluator="modal", estimate=False).main_case.localization_factor
    assert (f"{best:.6f}" in found.bound_sentence) == (method == "pso")
    assert (1 - found.bound == pytest.approx(best, abs=1e-9)) == (method == "exact")
