"""What the arithmetic of a device can do at most: independent chains of fused multiply-adds, kept in registers.

No part of the simulation: ``warp-plate bench`` measures with it the limit that it holds the other kernels against.
"""

from functools import cache

import warp as wp


@cache
def make_multiply_adds(real, block, depth, rounds, compiler_flags):
    """x ← factor·x + addend, passes · rounds · depth times for each number; launch over the rows of ``numbers``.

    numbers: (rows, block); depth: multiply-adds written out one after another, so that the loops around them count for
    little. Each must wait for the one before it, and other chains fill that time: on CPU those of the same block, which
    LLVM turns into vectors where rounds = 1; on CUDA those of other threads, with block = 1 and many rounds.
    """

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": compiler_flags, "max_unroll": depth},
    )
    def multiply_adds(factor: real, addend: real, passes: int, numbers: wp.array2d[real]):
        offset = wp.uint64(wp.tid()) * wp.uint64(wp.static(block * wp.types.type_size_in_bytes(real)))
        chains = wp.array(ptr=numbers.ptr + offset, shape=(wp.static(block),), dtype=real)
        for _again in range(passes):
            for i in range(wp.static(block)):
                x = chains[i]
                for _round in range(wp.static(rounds)):
                    for _step in range(wp.static(depth)):
                        x = factor * x + addend
                chains[i] = x

    return multiply_adds
