"""What workers get: blocks of plates between their limits, sent as their numbers."""

import pickle

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene
from warp_plate.cluster.evaluator import block_size
from warp_plate.cluster.pool import BLOCK_NODE_STEPS
from warp_plate.cluster.tasks import Evaluation
from warp_plate.plate.designs import Designs


@pytest.mark.parametrize(("kind", "least", "most"), [("cpu", 128, 1024), ("cuda", 2112, 33792)])
def test_blocks_of_the_papers_plates(kind, least, most):
    """Two for each worker, of a multiple of 64 plates, or more where these would be too large."""
    node_steps, work = PlateSolver(Scene.load("paper"), "cpu").node_steps_per_plate, BLOCK_NODE_STEPS[kind]
    assert block_size(100 * most, 2, node_steps, work) == most
    assert block_size(10, 2, node_steps, work) == least
    assert block_size(4 * 5 * most // 8 - 3, 2, node_steps, work) == 5 * most // 8


def test_a_plate_is_sent_as_its_numbers():
    """16 bytes for each actuator, 8 for each frequency, delay and coordinate; 8 come back for each region."""

    def bytes_a_plate(make):
        whole, half = (len(pickle.dumps(make(count))) for count in (3000, 1500))
        return (whole - half) / 1500

    def designs(count):
        values = {"frequency": np.ones((count, 4)), "centre": np.ones((count, 4, 2)), "delay": np.ones((count, 4))}
        return Designs(np.ones((count, 4), complex), **values)

    assert bytes_a_plate(lambda count: Designs(np.ones((count, 4), complex))) == pytest.approx(64, abs=0.1)
    assert bytes_a_plate(designs) == pytest.approx(64 + 4 * 8 * 4, abs=0.1)
    assert bytes_a_plate(lambda count: Evaluation(np.ones((count, 2)), 0, {})) == pytest.approx(16, abs=0.1)
