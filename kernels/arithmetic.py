"""Arithmetic that Warp's Python lacks: fused multiply-adds by name, flushing of denormals, and compiler flags.

The compiler may fuse a·b + c in one of two loops over the same nodes and not in the other; a plate's numbers must not
depend on which of them it takes.

Ahead of a wave front the displacement of a plate at rest fades faster than any power, through numbers below 1e-38
(float32) or 1e-308 (float64). They are too small to matter, but an x86 CPU is a hundred times slower with them.
"""

import platform
from functools import cache

import warp as wp

# Flags with which LLVM compiles for the CPU: whole vectors and fused multiply-adds. All kernels share them, because
# Warp compiles its headers anew for each set of flags, which takes longer than most kernels.
CPU_FLAGS = "-march=native -ffp-contract=fast -mllvm=-force-vector-interleave=4" + (
    " -mprefer-vector-width=512" if platform.machine().lower() in ("x86_64", "amd64") else ""
)
_FUSED = {
    wp.float32: "\n#if defined(__CUDA_ARCH__)\nreturn fmaf(a, b, c);\n#else\nreturn __builtin_fmaf(a, b, c);\n#endif\n",
    wp.float64: "\n#if defined(__CUDA_ARCH__)\nreturn fma(a, b, c);\n#else\nreturn __builtin_fma(a, b, c);\n#endif\n",
}
# MXCSR register: flush results to zero (bit 15), read denormal operands as zero (bit 6).
_FLUSH = """
#if defined(__x86_64__) && !defined(__CUDA_ARCH__)
unsigned int before = __builtin_ia32_stmxcsr();
__builtin_ia32_ldmxcsr(before | 0x8040u);
return (int)before;
#else
return 0;
#endif
"""
_RESTORE = """
#if defined(__x86_64__) && !defined(__CUDA_ARCH__)
__builtin_ia32_ldmxcsr((unsigned int)before);
#endif
"""


@cache
def make_fused(real):
    """Make ``fused``: a·b + c, rounded once."""

    @wp.func_native(_FUSED[real])
    def fused(a: real, b: real, c: real) -> real: ...

    return fused


@wp.func_native(_FLUSH)
def flush_denormals() -> int:
    """Flush denormals of the calling thread from here on; return the previous mode for ``restore_denormals``."""


@wp.func_native(_RESTORE)
def restore_denormals(before: int):
    """Restore the mode that ``flush_denormals`` returned."""


def portable_kernel(**options):
    """Return the decorator of kernels that compile for the CPU and for CUDA, with these options of Warp's modules.

    ``block_dim=1``, as all launches on a CPU have, spares kernels for CPUs that Warp hashes their source twice.
    """
    flags = {"cpu_compiler_flags": CPU_FLAGS}
    return wp.kernel(module="unique", enable_backward=False, module_options=flags | options)
