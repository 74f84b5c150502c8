"""CUDA primitives that Warp's Python lacks, and the registers of a multiprocessor.

On CPU, where a block has one thread, ``barrier`` and ``opaque`` do nothing and the others are not available.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.update import make_laplacian

_OPAQUE = """
#if defined(__CUDA_ARCH__)
asm volatile("" : "+r"(value));
__builtin_assume(value >= 0);
#endif
return value;
"""
# Private to Warp (as of 1.19): the array in which its generated code places tiles in shared memory.
_SHARED_MEMORY = "\nextern __shared__ char dynamic_smem_base[]; return (wp::uint64)dynamic_smem_base;\n"

# Threads of a warp.
LANES = 32
# A multiprocessor, from sm_75 on: its warps are distributed over four quarters, each with its own registers.
QUARTERS = 4
QUARTER_REGISTERS = 16384
THREAD_REGISTERS = 255
# Shared memory of a block that Warp's tiles and the driver may take.
RESERVED_BYTES = 3072


def most_registers(warps):
    """Return the registers available to a thread where so many warps share a multiprocessor, by its fullest quarter."""
    return min(THREAD_REGISTERS, QUARTER_REGISTERS // (LANES * -(-warps // QUARTERS)) // 8 * 8)


def cuda_kernel(registers, max_unroll):
    """Return the decorator of kernels with a thread for each index and at most so many registers per thread."""
    options = {"max_unroll": max_unroll}
    return wp.kernel(
        module="unique", enable_backward=False, grid_stride=False, cuda_max_registers=registers, module_options=options
    )


@cache
def make_from_lane(real):
    """Make ``from_lane``: the value that ``lane`` of the same warp passes in. All 32 lanes must call it together."""

    @wp.func_native("\nreturn __shfl_sync(0xffffffffu, value, lane);\n")
    def from_lane(value: real, lane: int) -> real: ...

    return from_lane


@cache
def make_laplacian_of_row(square_cells, real, columns, bounded):
    """Make ``laplacian_of_row``: of a lane's part; ``bounded``: there are zeros beyond the first and the last lane."""
    laplacian, from_lane = make_laplacian(square_cells, real), make_from_lane(real)
    Row = wp.types.vector(length=columns, dtype=real)

    @wp.func
    def laplacian_of_row(south: Row, centre: Row, north: Row, lane: int, aspect: real):
        west = from_lane(centre[wp.static(columns - 1)], lane - 1)
        east = from_lane(centre[0], lane + 1)
        if wp.static(bounded):
            if lane == 0:
                west = real(0.0)
            if lane == wp.static(LANES - 1):
                east = real(0.0)
        sums = Row()
        for c in range(wp.static(columns)):
            left = west
            right = east
            if wp.static(c > 0):
                left = centre[c - 1]
            if wp.static(c < columns - 1):
                right = centre[c + 1]
            sums[c] = laplacian(centre[c], left, right, south[c], north[c], aspect)
        return sums

    return laplacian_of_row


@cache
def make_apply_taps(real, columns):
    """Make ``apply_taps``: the sum of taps along x and y for a lane's part of a row, from its own and four rows more.

    a … e are the rows from the lowest on; the newest, e, is added last. All 32 lanes must call it together.
    """
    from_lane, fused = make_from_lane(real), make_fused(real)
    Taps = wp.types.vector(length=5, dtype=real)
    ColumnTaps = wp.types.matrix(shape=(columns, 5), dtype=real)
    Row = wp.types.vector(length=columns, dtype=real)
    Around = wp.types.vector(length=columns + 4, dtype=real)

    @wp.func
    def apply_taps(a: Row, b: Row, centre: Row, d: Row, e: Row, taps_x: ColumnTaps, taps_y: Taps, lane: int):
        around = Around()
        if wp.static(columns == 1):
            around[0] = from_lane(centre[0], lane - 2)
            around[1] = from_lane(centre[0], lane - 1)
            around[3] = from_lane(centre[0], lane + 1)
            around[4] = from_lane(centre[0], lane + 2)
        else:
            around[0] = from_lane(centre[wp.static(columns - 2)], lane - 1)
            around[1] = from_lane(centre[wp.static(columns - 1)], lane - 1)
            around[wp.static(columns + 2)] = from_lane(centre[0], lane + 1)
            around[wp.static(columns + 3)] = from_lane(centre[wp.static(min(1, columns - 1))], lane + 1)
        for c in range(wp.static(columns)):
            around[c + 2] = centre[c]
        total = Row()
        for c in range(wp.static(columns)):
            for tap in range(5):
                total[c] = fused(taps_x[c, tap], around[c + tap], total[c])
            total[c] = fused(taps_y[0], a[c], total[c])
            total[c] = fused(taps_y[1], b[c], total[c])
            total[c] = fused(taps_y[2], centre[c], total[c])
            total[c] = fused(taps_y[3], d[c], total[c])
            total[c] = fused(taps_y[4], e[c], total[c])
        return total

    return apply_taps


@cache
def make_pairs(real):
    """Make ``read_pair`` and ``write_pair`` of two neighbouring numbers at an address that is a multiple of their size.

    One access instead of two.
    """
    Pair = wp.types.vector(length=2, dtype=real)
    name = "float2" if real is wp.float32 else "double2"

    @wp.func_native(f"\nconst {name} pair = *(const {name}*)address;\nreturn {{pair.x, pair.y}};\n")
    def read_pair(address: wp.uint64) -> Pair: ...

    @wp.func_native(f"\n*({name}*)address = make_{name}(pair[0], pair[1]);\n")
    def write_pair(address: wp.uint64, pair: Pair): ...

    return read_pair, write_pair


@cache
def make_thread_part(real, length):
    """Make ``thread_part``: ``length`` numbers of a field from a byte offset on."""

    @wp.func
    def thread_part(field: wp.array3d[real], offset: wp.uint64):
        return wp.array(ptr=field.ptr + offset, shape=(wp.static(length),), dtype=real)

    return thread_part


@wp.func_native("\nreturn __any_sync(0xffffffffu, condition);\n")
def any_lane(condition: bool) -> bool:
    """Return whether the condition holds in a lane of the warp: the compiler then knows that all take one branch."""


@wp.func_native("\n#if defined(__CUDA_ARCH__)\n__syncthreads();\n#endif\n")
def barrier():
    """Wait for all threads of the block and order their accesses to shared memory."""


@wp.func_native(_SHARED_MEMORY)
def shared_memory() -> wp.uint64:
    """Return the address of the block's shared memory, which is as large as the tiles that the kernel allocates."""


@wp.func_native(_OPAQUE)
def opaque(value: int) -> int:
    """Return a number ≥ 0 about which the compiler can assume nothing else.

    Keeps what is computed from it inside the loop where it is used; hoisted out of the loop, it would take more
    registers than there are.
    """
