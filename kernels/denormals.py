"""Numbers next to zero, flushed to it while a kernel runs on an x86 CPU, which takes a hundred times as long for them.

A wave runs out from its actuator with a front that fades faster than any power: beyond it a plate at rest passes
through numbers too small for a full mantissa, below 1e-38 of one in float32 and 1e-308 in float64. They change nothing
that is seen. Other processors are as fast with them.
"""

import warp as wp

# MXCSR: flush results to zero (bit 15), take denormal operands as zero (bit 6).
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
    """From here on the calling thread's tiny numbers are zeros; returns what ``restore_denormals`` takes."""
    ...


@wp.func_native(_RESTORE)
def restore_denormals(before: int):
    """Back to how it was."""
    ...
