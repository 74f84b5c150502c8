"""``--devices`` and ``--cluster``: the workers of a command, and what it says of plates that they lost."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.cluster.pool import Pool


def workers(devices: str | None, cluster: str | None, device: str | None) -> AbstractContextManager[Pool | None]:
    """See ``cluster.opening.open_pool``.

    Raises:
        SceneError: also for a device beside several.
    """
    from warp_plate.cluster.opening import open_pool

    if devices is not None and device not in (None, "auto"):
        raise SceneError(f"--device {device}: --devices {devices} says where plates run; leave one of them out")
    return open_pool(devices, cluster, device, output.tell)


def own_device(devices: str | None, cluster: str | None, device: str | None) -> str | None:
    """Where what few plates need runs, in this process: the first of several devices; beside a cluster, whose workers
    the device is of, this machine's own choice (None); else the one that was named."""
    if devices is not None:
        return devices.split(",")[0].strip()
    return device if cluster is None else None


def lost_lines(lost: Mapping[str, int]) -> list[str]:
    """A line for each way in which plates were lost."""
    from warp_plate.scene.vary import counted

    words = "of the search without energies, taken as worst"
    return [f"{counted(count, 'plate')} {words}: {why}" for why, count in lost.items()]
