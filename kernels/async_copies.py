"""Asynchronous copies of pairs of numbers to shared memory, which Warp's Python lacks.

A register that is loaded ahead of its use is still waited for where the compiler moves it to another one, at the end of
a loop for instance; a copy to shared memory is waited for where it is read. Each lane copies and reads its own pairs,
so no barrier is needed. Places in shared memory are 32-bit addresses in bytes. Before sm_80, copies are synchronous.
"""

from functools import cache

import warp as wp

_SHARED_PLACE = """
#if defined(__CUDA_ARCH__)
return (int)__cvta_generic_to_shared((const void*)address);
#else
return 0;
#endif
"""
_COPY = """
const REAL* pair = (const REAL*)((const char*)address + offset);
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
asm volatile("cp.async.ca.shared.global [%0], [%1], BYTES, %2;" :: "r"(place), "l"(pair), "r"(zeros ? 0 : BYTES));
#elif defined(__CUDA_ARCH__)
const REAL first = zeros ? 0 : pair[0], second = zeros ? 0 : pair[1];
asm volatile("st.shared.v2.KIND [%0], {%1, %2};" :: "r"(place), "REGISTER"(first), "REGISTER"(second) : "memory");
#endif
"""
_COMMIT = """
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
asm volatile("cp.async.commit_group;");
#endif
"""
_WAIT = """
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
asm volatile("cp.async.wait_group PENDING;" ::: "memory");
#endif
"""
_READ = """
REAL first = 0, second = 0;
#if defined(__CUDA_ARCH__)
asm volatile("{.reg .pred wanted; setp.ne.s32 wanted, %3, 0; @wanted ld.shared.v2.KIND {%0, %1}, [%2];}"
  : "+REGISTER"(first), "+REGISTER"(second) : "r"(place), "r"((int)wanted));
#endif
return {first, second};
"""


@wp.func_native(_SHARED_PLACE)
def shared_place(address: wp.uint64) -> int:
    """Return the place at an address in shared memory, see ``cuda.shared_memory``."""


@cache
def make_copies(real, pending):
    """Make functions of a lane's pairs: copy_pair, commit_copies, wait_for_copies, read_pair_if.

    ``copy_pair`` starts to copy the pair at a byte offset from an address, or zeros. ``commit_copies`` makes a group of
    the copies since the last one. ``wait_for_copies`` waits until all groups but the last ``pending`` have arrived.
    ``read_pair_if`` reads a pair, or returns zeros if it is not wanted.
    """
    Pair = wp.types.vector(length=2, dtype=real)
    bits = 8 * wp.types.type_size_in_bytes(real)
    words = {"REAL": "float", "KIND": "f32", "REGISTER": "f"}
    if bits == 64:
        words = {"REAL": "double", "KIND": "f64", "REGISTER": "d"}
    words |= {"BYTES": str(bits // 4), "PENDING": str(pending)}

    def of_kind(source):
        for name, word in words.items():
            source = source.replace(name, word)
        return source

    @wp.func_native(of_kind(_COPY))
    def copy_pair(place: int, address: wp.uint64, offset: int, zeros: bool): ...

    @wp.func_native(_COMMIT)
    def commit_copies(): ...

    @wp.func_native(of_kind(_WAIT))
    def wait_for_copies(): ...

    @wp.func_native(of_kind(_READ))
    def read_pair_if(wanted: bool, place: int) -> Pair: ...

    return copy_pair, commit_copies, wait_for_copies, read_pair_if
