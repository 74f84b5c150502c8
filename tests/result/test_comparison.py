"""Comparison files: trials are read back by method in their order and by increasing seed."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from warp_plate.result.comparison import MethodComparison, Trial, load_comparison, save_comparison
from warp_plate.scene import SceneError


@pytest.fixture
def comparison(scene, random):
    pairs = (("ring", 9), ("ring", 10), ("cma", 9))
    trials = tuple(Trial(*pair, 8 * np.arange(1, 4), random.uniform(size=3), random.uniform(size=3)) for pair in pairs)
    return MethodComparison(
        "panel", scene(), "cpu", "direct", 24, {"prepare": 0.5}, False, trials, -0.25, "attained", "no less",
        {"exact": "not quadratic"}, True, {"numpy": "2"}, {"killed": 1},
    )  # fmt: skip


def test_a_comparison_is_loaded_as_it_was_saved(comparison, tmp_path):
    path = save_comparison(comparison, tmp_path / "c.h5")
    loaded = load_comparison(path)
    assert replace(loaded, trials=()) == replace(comparison, trials=())
    for one, other in zip(loaded.trials, comparison.trials, strict=True):
        np.testing.assert_equal(vars(one), vars(other))
    with h5py.File(path) as file:
        columns = {name: column.attrs["units"] for name, column in file["trials/ring/10"].items()}
    assert columns == {"evaluations": "1", "seconds": "s", "loss": "1"}


def test_incomplete_trials_are_refused(comparison, tmp_path):
    empty = replace(comparison.trials[0], evaluations=np.ones(0), seconds=np.ones(0), loss=np.ones(0))
    for trial, words in (
        (empty, "trials/ring"),
        (replace(empty, loss=np.ones(2)), "trials/ring/9/loss has shape"),
        (replace(empty, seed="x"), ""),
    ):
        path = save_comparison(replace(comparison, trials=(trial,)), tmp_path / "c.h5")
        with pytest.raises(SceneError, match=r"^.*c\.h5: damaged") as caught:
            load_comparison(path)
        assert words in str(caught.value)
