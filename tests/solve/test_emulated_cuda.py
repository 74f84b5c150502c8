"""The kernels of CUDA for plain plates, and their launches, give the numbers of the CPU where Python runs them."""

import types
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from support import emulated_cuda
from warp_plate import PlateSolver, Scene
from warp_plate.kernels.plans import plan_strips
from warp_plate.solve import compiled_scene, cuda, specialize, streaming

EDGES = {"left": "supported", "right": "clamped", "bottom": "supported", "top": "clamped"}


def lanes(specialized):
    return cuda._lanes_path(specialized)


def strips(rows, columns, warps, shared_rates=0, **options):
    def path(specialized):
        plan = plan_strips(rows, columns, warps, **options)
        plan = replace(plan, shared_rows=plan.shared_rows + shared_rates)
        return cuda._blocks_path(specialized, cuda._whole(specialized), plan)

    return path


def tiles(specialized):
    axes, plan = cuda.plan_tiles(specialized, 1)
    assert axes[0].count * axes[1].count > 1
    return cuda._blocks_path(specialized, axes, plan, cuda.TILE_LEVELS[specialized.scheme.order])


CASES = {
    "lanes": (2, (13, 11), 9, 8, lanes),
    "strips": (2, (37, 15), 2, 8, strips(13, 2, 2)),
    "strips, numbers off the registers": (
        2, (40, 14), 2, 8, strips(12, 2, 2, loads_in_registers=False, squares_shared=True),
    ),
    "strips, a part of the rates off the registers": (
        2, (40, 14), 2, 8, strips(12, 2, 2, 4, loads_in_registers=False, squares_shared=True),
    ),
    "one strip of fourth order": (4, (15, 13), 2, 8, strips(13, 1, 1)),
    "strips of fourth order": (4, (37, 15), 2, 8, strips(15, 2, 2, loads_in_registers=False, squares_shared=True)),
    "tiles": (2, (30, 44), 1, 9, tiles),
    "tiles of fourth order": (4, (30, 44), 1, 7, tiles),
    "temporal blocking": (2, (23, 12), 1, 11, cuda._blocking_path),
    "temporal blocking of fourth order": (4, (23, 12), 1, 5, cuda._blocking_path),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_emulated_kernels_have_the_numbers_of_the_cpu(monkeypatch, case):
    order, nodes, plates, steps, path = CASES[case]
    emulated = types.SimpleNamespace(**{**vars(wp), "launch": emulated_cuda.launch})
    for module in (cuda, streaming):
        monkeypatch.setattr(module, "wp", emulated)
    load = specialize.Specialized.load
    monkeypatch.setattr(
        specialize.Specialized,
        "load",
        lambda self, *kernels, block_dim=None: load(
            self, *(kernel for kernel in kernels if kernel.func.__name__ not in emulated_cuda.EMULATED)
        ),
    )
    monkeypatch.setattr(wp.get_device("cpu"), "sm_count", 2 if path is tiles else 4, raising=False)
    monkeypatch.setattr(wp.get_device("cpu"), "max_shared_memory_per_block", 230_000, raising=False)
    monkeypatch.setitem(compiled_scene.CPU, "emulated", path)
    step = 8e-5 * (26 / (max(nodes) - 1)) ** 2 / (2 if order == 4 else 1)
    grid = {"nodes": nodes, "order": order, "load": "moments" if order == 4 else "overlap", "time_step": step}
    window = {"start": step * (steps // 2), "end": step * steps}
    small = Scene.load("paper").with_tables(grid=grid, window=window, record={}, edges=EDGES)
    drives = np.random.default_rng(0).normal(size=(plates, 4, 2)) @ [1, 1j]
    expected, run = (PlateSolver(small, "cpu", path=name).run(drives, [step * steps]) for name in ("auto", "emulated"))
    largest = np.abs(expected.displacement).max()
    assert np.abs(run.displacement - expected.displacement).max() < 2e-6 * largest
    np.testing.assert_allclose(run.energy, expected.energy, rtol=2e-6)
