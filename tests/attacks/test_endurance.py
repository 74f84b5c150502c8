"""Long searches and sweeps take no more memory, descriptors and threads at their end than early on.

With -m hour these are 20000 generations and 2000 points, elsewhere a fiftieth.
"""

import sys

import pytest

from support.scenes import scene_of
from warp_plate import localize, sweep

psutil = pytest.importorskip("psutil")
linux = pytest.mark.skipif(sys.platform != "linux", reason="counts what Linux counts")
pytestmark = [pytest.mark.slow, pytest.mark.hour, linux]
# Allowed growth of memory between the first fifth of a run and its end [bytes].
ALLOWED = 2**24


class Watch:
    """Resources of a process, sampled at intervals."""

    def __init__(self, process=None):
        self.process, self.samples = process or psutil.Process(), []

    def look(self, done, total):
        if done >= total * (len(self.samples) + 1) // 20:
            process = self.process
            self.samples.append((process.memory_info().rss, process.num_fds(), process.num_threads()))

    def assert_flat(self):
        early, late = self.samples[4], self.samples[-1]
        print("memory [MiB], descriptors, threads:", [(sample[0] >> 20, *sample[1:]) for sample in (early, late)])
        assert len(self.samples) >= 19
        assert late[0] - early[0] < ALLOWED
        assert late[1:] <= early[1:]


def test_generations(hour):
    watch, total = Watch(), 20000 if hour else 400
    made = scene_of((9, 9), damping=88.5, search={"particles": 4, "iterations": total})
    done = []

    def on_progress(*_):
        done.append(1)
        watch.look(len(done), total)

    localize(made, device="cpu", evaluator="direct", estimate=False, spectrum=False, on_progress=on_progress)
    watch.assert_flat()


def test_points_of_a_sweep(hour):
    watch, total = Watch(), 2000 if hour else 40
    made = scene_of((9, 9), damping=88.5)
    vary = [f"drive.frequency=200:400:{total}"]
    found = sweep(made, vary, "simulate", device="cpu", path="resident", on_progress=lambda *at: watch.look(*at[:2]))
    assert found.plan.coordinates[0].shape == (total,)
    watch.assert_flat()
