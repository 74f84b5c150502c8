"""What a measurement ran on, for the record beside the figures, and whether that machine was quiet."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata

import warp as wp

from warp_plate import __version__
from warp_plate.solve.devices import cpu_threads, find_device, processor_of

# Waiting programs for each core, averaged over a minute, above which figures are not to be trusted.
QUIET = 0.3


@dataclass(frozen=True)
class Machine:
    """What the figures belong to.

    system: operating system; cores: of the CPU, and threads that are used; load: average of the minute before the
    measurement, None on systems that keep none; devices: models by Warp's name.
    """

    system: str
    cores: int
    threads: int
    load: float | None
    devices: Mapping[str, str]


def describe_machine(devices: Sequence[str]) -> Machine:
    """The machine as it is now.

    Raises:
        SceneError: no such device, or WARP_PLATE_THREADS is no number of threads.
    """
    threads = cpu_threads()
    models = {name: find_device(name) for name in devices}
    return Machine(
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        cores=os.cpu_count() or 1,
        threads=threads,
        load=_load_average(),
        devices={
            name: processor_of(model) + ("" if model.is_cuda else f", {threads} threads")
            for name, model in models.items()
        },
    )


def describe_versions() -> dict[str, str]:
    """Python, this program, Warp and what compiles and runs its kernels."""
    found = {"python": platform.python_version(), "warp-plate": __version__}
    found |= {package: metadata.version(package) for package in ("warp-lang", "numpy")}
    for name, version in (("toolkit", wp.get_cuda_toolkit_version()), ("driver", wp.get_cuda_driver_version())):
        if wp.is_cuda_available() and version:
            found[f"cuda {name}"] = ".".join(map(str, version))
    return found


def busy() -> str | None:
    """A sentence where other programs are running, by the load average; else None."""
    load, cores = _load_average(), os.cpu_count() or 1
    if load is None or load <= QUIET * cores:
        return None
    return f"this machine is busy (load average {load:g} on {cores} cores): expect times that are too long"


def _load_average() -> float | None:
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None
