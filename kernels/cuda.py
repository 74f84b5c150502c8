"""The primitives that the CUDA paths need and Warp's Python has no word for, each one line of CUDA.

They exist on CUDA only: a kernel that calls one of them must never be launched on CPU.
"""

from functools import cache

import warp as wp

_FROM_LANE = "\nreturn __shfl_sync(0xffffffffu, value, lane);\n"
_BARRIER = "\n__syncthreads();\n"
_SHARED_MEMORY = "\nextern __shared__ char dynamic_smem_base[]; return (wp::uint64)dynamic_smem_base;\n"

LANES = 32


@cache
def make_from_lane(real):
    """The value that ``lane`` of the same warp passes in; all 32 lanes must call together."""

    @wp.func_native(_FROM_LANE)
    def from_lane(value: real, lane: int) -> real: ...

    return from_lane


@wp.func_native(_BARRIER)
def barrier():
    """Waits for all threads of the block; orders their accesses to shared memory."""
    ...


@wp.func_native(_SHARED_MEMORY)
def shared_memory() -> wp.uint64:
    """Address of the block's shared memory; its size is that of the tiles that the kernel takes."""
    ...
