"""Long searches take no more memory, descriptors and threads at their end than early on.

With -m hour these are 20000 generations, elsewhere a fiftieth.
"""

import sys

import pytest

from support.scenes import scene_of
from warp_plate import localize

psutil = pytest.importorskip("psutil")
linux = pytest.mark.skipif(sys.platform != "linux", reason="counts what Linux counts")
pytestmark = [pytest.mark.slow, pytest.mark.hour, linux]
# Allowed growth of memory between the first fifth of a run and its end [bytes].
ALLOWED = 2**24


def test_generations(hour):
    process, total, samples = psutil.Process(), 20000 if hour else 400, []
    made = scene_of((9, 9), damping=88.5, search={"particles": 4, "iterations": total})

    def on_progress(*_):
        samples.append((process.memory_info().rss, process.num_fds(), process.num_threads()))

    localize(made, device="cpu", evaluator="direct", estimate=False, spectrum=False, on_progress=on_progress)
    early, late = samples[total // 5], samples[-1]
    assert len(samples) >= total
    assert late[0] - early[0] < ALLOWED
    assert late[1:] <= early[1:]
