"""Every CUDA kernel compiles to machine code, without a driver or a GPU in the machine."""

import ast
import itertools
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import warp as wp

from warp_plate.kernels import (
    energy,
    loads,
    moment_form_blocking,
    moment_form_cuda,
    plans,
    resident_lanes,
    resident_strips,
    streaming,
    temporal_blocking,
    tones,
)
from warp_plate.kernels.plans import cut, strip_plans, whole
from warp_plate.kernels.update import KernelEffects

# Shared memory of a block that kernels may take on sm_90.
SHARED_BYTES = 224 * 1024
KERNELS = Path(__file__).parents[2] / "kernels"
# Plates (nx, ny, stride) for a warp, for a block, in float64 for a block with sums and with rates too in shared memory,
# and for no multiprocessor.
SMALL, LARGE, LARGEST, FULL, HUGE = (27, 27, 32), (41, 43, 48), (97, 89, 112), (105, 97, 112), (257, 129, 272)
ALONE = ("retarded", "in_plane", "springs", "membrane", "attached", "coils", "travelling", "outline")
EVERYTHING = KernelEffects(True, True, 2, terms=5, moments=True, branches=2, **dict.fromkeys(ALONE, True))
FEW = [KernelEffects(True, True, 2), KernelEffects(True, True, 4), EVERYTHING]
PLAIN = itertools.product((False, True), ((False, 2), (True, 2), (True, 4)))
PORTABLE = ("energy.", "loads.", "streaming.", "tones.")
REALS = (wp.float32, wp.float64)
ALL = [KernelEffects(damping, *cells) for damping, cells in PLAIN]
ALL += [EVERYTHING, *(KernelEffects(moments=True, **{name: True}) for name in ALONE)]


KERNELS_ALONE = (
    energy.sum_over_columns, energy.write_energies, streaming.advance_clock, tones.integrate_patches,
    tones.multiply_dense, tones.multiply_sparse, tones.write_drives, tones.write_motions, tones.contract,
)  # fmt: skip


def cuda_kernels(effects, real):
    """Yield (module.factory, function that makes the kernel) for every kernel that is launched on CUDA."""
    for kernel in KERNELS_ALONE:
        yield f"{kernel.func.__module__.rpartition('.')[2]}.{kernel.key}", lambda kernel=kernel: kernel
    for factory, *arguments in cuda_factories(effects, real):
        yield f"{factory.__module__.rpartition('.')[2]}.{factory.__name__}", partial(factory, *arguments)


def cuda_factories(effects, real):
    """Yield the factories of kernels that are launched on CUDA, with arguments; add new ones here."""
    for factory in (loads.make_write_loads, loads.make_write_placed_loads, loads.make_accumulate_waves):
        yield factory, real
    for factory in (energy.make_sum_over_rows, energy.make_keep_largest, streaming.make_record_trace):
        yield factory, real
    for given in REALS:
        yield loads.make_scale_drives, real, given
    for option in (False, True):
        yield loads.make_weigh_spans, option
        yield loads.make_write_tones, real, option
    if not effects.plain:
        oscillators, coils = 2 if effects.attached else 0, 3 if effects.coils else 0
        for nx, ny, stride in (SMALL, HUGE):
            plan = plans.plan_block(nx, ny, real, effects, oscillators + coils, few=False, shared_bytes=SHARED_BYTES)
            assert plan.on_chip == bool(plan.in_registers) == (nx < HUGE[0])
            yield moment_form_cuda.make_run_steps, effects, real, nx, ny, stride, oscillators, plan, coils
        planes = plans.material_planes(effects)
        all_levels = ((1, True), (1, False)) if effects.membrane else ((2, True), (3, True), (1, False))
        for index, (levels, summed) in enumerate(all_levels):
            alike = index % 2 == 1
            yield moment_form_blocking.make_advance_tiles, effects, real, *LARGE, planes, alike, levels, summed
        return
    yield streaming.make_compute_curvature, effects, real
    yield streaming.make_update_nodes, effects, real
    order = effects.order
    if order == 2:
        for summed in (False, True):
            yield resident_lanes.make_run_steps, effects, real, SMALL[1], 0b1100110000, summed
    few = ((SMALL, True), (LARGEST, True), (FULL, True), (LARGE, False), (LARGE, True))
    sizes = {2: few, 4: ((SMALL, False), (LARGE, True))}
    for (nx, ny, stride), summed in sizes[order]:
        plan = next(strip_plans(order, nx, ny, real, SHARED_BYTES))
        if order == 2 and (nx, ny, stride) == SMALL:
            plan = plans.plan_few(nx, ny)
        yield resident_strips.make_run_steps, effects, real, whole(nx), whole(ny), stride, plan, summed
    tiles, margin = {2: (5, 16), 4: (7, 12)}[order]
    axes = cut(HUGE[0], tiles, margin), cut(HUGE[1], 3, margin)
    plan = next(strip_plans(order, axes[0].length, axes[1].length, real, SHARED_BYTES))
    yield resident_strips.make_run_steps, effects, real, *axes, HUGE[2], plan, True
    for levels, summed in ((2, True), (5 if order == 2 else 1, True), (1, False)):
        yield temporal_blocking.make_advance_tiles, effects, real, *LARGE, 4, levels, summed


@cache
def compiles(kernel, binary):
    """Return whether a kernel compiles to a CUDA binary, which is an ELF file, or to PTX; mixtures share kernels."""
    with TemporaryDirectory() as folder:
        (file,) = wp.compile_aot_module(kernel.module, device=None, arch=90, module_dir=folder, use_ptx=not binary)
        return file.read_bytes().startswith(b"\x7fELF") if binary else ".entry" in file.read_text()


@pytest.mark.parametrize("effects", [FEW[0], *(pytest.param(few, marks=pytest.mark.slow) for few in FEW[1:])])
def test_a_kernel_of_each_factory_compiles(effects):
    """The first variant of each, to PTX, which takes a third of the time of a binary; portable ones run on the CPU."""
    seen = set()
    for name, make in cuda_kernels(effects, wp.float32):
        assert name in seen or name.startswith(PORTABLE) or compiles(make(), binary=False), name
        seen.add(name)


@pytest.mark.slow
@pytest.mark.parametrize("effects", ALL)
@pytest.mark.parametrize("real", REALS)
def test_all_kernels_compile(effects, real):
    for name, make in cuda_kernels(effects, real):
        assert compiles(make(), binary=True), name


def test_no_kernel_is_left_out():
    """Every function in kernels/ that makes a kernel, or is one, is compiled for CUDA above or made for the CPU."""
    found = set()
    for path in KERNELS.glob("*.py"):
        for function in ast.parse(path.read_text(encoding="utf-8")).body:
            inner = [node for node in ast.walk(function) if isinstance(node, ast.FunctionDef)]
            if any("kernel(" in ast.unparse(mark) for node in inner for mark in node.decorator_list):
                found.add(f"{path.stem}.{function.name}")
    compiled = {name for effects in FEW for name, _ in cuda_kernels(effects, wp.float32)}
    assert compiled == {name for name in found if not name.startswith(("resident_cpu", "moment_form_cpu"))}


def test_warp_places_tiles_where_the_kernels_expect_them():
    """``kernels/cuda.py`` uses the private name of Warp's shared memory, as it is in Warp 1.19."""
    source = (Path(wp.__file__).parent / "native" / "tile.h").read_text(encoding="utf-8")
    assert "extern __shared__ char dynamic_smem_base[];" in source, f"Warp {wp.__version__}: adapt kernels/cuda.py"


@pytest.mark.parametrize("real", REALS)
def test_a_quarter_of_a_multiprocessor_has_room_for_its_warps(real):
    """It has 16384 registers, and a fourth of the warps of a block, rounded up."""
    effects = KernelEffects(moments=True, retarded=True, in_plane=True)
    for nx, ny in itertools.product((9, 28, 33, 53, 81, 105, 113, 160), repeat=2):
        blocks = [plans.plan_block(nx, ny, real, effects, 0, few, SHARED_BYTES) for few in (False, True)]
        assert all(plan.threads * plan.nodes >= nx * ny for plan in blocks)
        strips = [next(strip_plans(order, nx, ny, real, SHARED_BYTES), None) for order in (2, 4)]
        shares = [(plan.threads, plan.registers) for plan in blocks]
        shares += [(32 * plan.warps, plan.registers) for plan in strips if plan]
        for threads, registers in shares:
            assert -(-threads // 128) * 32 * registers <= 16384
