"""A description of the machine that a measurement ran on, and a warning if it is busy."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata

import warp as wp

from warp_plate import __version__
from warp_plate.solve.devices import cpu_threads, find_device, processor_of

# Load average of a minute for each core above which timings are unreliable.
QUIET = 0.3


@dataclass(frozen=True)
class Machine:
    """The machine of a measurement."""

    system: str
    cores: int
    threads: int  # that the simulation uses
    load: float | None  # load average of the minute before; None on systems without it
    devices: Mapping[str, str]  # models by Warp's name of the device


def describe_machine(devices: Sequence[str]) -> Machine:
    """Return the machine with its current load.

    Raises:
        SceneError: there is no such device, or WARP_PLATE_THREADS is not a number of threads.
    """
    threads, models = cpu_threads(), {name: processor_of(find_device(name)) for name in devices}
    models |= {name: f"{model}, {threads} threads" for name, model in models.items() if find_device(name).is_cpu}
    system = f"{platform.system()} {platform.release()} {platform.machine()}"
    return Machine(system, os.cpu_count() or 1, threads, _load_average(), models)


def describe_versions() -> dict[str, str]:
    """Return the versions of Python, this program, Warp, NumPy and CUDA."""
    versions = {"python": platform.python_version(), "warp-plate": __version__}
    versions |= {package: metadata.version(package) for package in ("warp-lang", "numpy")}
    for name, version in (("toolkit", wp.get_cuda_toolkit_version()), ("driver", wp.get_cuda_driver_version())):
        if wp.is_cuda_available() and version:
            versions[f"cuda {name}"] = ".".join(map(str, version))
    return versions


def busy() -> str | None:
    """Return a warning if the load average shows that other programs are running, otherwise None."""
    load, cores = _load_average(), os.cpu_count() or 1
    if load is None or load <= QUIET * cores:
        return None
    return f"this machine is busy (load average {load:g} on {cores} cores): times will be too long"


def _load_average() -> float | None:
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None
