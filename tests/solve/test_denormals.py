"""Numbers next to zero are zeros while the CPU's resident kernels run, and for nobody else."""

import platform

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme

x86 = pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="other processors need none")
TABLES = {"plain": {}, "general": {"effects": {"foundation": {"stiffness": 1e4}}}}
TINY = {"float32": np.finfo(np.float32).tiny, "float64": np.finfo(np.float64).tiny}


def run_of_few_steps(scene, plates, tables, precision="float32", **options):
    """Driven in a corner, ended while most of the plate is still at rest; displacements in the kernels' own unit."""
    trial = scene((129, 129), **tables)
    step = 0.9 * make_scheme(trial).limit
    made = scene(
        (129, 129), precision=precision, actuators=[(0.005, 0.02, 0.005, 0.02)], time_step=step, frequency=0.01 / step,
        window=(0.0, 42 * step), **tables,
    )  # fmt: skip
    run = PlateSolver(made, "cpu", **options).run(np.ones((plates, 1)), (40 * step,))
    return run.displacement / make_scheme(made).load_scale


@x86
@pytest.mark.parametrize("plates", [1, 20])  # singly, and in groups
@pytest.mark.parametrize("name", TABLES)
def test_fronts_end_in_zeros(name, plates, scene):
    """No number below the smallest of full precision; and where they are above it, the same as without flushing, which
    is how the streaming path runs."""
    flushed = run_of_few_steps(scene, plates, TABLES[name], path="resident")
    kept = run_of_few_steps(scene, plates, TABLES[name], path="streaming")
    sizes = np.abs(flushed)
    assert not ((sizes > 0) & (sizes < TINY["float32"])).any()
    assert ((np.abs(kept) > 0) & (np.abs(kept) < TINY["float32"])).any()
    np.testing.assert_allclose(flushed, kept, rtol=0, atol=1e-6 * np.abs(kept).max())


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", TABLES)
def test_the_caller_keeps_its_tiny_numbers(name, threads, scene):
    run_of_few_steps(scene, 20, TABLES[name], path="resident", threads=threads)
    assert np.float32(1e-40) * np.float32(0.5) > 0
    assert 1e-310 * 0.5 > 0
