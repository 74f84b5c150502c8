"""Flushing of denormal numbers to zero while a kernel runs on an x86 CPU, where they are a hundred times slower.

Ahead of a wave front the displacement of a plate at rest fades faster than any power, through numbers below 1e-38
(float32) or 1e-308 (float64). They are too small to matter. Other processors handle them at full speed.
"""

import warp as wp

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


@wp.func_native(_FLUSH)
def flush_denormals() -> int:
    """Flush denormals of the calling thread from here on; return the previous mode for ``restore_denormals``."""
    ...


@wp.func_native(_RESTORE)
def restore_denormals(before: int):
    """Restore the mode that ``flush_denormals`` returned."""
    ...
