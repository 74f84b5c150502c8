"""Processor, GPU and versions of a measurement, for its record."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from importlib import metadata
from pathlib import Path

PACKAGES = (
    "warp-plate", "warp-lang", "numpy", "scipy", "numba", "llvmlite", "jax", "jaxlib", "jax-cuda13-plugin",
    "jax-cuda12-plugin", "cupy-cuda13x", "cupy-cuda12x", "torch", "triton",
)  # fmt: skip


def machine() -> dict[str, object]:
    """Operating system, processor, usable cores, how busy they are, and GPU (None where there is none)."""
    return {
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "processor": processor(),
        "cores": usable_cores(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "gpu": gpu(),
    }


def usable_cores() -> int:
    """Cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor() -> str:
    """The processor's model name; what Python knows of it where the system has no /proc/cpuinfo."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def gpu() -> str | None:
    """Name and driver of the first NVIDIA GPU."""
    return first_line("nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader")


def versions() -> dict[str, str]:
    """Python, the C compiler and each package that is installed."""
    found = {"python": platform.python_version()}
    compiler = first_line("gcc", "--version")
    if compiler:
        found["gcc"] = compiler
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def first_line(*command: str) -> str | None:
    """The first line that a program prints; None where it is absent, fails or prints nothing."""
    if shutil.which(command[0]) is None:
        return None
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = done.stdout.splitlines()
    return lines[0].strip() if done.returncode == 0 and lines else None
