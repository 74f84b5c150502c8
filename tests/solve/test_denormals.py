"""Denormal numbers are zeros while the CPU's resident kernels run, and only then."""

import platform

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme

x86 = pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="x86 processors only")
TABLES = {"plain": {}, "moment form": {"effects": {"foundation": {"stiffness": 1e4}}}}
TINY = np.finfo(np.float32).tiny


# How plates run on a CPU: nodes, sides [m], plates, threads.
WAYS = {
    "team": ((129, 129), (0.2, 0.2), 1, 2),
    "singly": ((129, 129), (0.2, 0.2), 5, 2),
    "in groups": ((105, 9), (0.2, 0.0154), 16, 1),
}


def run_few_steps(scene, way, name, path="resident"):
    """Return displacements in the kernels' unit of plates driven at one end, most of whose nodes are still at rest."""
    nodes, size, plates, threads = WAYS[way]
    step = 0.9 * make_scheme(scene(nodes, size, **TABLES[name])).limit
    made = scene(
        nodes, size, precision="float32", actuators=[(0.005, 0.02, 0.004, 0.008)], time_step=step,
        frequency=0.01 / step, window=(0.0, 42 * step), **TABLES[name],
    )  # fmt: skip
    run = PlateSolver(made, "cpu", path, threads=threads).run(np.ones((plates, 1)), (40 * step,))
    return run.displacement / make_scheme(made).load_scale


@x86
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", TABLES)
def test_fronts_end_in_zeros(name, way, scene):
    """No denormals, but otherwise the same numbers as on the streaming path, which does not flush them."""
    flushed, kept = (run_few_steps(scene, way, name, path) for path in ("resident", "streaming"))
    assert not ((np.abs(flushed) > 0) & (np.abs(flushed) < TINY)).any()
    assert ((np.abs(kept) > 0) & (np.abs(kept) < TINY)).any()
    np.testing.assert_allclose(flushed, kept, rtol=0, atol=1e-6 * np.abs(kept).max())
    # The caller's own denormals are kept.
    assert np.float32(1e-40) * np.float32(0.5) > 0
    assert 1e-310 * 0.5 > 0
