"""What a measurement ran on, for the record beside the figures, and whether that machine was quiet."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import warp as wp

from warp_plate import __version__
from warp_plate.solve.devices import cpu_threads, find_device

# Waiting programs for each core, averaged over a minute, above which figures are not to be trusted.
QUIET = 0.3


def describe_machine(devices: Sequence[str]) -> dict[str, object]:
    """Operating system, processor, cores, threads used, load average (None where unknown), and devices by name."""
    return {
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": cpu_threads(),
        "load": _load_average(),
        "devices": {name: find_device(name).name for name in devices},
    }


def describe_versions() -> dict[str, str]:
    """Python, this program, Warp and what compiles and runs its kernels."""
    found = {"python": platform.python_version(), "warp-plate": __version__}
    found |= {package: metadata.version(package) for package in ("warp-lang", "numpy")}
    if wp.is_cuda_available():
        found["cuda toolkit"] = ".".join(map(str, wp.get_cuda_toolkit_version()))
        found["cuda driver"] = ".".join(map(str, wp.get_cuda_driver_version()))
    return found


def busy() -> str | None:
    """A sentence where other programs are running, by the load average; else None."""
    load, cores = _load_average(), os.cpu_count() or 1
    if load is None or load <= QUIET * cores:
        return None
    return f"this machine is busy (load average {load:g} on {cores} cores): expect times that are too long"


def _load_average() -> float | None:
    """Of the last minute; None on systems that keep none."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _processor() -> str:
    """The processor's model; what Python knows of it where the system has no /proc/cpuinfo."""
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
