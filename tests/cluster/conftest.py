"""What tests of workers share."""

import pytest

from warp_plate.cluster.evaluator import BLOCK_NODE_STEPS


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Blocks of the fewest plates."""
    monkeypatch.setitem(BLOCK_NODE_STEPS, "cpu", (1.0, 1.0))
