"""The fused multiply-add by name, for sums that must round alike wherever they are compiled.

The compiler may fuse a·b + c in one of two loops over the same nodes and not in the other; a plate's numbers must not
depend on which of them it takes.
"""

from functools import cache

import warp as wp

_FUSED = {
    wp.float32: "\n#if defined(__CUDA_ARCH__)\nreturn fmaf(a, b, c);\n#else\nreturn __builtin_fmaf(a, b, c);\n#endif\n",
    wp.float64: "\n#if defined(__CUDA_ARCH__)\nreturn fma(a, b, c);\n#else\nreturn __builtin_fma(a, b, c);\n#endif\n",
}


@cache
def make_fused(real):
    """Make ``fused``: a·b + c, rounded once."""

    @wp.func_native(_FUSED[real])
    def fused(a: real, b: real, c: real) -> real: ...

    return fused
