"""The fused multiply-add by name, where it must not be left to the compiler whether a sum is rounded once or twice.

Two loops over the same nodes may be compiled differently; a plate's numbers must not depend on which of them walks it.
"""

from functools import cache

import warp as wp

_FUSED = {
    wp.float32: "\n#if defined(__CUDA_ARCH__)\nreturn fmaf(a, b, c);\n#else\nreturn __builtin_fmaf(a, b, c);\n#endif\n",
    wp.float64: "\n#if defined(__CUDA_ARCH__)\nreturn fma(a, b, c);\n#else\nreturn __builtin_fma(a, b, c);\n#endif\n",
}


@cache
def make_fused(real):
    """a·b + c, rounded once."""

    @wp.func_native(_FUSED[real])
    def fused(a: real, b: real, c: real) -> real: ...

    return fused
