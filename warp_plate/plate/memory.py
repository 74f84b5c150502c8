"""Memory of this machine, to refuse what takes more."""

import math
import os
from contextlib import suppress
from pathlib import Path

from warp_plate.scene.errors import SceneError

# Fraction of the memory that a scene may take; the rest is for the system and for errors of the estimates.
SHARE = 0.8
_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def machine_memory() -> float:
    """Return the bytes that this process may take, the machine's or a container's, or that its limit of address space
    (``ulimit -v``) leaves; infinite if unknown."""
    limit = math.inf
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        limit = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    for path in _LIMITS:
        with suppress(OSError, ValueError):  # no such limit here, or "max"
            limit = min(limit, float(path.read_text()))
    with suppress(ImportError, OSError):  # no such limits, or no /proc
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            limit = min(limit, max(0.0, float(most) - pages * resource.getpagesize()))
    return limit


def memory_room() -> float:
    """Return the bytes that a scene may take."""
    return SHARE * machine_memory()


def refuse_beyond_memory(needed: float, what: str) -> None:
    """Raise a SceneError that begins with the keys at fault if ``needed`` bytes are more than SHARE of the memory."""
    room = memory_room()
    if needed > room:
        raise SceneError(
            f"{what}: takes about {needed / 2**30:.3g} GiB of memory, and {room / 2**30:.3g} GiB may be taken here"
        )
