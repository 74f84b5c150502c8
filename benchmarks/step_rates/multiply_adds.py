"""Peak arithmetic of a device: independent chains of fused multiply-adds in registers.

Not part of the simulation: ``bench.py`` measures with it the limit that the other kernels are compared to.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import portable_kernel


@cache
def make_multiply_adds(real, block, depth, rounds):
    """Make the kernel that applies x ← factor·x + addend to each number, passes · rounds · depth times.

    Launch over the rows of ``numbers``. Each multiply-add waits for the previous one, and other chains fill that time:
    on CPU those of the same block, which LLVM vectorises where rounds = 1; on CUDA those of other threads, with block =
    1 and many rounds.
    """

    @portable_kernel(max_unroll=depth)
    def multiply_add(
        # parameters
        factor: real,
        addend: real,
        passes: int,
        # outputs
        numbers: wp.array2d[real],  # (rows, block)
    ):
        offset = wp.uint64(wp.tid()) * wp.uint64(wp.static(block * wp.types.type_size_in_bytes(real)))
        chains = wp.array(ptr=numbers.ptr + offset, shape=(wp.static(block),), dtype=real)
        for _pass in range(passes):
            for i in range(wp.static(block)):
                x = chains[i]
                for _round in range(wp.static(rounds)):
                    for _step in range(wp.static(depth)):
                        x = factor * x + addend
                chains[i] = x

    return multiply_add
