"""What the arithmetic of a device can do at most: independent chains of fused multiply-adds, kept in registers.

No part of the simulation: ``warp-plate bench`` measures with it the limit that it holds the other kernels against.
"""

from functools import lru_cache

import warp as wp

# Multiply-adds written out one after another: what is spent on the loops around them then counts for nothing.
DEPTH = 32


@lru_cache(maxsize=None)
def make_multiply_adds(real, block, rounds, compiler_flags):
    """x ← factor·x + addend, DEPTH·rounds times for each number; launch over (blocks,) of ``block`` numbers each.

    Independent chains hide the time that one multiply-add takes: on CPU the ``block`` of one launch index, which LLVM
    turns into vectors where rounds = 1; on CUDA the many threads, with block = 1 and many rounds.
    """

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": compiler_flags, "max_unroll": DEPTH},
    )
    def multiply_adds(factor: real, addend: real, numbers: wp.array2d[real]):
        size = wp.uint64(wp.static(block * wp.types.type_size_in_bytes(real)))
        part = wp.array(ptr=numbers.ptr + wp.uint64(wp.tid()) * size, shape=(wp.static(block),), dtype=real)
        for i in range(wp.static(block)):
            x = part[i]
            for _round in range(wp.static(rounds)):
                for _step in range(wp.static(DEPTH)):
                    x = factor * x + addend
            part[i] = x

    return multiply_adds
