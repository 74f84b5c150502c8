"""Every CUDA kernel compiles to machine code of sm_90, with no driver and no GPU in the machine."""

import ast
import itertools
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import warp as wp

from warp_plate.kernels import (
    energy,
    limits,
    load,
    record,
    resident_lanes,
    resident_strips,
    resident_wide,
    streaming,
    wave,
)
from warp_plate.kernels import moment_form_cuda as general_blocks
from warp_plate.kernels import moment_form_plan as general_plan
from warp_plate.kernels import moment_form_streaming as general_passes
from warp_plate.kernels import temporal_blocking as streaming_march
from warp_plate.kernels.effects import Effects

KERNELS = Path(__file__).parents[2] / "kernels"
# Made for LLVM: launched on CPU only.
CPU_MODULES = ("resident_cpu", "general_cpu")
# Kernels of one order alone.
ORDER_OF = {"resident_lanes": 2, "resident_strips": 2, "streaming_march": 2, "resident_wide": 4}
# Plates for a warp, for a block, and for a block that keeps the sums in shared memory; each with its padded columns.
SMALL, LARGE, LARGEST = (27, 27, 32), (41, 43, 48), (97, 89, 112)
# And one that no multiprocessor holds.
HUGE = (257, 129, 272)


def cuda_kernels(effects, real):
    """Every kernel that is launched on CUDA, by its module and factory; a new one is added here."""
    yield "load.make_spread_drives", load.make_spread_drives(real)
    yield "load.make_spread_moved_drives", load.make_spread_moved_drives(real)
    for either in (False, True):
        yield "load.make_weigh_along", load.make_weigh_along(either)
        yield "wave.make_tones", wave.make_tones(real, either)
    yield "wave.make_running_sums", wave.make_running_sums(real)
    yield "energy.make_sum_along_columns", energy.make_sum_along_columns(real)
    yield "energy.make_sum_columns", energy.make_sum_columns()
    yield "limits.make_multiply_adds", limits.make_multiply_adds(real, block=1, depth=64, rounds=100, compiler_flags="")
    yield "record.advance_clock", record.advance_clock
    yield "record.make_record", record.make_record(real)
    if not effects.plain:
        for kernel in general_passes.make_passes(effects, real):
            yield "general_passes.make_passes", kernel
        hanging = 2 if effects.oscillators else 0
        for nx, ny, stride in (SMALL, HUGE):
            blocks = general_plan.plan(nx, ny, real, effects, hanging, few=False)
            assert blocks.on_chip == bool(blocks.held) == (nx < HUGE[0])
            run = general_blocks.make_run(effects, real, nx, ny, stride, hanging, blocks)
            yield "general_blocks.make_run", run
        return
    yield "streaming.make_bend", streaming.make_bend(effects, real)
    yield "streaming.make_move", streaming.make_move(effects, real)
    for summed in (False, True):
        if effects.order == 4:
            for nx, ny, stride in (SMALL, LARGE):
                wide = resident_wide.plan(nx, ny, real)
                yield "resident_wide.make_run", resident_wide.make_run(effects, real, nx, ny, stride, wide, summed)
            continue
        lanes = resident_lanes.make_run(effects, real, SMALL[1], 0b1100110000, summed)
        yield "resident_lanes.make_run", lanes
        for nx, ny, stride in (LARGE, LARGEST):
            strips = resident_strips.plan(nx, ny, real)
            yield "resident_strips.make_run", resident_strips.make_run(effects, real, nx, ny, stride, strips, summed)
        for levels in (1, 4):
            march = streaming_march.make_march(effects, real, *LARGE, 2, levels, summed, None)
            yield "streaming_march.make_march", march


@cache
def compiles(kernel):
    """Whether it leaves a CUDA binary, which is an ELF file; many mixtures share the same kernel."""
    with TemporaryDirectory() as folder:
        made = wp.compile_aot_module(kernel.module, device=None, arch=90, module_dir=folder, use_ptx=False)
        named = [path.name.endswith(".sm90.cubin") for path in made] == [True]
        return named and made[0].read_bytes().startswith(b"\x7fELF")


def compile_all(effects, real):
    """The names of the kernels compiled."""
    compiled = set()
    for name, kernel in cuda_kernels(effects, real):
        assert compiles(kernel)
        compiled.add(name)
    return compiled


GENERAL = (
    "moments", "material_damping", "tension", "foundation", "stretching", "oscillators", "moving_load"
)  # fmt: skip
# One of each kind; all mixtures are compiled in the slow run.
FEW = [
    (Effects(damping=True, square_cells=True), wp.float32),
    (Effects(damping=True, order=4), wp.float32),
    (Effects(True, True, 2, terms=5, **dict.fromkeys(GENERAL, True)), wp.float64),
]
ALL = [
    (Effects(damping, square, order), real)
    for damping, (square, order), real in itertools.product(
        (False, True), ((False, 2), (True, 2), (True, 4)), (wp.float32, wp.float64)
    )
] + [
    # Each effect of the general plate alone.
    (Effects(moments=True, **{name: True}), real)
    for name in GENERAL[1:]
    for real in (wp.float32, wp.float64)
]


def choice_id(value):
    if isinstance(value, Effects):
        if not value.plain:
            return "general-" + "-".join(name for name, on in vars(value).items() if on is True)
        cells = "square" if value.square_cells else "oblong"
        return f"{'damped' if value.damping else 'undamped'}-{cells if value.order == 2 else 'fourth order'}"
    return value.__name__


@pytest.mark.parametrize(("effects", "real"), FEW, ids=choice_id)
def test_kernels_compile(effects, real):
    assert compile_all(effects, real) == factories(effects)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "real"), [mixture for mixture in ALL if mixture not in FEW], ids=choice_id
)
def test_kernels_compile_in_all_mixtures(effects, real):
    assert compile_all(effects, real) == factories(effects)


def factories(effects):
    """module.function of all in kernels/ that makes a kernel for CUDA or is one, by reading the code."""
    found = set()
    for path in KERNELS.glob("*.py"):
        for function in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(function, ast.FunctionDef):
                decorators = [
                    ast.unparse(decorator)
                    for inner in ast.walk(function)
                    if isinstance(inner, ast.FunctionDef)
                    for decorator in inner.decorator_list
                ]
                if any(decorator.startswith("wp.kernel") for decorator in decorators):
                    found.add(f"{path.stem}.{function.name}")
    made = {name for name in found if not name.startswith(CPU_MODULES)}
    if not effects.plain:
        own = ("streaming.", "streaming_march.", "resident_")
        return {name for name in made if not name.startswith(own)}
    of_order = {name for name in made if ORDER_OF.get(name.split(".")[0], effects.order) == effects.order}
    return {name for name in of_order if not name.startswith("general_")}


def test_a_fault_in_cuda_code_is_found(tmp_path):
    """What this file relies on: code that CUDA's compiler refuses raises, driver or not."""

    @wp.func_native("\nreturn no_such_function(value);\n")
    def broken(value: float) -> float: ...

    @wp.kernel(module="unique")
    def kernel(values: wp.array[float]):
        values[0] = broken(values[0])

    with pytest.raises(Exception, match="CUDA kernel build failed"):
        wp.compile_aot_module(kernel.module, device=None, arch=90, module_dir=tmp_path, use_ptx=False)


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_a_quarter_of_a_multiprocessor_has_room_for_its_warps(real):
    """It has 16384 registers, and takes a fourth of the warps of a block, the last of them whole."""
    effects = Effects(moments=True, material_damping=True, tension=True)
    for nx, ny in itertools.product((9, 17, 28, 33, 53, 65, 81, 105, 113, 129, 160), repeat=2):
        blocks = [general_plan.plan(nx, ny, real, effects, 0, few) for few in (False, True)]
        assert all(one.threads * one.nodes >= nx * ny for one in blocks)
        cut = [plan for plan in (resident_strips.plan(nx, ny, real), resident_wide.plan(nx, ny, real)) if plan]
        shares = [(one.threads, one.registers) for one in blocks] + [(32 * one.warps, one.registers) for one in cut]
        for threads, registers in shares:
            assert -(-threads // 128) * 32 * registers <= 16384
