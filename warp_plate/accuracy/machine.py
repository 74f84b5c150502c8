"""The machine of a measurement: its description, a warning if it is busy, and the plates that its GPUs hold."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata

import warp as wp

from warp_plate._version import __version__
from warp_plate.kernels.cuda import RESERVED_BYTES
from warp_plate.kernels.plans import plan_block, strip_plans
from warp_plate.kernels.update import KernelEffects
from warp_plate.plate.discretization import discretize
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import cpu_threads, find_device, processor_of
from warp_plate.solve.parts import CUDA_MEMORY_SHARE
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import bytes_per_plate

# Load average of a minute for each core above which timings are unreliable.
QUIET = 0.3
# Nodes along a side that are tried.
SIDES = range(5, 1024)


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


def largest_resident_sides(device: wp.Device) -> dict[str, int]:
    """Return the nodes along a side of the largest square float32 plate that fits on a chip, by kind of plate."""
    shared = device.max_shared_memory_per_block - RESERVED_BYTES
    free_edges = KernelEffects(moments=True)
    kinds: dict[str, Callable[[int], object]] = {
        "order 2": lambda side: next(strip_plans(2, side, side, wp.float32, shared), None),
        "order 4": lambda side: next(strip_plans(4, side, side, wp.float32, shared), None),
        "free edges": lambda side: plan_block(side, side, wp.float32, free_edges, 0, False, shared).on_chip,
    }
    return {kind: max(filter(fits, SIDES), default=0) for kind, fits in kinds.items()}


def plates_in_memory(scene: Scene, device: wp.Device) -> int:
    """Return how many plates of a scene fit in the free memory of a CUDA device at a time."""
    specialized = Specialized(discretize(scene), device)
    return int(CUDA_MEMORY_SHARE * device.free_memory / bytes_per_plate(specialized, 0))


def _load_average() -> float | None:
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None
