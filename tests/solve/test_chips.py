"""Plans follow the limits of the chip: what is compiled for it fits its registers and its shared memory."""

import json
import struct
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import pytest
import warp as wp

from warp_plate.kernels import (
    moment_form_blocking,
    moment_form_cuda,
    plans,
    resident_lanes,
    resident_strips,
    temporal_blocking,
)
from warp_plate.kernels.cuda import RESERVED_BYTES
from warp_plate.kernels.plans import whole
from warp_plate.kernels.update import KernelEffects
from warp_plate.solve.cuda import plan_tiles

# Shared memory that a block can have [KiB] by compute capability, and the registers of each quarter of a multiprocessor
# (CUDA C++ Programming Guide, technical specifications per compute capability).
SHARED_KIB = {75: 64, 80: 163, 86: 99, 89: 99, 90: 227, 100: 227, 120: 99}
QUARTER_REGISTERS = 16384
NODES = (27, 53, 81, 105, 161)
KINDS = {
    "order 2": KernelEffects(True, True, 2),
    "order 4": KernelEffects(True, True, 4),
    "free edges": KernelEffects(True, True, 2, moments=True),
    "stretching": KernelEffects(True, True, 2, moments=True, membrane=True),
}
# Numbers in a cubin: kinds of its entries in .nv.info.
REGISTER_COUNT = 0x2F


def planned(effects, nodes, shared_bytes):
    """Return the kernel for square plates, and the threads of its blocks."""
    real, stride = wp.float32, -(-nodes // 16) * 16
    if effects.moments:
        plan = plans.plan_block(nodes, nodes, real, effects, 0, few=False, shared_bytes=shared_bytes)
        if not plan.on_chip:
            levels, planes = 1 if effects.membrane else 3, plans.material_planes(effects)
            kernel = moment_form_blocking.make_advance_tiles(effects, real, nodes, nodes, stride, planes, levels, True)
            return kernel, 128
        return moment_form_cuda.make_run_steps(effects, real, nodes, nodes, stride, 0, plan), plan.threads
    if effects.order == 2 and resident_lanes.fits(nodes, nodes):
        return resident_lanes.make_run_steps(effects, real, nodes, 0b11 << 5, True), 32
    plan = next(plans.strip_plans(effects.order, nodes, nodes, real, shared_bytes), None)
    if plan is not None:
        axes = whole(nodes), whole(nodes)
        return resident_strips.make_run_steps(effects, real, *axes, stride, plan, True), 32 * plan.warps
    levels = 2 if effects.order == 4 else 5
    return temporal_blocking.make_advance_tiles(effects, real, nodes, nodes, stride, levels, True), 128


def compiled_needs(kernel, arch):
    """Return registers per thread and bytes of shared memory per block of a kernel, compiled for a chip."""
    with TemporaryDirectory() as folder:
        wp.compile_aot_module(kernel.module, device=None, arch=arch, module_dir=folder, use_ptx=False)
        cubin = next(Path(folder).glob("*.cubin")).read_bytes()
        allocated = json.loads(next(Path(folder).glob("*.meta")).read_text(encoding="utf-8"))
    sections = sections_of(cubin)
    info = sections[".nv.info"]
    entries = [struct.unpack_from("<BBHII", info, at) for at in range(0, len(info), 12)]
    registers = max(value for _, kind, _, _, value in entries if kind == REGISTER_COUNT)
    static = sum(len(data) for name, data in sections.items() if name.startswith(".nv.shared.make"))
    return registers, static + max(allocated.values())


def sections_of(elf):
    """Return the sections of a 64-bit ELF file by name; those without data, as zeros of their size."""
    (start,), (size, count, names) = struct.unpack_from("<Q", elf, 40), struct.unpack_from("<HHH", elf, 58)
    headers = [struct.unpack_from("<IIQQQQ", elf, start + index * size) for index in range(count)]
    text = elf[headers[names][4] :]
    return {
        text[name : text.index(b"\0", name)].decode(): bytes(length) if kind == 8 else elf[place : place + length]
        for name, kind, _, _, place, length in headers
    }


@pytest.mark.slow
@pytest.mark.parametrize("nodes", NODES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arch", SHARED_KIB)
def test_compiled_plans_fit_the_chip(arch, kind, nodes):
    limit = 1024 * SHARED_KIB[arch]
    kernel, threads = planned(KINDS[kind], nodes, limit - RESERVED_BYTES)
    registers, shared = compiled_needs(kernel, arch)
    assert 8 <= registers <= 255
    assert -(-threads // 128) * 32 * registers <= QUARTER_REGISTERS
    assert shared <= limit


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("real", [wp.float32, wp.float64])
@pytest.mark.parametrize("arch", SHARED_KIB)
def test_compiled_tiles_fit_the_chip(arch, order, real):
    """A plate of 161² is cut into tiles on 40 multiprocessors, as many as the smallest of these chips have."""
    limit, nodes = 1024 * SHARED_KIB[arch], (161, 161)
    scheme, device = SimpleNamespace(order=order, nodes=nodes), SimpleNamespace(sm_count=40)
    plate = SimpleNamespace(scheme=scheme, real=real, shared_bytes=limit - RESERVED_BYTES, device=device)
    axes, plan = plan_tiles(plate, 1)
    kernel = resident_strips.make_run_steps(KernelEffects(True, True, order), real, *axes, 176, plan, True)
    registers, shared = compiled_needs(kernel, arch)
    assert -(-plan.warps // 4) * 32 * registers <= QUARTER_REGISTERS
    assert shared <= limit


@pytest.mark.parametrize("kind", KINDS)
def test_less_shared_memory_takes_smaller_plates(kind):
    """Plates that fit a chip also fit a larger one; each has its largest plate."""
    effects, fits = KINDS[kind], []
    for shared_bytes in sorted({1024 * size - RESERVED_BYTES for size in SHARED_KIB.values()}):
        if effects.moments:
            found = [
                plans.plan_block(nodes, nodes, wp.float32, effects, 0, False, shared_bytes).on_chip
                for nodes in range(9, 162)
            ]
        else:
            sides, order = range(9, 162), effects.order
            found = [next(plans.strip_plans(order, side, side, wp.float32, shared_bytes), None) for side in sides]
        fits.append({nodes for nodes, plan in enumerate(found, 9) if plan})
    assert all(less <= more for less, more in pairwise(fits))
    assert set() < fits[0] < fits[-1]
