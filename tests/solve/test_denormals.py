"""Denormal numbers are zeros while the CPU's resident kernels run, and only then."""

import platform

import numpy as np
import pytest

from support.oracle import reference
from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme

TINY = np.finfo(np.float32).tiny
# Kinds of runs on a CPU: nodes, sides [m], plates, and tables; the first with several threads.
WAYS = {
    "team": ((97, 89), (0.2, 0.2), 1, {}),
    "in groups": ((105, 9), (0.2, 0.0154), 32, {}),
    "moment form": ((105, 9), (0.2, 0.0154), 3, {"effects": {"foundation": {"stiffness": 1e4}}}),
}


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="x86 processors only")
@pytest.mark.parametrize("way", WAYS)
def test_fronts_end_in_zeros(way, scene):
    """No denormals, but otherwise the same numbers as of the plain NumPy plates, which do not flush them."""
    nodes, size, plates, tables = WAYS[way]
    step = 0.9 * make_scheme(scene(nodes, size, **tables)).limit
    # Driven at one end, so that most nodes are still at rest.
    made = scene(
        nodes, size, precision="float32", actuators=[(0.005, 0.02, 0.004, 0.008)], time_step=step,
        frequency=0.01 / step, window=(0.0, 42 * step), **tables,
    )  # fmt: skip
    drives, unit = np.ones((plates, 1)), make_scheme(made).load_scale
    flushed = PlateSolver(made, "cpu", threads=2).run(drives, (40 * step,)).displacement[:, 0] / unit
    kept = np.broadcast_to(reference(made, drives[:1])[1][:, 40] / unit, flushed.shape)
    assert not ((np.abs(flushed) > 0) & (np.abs(flushed) < TINY)).any()
    assert ((np.abs(kept) > 0) & (np.abs(kept) < TINY)).any()
    np.testing.assert_allclose(flushed, kept, rtol=0, atol=1e-6 * np.abs(kept).max())
    assert np.float32(1e-40) * np.float32(0.5) > 0  # the caller's own denormals are kept
