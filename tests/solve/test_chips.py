"""Plans follow the limits of the chip: what is compiled for it fits its shared memory; registers are capped."""

import json
from pathlib import Path

import pytest
import warp as wp

from warp_plate.kernels import moment_form_cuda, plans, resident_strips
from warp_plate.kernels.cuda import RESERVED_BYTES
from warp_plate.kernels.plans import whole
from warp_plate.kernels.update import KernelEffects

# Shared memory that a block can have [KiB] by compute capability (CUDA C++ Programming Guide).
SHARED_KIB = {75: 64, 80: 163, 86: 99, 89: 99, 90: 227, 100: 227, 120: 99}
KINDS = {
    "order 2": KernelEffects(True, True, 2),
    "order 4": KernelEffects(True, True, 4),
    "free edges": KernelEffects(True, True, 2, moments=True),
    "stretching": KernelEffects(True, True, 2, moments=True, membrane=True),
}


def planned(effects, nodes, shared_bytes):
    """Return the kernel of a block for square plates, or None where they do not fit."""
    real, stride = wp.float32, -(-nodes // 16) * 16
    if effects.moments:
        plan = plans.plan_block(nodes, nodes, real, effects, 0, few=False, shared_bytes=shared_bytes)
        return moment_form_cuda.make_run_steps(effects, real, nodes, nodes, stride, 0, plan) if plan.on_chip else None
    plan = next(plans.strip_plans(effects.order, nodes, nodes, real, shared_bytes), None)
    return plan and resident_strips.make_run_steps(effects, real, whole(nodes), whole(nodes), stride, plan, True)


@pytest.mark.slow
@pytest.mark.parametrize("nodes", [27, 53, 81, 105, 161])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arch", [75, 89, 90])
def test_compiled_plans_fit_the_chip(arch, kind, nodes, tmp_path):
    kernel = planned(KINDS[kind], nodes, 1024 * SHARED_KIB[arch] - RESERVED_BYTES)
    if kernel is not None:
        wp.compile_aot_module(kernel.module, device=None, arch=arch, module_dir=tmp_path, use_ptx=True)
        allocated = json.loads(next(Path(tmp_path).glob("*.meta")).read_text(encoding="utf-8"))
        assert max(allocated.values()) + 1024 <= 1024 * SHARED_KIB[arch]  # a KiB is the driver's
