"""How much memory this machine has, and what a scene takes of it: said before it is taken, not found out by a crash."""

from __future__ import annotations

import math
import os
from pathlib import Path

from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# The rest is for the system and for what estimates forget.
SHARE = 0.8
# Bytes a node: regions, fields and copies of them; what the general way has beside; sparse matrices for the limit of
# plates that are not everywhere alike; and the factorised one that compression asks for. Measured in all, with three
# actuators: 110, 590, 840 and 5400.
PLAIN, GENERAL, MATRICES, FACTORISED = 160, 450, 400, 5500
# Of one step: a term of the drive's wave, and a recorded point, each in float64 with what makes it.
TERM, POINT = 64, 96
# Cases of a search that are kept.
CASES = 3
_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def machine_memory() -> float:
    """Bytes that this process may take at most: the machine's, or what a container is allowed; infinite if unknown."""
    known = [math.inf]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        known.append(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    for path in _LIMITS:
        try:
            known.append(float(path.read_text()))
        except (OSError, ValueError):  # no such limit here, or "max"
            continue
    return min(known)


def refuse_beyond_memory(needed: float, what: str) -> None:
    """Nothing, where so many bytes may be taken.

    Raises:
        SceneError: more than SHARE of the machine's; the line begins with ``what``, the keys at fault.
    """
    room = SHARE * machine_memory()
    if needed > room:
        raise SceneError(
            f"{what}: takes about {needed / 2**30:.3g} GiB of memory, and {room / 2**30:.3g} GiB may be taken here"
        )


def check_grid_memory(scene: Scene, moment_form: bool) -> None:
    """Refuse a grid whose fields do not fit; ``moment_form``: whether the scene is more than a plain plate.

    Raises:
        SceneError: see :func:`refuse_beyond_memory`.
    """
    effects, nodes = scene.effects, math.prod(scene.grid.nodes)
    each = PLAIN + 16.0 * (len(scene.actuators) + CASES * len(scene.record.times))
    if moment_form:
        each += GENERAL + 32 * len(effects.oscillators)
        each += MATRICES * bool(effects.layers or effects.oscillators)
        each += FACTORISED * (effects.tension is not None and min(effects.tension.x, effects.tension.y) < 0)
    what = f"grid.nodes = {list(scene.grid.nodes)} with {len(scene.actuators)} actuators"
    times = f" and {len(scene.record.times)} record.times" if scene.record.times else ""
    refuse_beyond_memory(nodes * each, what + times)


def check_steps_memory(scene: Scene, steps: int) -> None:
    """Refuse a run whose drives and traces do not fit.

    Raises:
        SceneError: see :func:`refuse_beyond_memory`.
    """
    own = {actuator.frequency for actuator in scene.actuators}
    terms = (4 * len(own) + 2) if scene.drive.electrostatic is not None else 2 * len(own)
    each = TERM * terms + POINT * CASES * len(scene.record.points)
    moving = scene.effects.moving_load is not None
    each += 24 * sum(scene.grid.nodes) * moving
    beside = f", {len(scene.record.points)} record.points" if scene.record.points else ""
    beside += f", a moving load on {list(scene.grid.nodes)} nodes" if moving else ""
    refuse_beyond_memory(float(steps) * each, f"window.end = {scene.window.end:g}: {steps} steps{beside}")
