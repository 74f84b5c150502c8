"""NVIDIA GPUs: those that the system shows, those that Warp can use, and why it cannot use the others."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

import warp as wp

GUIDE = "https://nvidia.github.io/warp/stable/user_guide/installation.html"
# First branch of NVIDIA's driver that runs programs of a major version of CUDA.
DRIVER_BRANCHES = {12: 525, 13: 580}
# Loaded kernel driver, and devices of the PCI bus (Linux).
KERNEL_DRIVER, PCI_DEVICES = Path("/proc/driver/nvidia/version"), Path("/sys/bus/pci/devices")
NVIDIA, DISPLAY_CONTROLLER = "0x10de", "0x03"
# Longest time to wait for nvidia-smi [s].
TIMEOUT = 20.0


def cuda_devices() -> list[wp.Device]:
    """Return the CUDA devices that Warp finds, also those that it cannot compile for."""
    return list(wp.get_cuda_devices())


def toolkit_version() -> str | None:
    """Return the version of CUDA that Warp is built with, such as "13.0"; None without CUDA."""
    return _dotted(wp.get_cuda_toolkit_version())


def driver_version() -> str | None:
    """Return the newest version of CUDA that the driver runs; None without a driver."""
    return _dotted(wp.get_cuda_driver_version())


def usable_devices() -> list[wp.Device]:
    """Return the CUDA devices that the installed Warp compiles for."""
    return [device for device in wp.get_cuda_devices() if device.arch >= oldest_architecture()]


def oldest_architecture() -> int:
    """Return the lowest compute capability that the installed Warp compiles for, such as 75 for 7.5; 0 without CUDA."""
    return min(wp.get_cuda_supported_archs(), default=0)


def missing_cuda() -> str | None:
    """Return a sentence on why Warp can use no GPU here and what helps, or None if it can use one."""
    if usable_devices():
        return None
    if found := wp.get_cuda_devices():
        return too_old(found[0])
    toolkit, driver = wp.get_cuda_toolkit_version(), wp.get_cuda_driver_version()
    if toolkit is None:
        return f"the installed Warp is built without CUDA; other builds: {GUIDE}"
    branch = DRIVER_BRANCHES.get(toolkit[0])
    wanted = f"a driver for CUDA {toolkit[0]}{f' (R{branch} or later)' if branch else ''}"
    if driver is None and KERNEL_DRIVER.exists():
        return "the library of the NVIDIA driver (libcuda) cannot be loaded; start a container with '--gpus all'"
    if driver is None:
        return f"there is no NVIDIA driver; install {wanted}"
    if driver[0] < toolkit[0]:
        return (
            f"the NVIDIA driver is for CUDA {driver_version()}, the installed Warp for {toolkit_version()}; install "
            f"{wanted}, or a Warp for CUDA {driver[0]}: {GUIDE}"
        )
    hidden = os.environ.get("CUDA_VISIBLE_DEVICES")
    cause = "see 'nvidia-smi'" if hidden is None else f"CUDA_VISIBLE_DEVICES is {hidden!r}: unset it"
    return f"the NVIDIA driver shows no GPU; {cause}"


def too_old(device: wp.Device) -> str:
    """Return a sentence on a device whose compute capability is too low for the installed Warp."""
    own, least = (f"{arch // 10}.{arch % 10}" for arch in (device.arch, oldest_architecture()))
    return (
        f"{device.name} has compute capability {own}, and the installed Warp needs {least}; install a Warp for an "
        f"older CUDA: {GUIDE}"
    )


def visible_gpus() -> list[str]:
    """Return the NVIDIA GPUs that the system shows, whether or not Warp can use them, with their driver if known."""
    return _gpus_of_driver() or [f"NVIDIA GPU at {place.name}" for place in sorted(_gpus_on_bus())]


@cache
def warn_of_unused_gpu() -> None:
    """Log, once in a process, that there is a GPU which Warp cannot use."""
    if (reason := missing_cuda()) and (gpus := visible_gpus()):
        logging.getLogger("warp_plate").warning("%s: not used: %s", "; ".join(gpus), reason)


def _gpus_of_driver() -> list[str]:
    program = shutil.which("nvidia-smi")
    if program is None:
        return []
    query = [program, "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        answer = subprocess.run(query, capture_output=True, text=True, errors="replace", timeout=TIMEOUT)
    except (OSError, subprocess.TimeoutExpired):
        return []
    lines = answer.stdout.splitlines() if answer.returncode == 0 else []
    return [line.replace(", ", ", driver ") for line in lines if line]


def _gpus_on_bus() -> list[Path]:
    def content(file: Path) -> str:
        return file.read_text() if file.exists() else ""

    devices = [place for place in PCI_DEVICES.glob("*") if content(place / "vendor").strip() == NVIDIA]
    return [place for place in devices if content(place / "class").startswith(DISPLAY_CONTROLLER)]


def _dotted(version: tuple[int, int] | None) -> str | None:
    return version and ".".join(map(str, version))
