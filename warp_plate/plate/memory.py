"""Memory of this machine, and estimates of the memory of a scene, to refuse scenes that are too large."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

from warp_plate.effects.effect import attachments
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Fraction of the memory that a scene may take; the rest is for the system and for errors of the estimates.
SHARE = 0.8
# Bytes per node: of regions, fields and copies; more in moment form; of sparse matrices for the limit of inhomogeneous
# plates; and of the factorised one for compression. Measured in all, with three actuators: 110, 590, 840 and 5400.
PLAIN, MOMENT_FORM, MATRICES, FACTORISED = 160, 450, 400, 5500
# Bytes per step: of a term of the drive's wave, and of a recorded point.
TERM, POINT = 64, 96
# Cases of a search with records.
CASES = 3
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


def grid_bytes(scene: Scene, moment_form: bool) -> float:
    """Return the bytes of a scene's fields."""
    terms, nodes = scene.terms, math.prod(scene.grid.nodes)
    bytes_a_node = PLAIN + 16.0 * (len(scene.actuators) + CASES * len(scene.record.times))
    if moment_form:
        attached = [*attachments(terms), *scene.coil_indices]
        bytes_a_node += MOMENT_FORM + 32 * len(attached)
        bytes_a_node += MATRICES * bool(scene.layers or attached)
        bytes_a_node += FACTORISED * any(term.role == "stiffness" and term.coefficient < 0 for term in terms)
    return nodes * bytes_a_node


def check_grid_memory(scene: Scene, moment_form: bool) -> None:
    """Refuse a grid with fields that do not fit."""
    times = f" and {len(scene.record.times)} record.times" if scene.record.times else ""
    what = f"grid.nodes = {list(scene.grid.nodes)} with {len(scene.actuators)} actuators{times}"
    refuse_beyond_memory(grid_bytes(scene, moment_form), what)


def steps_bytes(scene: Scene, steps: int) -> float:
    """Return the bytes of a run's drives and traces."""
    frequencies = len({actuator.frequency for actuator in scene.actuators})
    terms = 2 * frequencies if scene.drive.electrostatic is None else 4 * frequencies + 2
    bytes_a_step = TERM * terms + POINT * CASES * len(scene.record.points)
    if scene.effects.travelling is not None:
        bytes_a_step += 24 * sum(scene.grid.nodes)
    return float(steps) * bytes_a_step


def check_steps_memory(scene: Scene, steps: int) -> None:
    """Refuse a run with drives and traces that do not fit."""
    beside = f", {len(scene.record.points)} record.points" if scene.record.points else ""
    if scene.effects.travelling is not None:
        beside += f", a moving load on {list(scene.grid.nodes)} nodes"
    refuse_beyond_memory(steps_bytes(scene, steps), f"window.end = {scene.window.end:g}: {steps} steps{beside}")
