"""The primitives that the CUDA paths need and Warp's Python has no word for, each one line of CUDA.

They are for CUDA: on CPU, where a block has one thread, ``barrier`` and ``anew`` do nothing and the others are missing.
"""

from functools import cache

import warp as wp

_FROM_LANE = "\nreturn __shfl_sync(0xffffffffu, value, lane);\n"
_BARRIER = "\n#if defined(__CUDA_ARCH__)\n__syncthreads();\n#endif\n"
_ANEW = """
#if defined(__CUDA_ARCH__)
asm volatile("" : "+r"(value));
__builtin_assume(value >= 0);
#endif
return value;
"""
_SHARED_MEMORY = "\nextern __shared__ char dynamic_smem_base[]; return (wp::uint64)dynamic_smem_base;\n"

LANES = 32
# Of one multiprocessor of sm_90: its quarters, which share out the warps among them, the registers of each quarter, the
# most that a thread can hold, and bytes of shared memory a block can take.
QUARTERS, REGISTERS, THREAD_REGISTERS, SHARED_BYTES = 4, 16384, 255, 224 * 1024


def most_registers(warps):
    """Registers that a thread can have where so many warps share a multiprocessor; the fullest quarter decides."""
    return min(THREAD_REGISTERS, REGISTERS // (LANES * -(-warps // QUARTERS)) // 8 * 8)


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


@wp.func_native(_ANEW)
def anew(value: int) -> int:
    """A value of at least zero, of which the compiler knows nothing more: it works out what follows where it stands.

    Else all that a loop makes of numbers from before it is made before it, in more registers than there are.
    """
    ...
