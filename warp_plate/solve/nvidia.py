"""NVIDIA GPUs: those that the system shows, those that Warp can use, and why it cannot use the others."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from functools import cache
from pathlib import Path

import warp as wp

GUIDE = "https://nvidia.github.io/warp/stable/user_guide/installation.html"
# First branch of NVIDIA's driver that runs programs of a major version of CUDA.
DRIVER_BRANCHES = {12: 525, 13: 580}
# File of a loaded kernel driver, devices of the PCI bus (Linux), and GPUs of Windows in WSL.
KERNEL_DRIVER, PCI_DEVICES = Path("/proc/driver/nvidia"), Path("/sys/bus/pci/devices")
WINDOWS_GPU = Path("/dev/dxg")
NVIDIA, DISPLAY_CONTROLLER = "0x10de", "0x03"


def cuda_devices() -> list[wp.Device]:
    """Return the CUDA devices that Warp finds, also those that it cannot compile for."""
    return list(wp.get_cuda_devices())


def warp_version() -> str:
    """Return the version of Warp, which has metadata only where pip installed it."""
    return str(wp.config.version)


def toolkit_version() -> tuple[int, int] | None:
    """Return the version of CUDA that Warp is built with; None without CUDA."""
    version: tuple[int, int] | None = wp.get_cuda_toolkit_version()
    return version


def driver_version() -> tuple[int, int] | None:
    """Return the newest version of CUDA that the driver runs; None without a driver.

    Warp does not report this for a driver that is too old, or that shows no GPU.
    """
    driver, number = _load_driver(), ctypes.c_int()
    if driver is None or driver.cuDriverGetVersion(ctypes.byref(number)) != 0:
        return None
    return number.value // 1000, number.value % 1000 // 10


def usable_devices() -> list[wp.Device]:
    """Return the CUDA devices that the installed Warp compiles for."""
    return [device for device in wp.get_cuda_devices() if device.arch >= oldest_architecture()]


def oldest_architecture() -> int:
    """Return the lowest compute capability that the installed Warp compiles for, such as 75 for 7.5; 0 without CUDA."""
    return min(wp.get_cuda_supported_archs(), default=0)


def missing_cuda() -> str | None:
    """Return a sentence on why Warp can use no GPU here, with a remedy, or None if it can use one."""
    if usable_devices():
        return None
    if found := wp.get_cuda_devices():
        return too_old(found[0])
    toolkit, driver = toolkit_version(), driver_version()
    if toolkit is None:
        return f"the installed Warp is built without CUDA; other builds: {GUIDE}"
    branch = DRIVER_BRANCHES.get(toolkit[0])
    wanted = f"a driver for CUDA {toolkit[0]}{f' (R{branch} or later)' if branch else ''}"
    if driver is None and KERNEL_DRIVER.exists():
        return "the library of the NVIDIA driver (libcuda) cannot be loaded; start a container with '--gpus all'"
    if driver is None:
        return f"there is no NVIDIA driver; install {wanted}"
    if driver[0] < toolkit[0]:
        other = f", or a Warp for CUDA {driver[0]}: {GUIDE}" if driver[0] in DRIVER_BRANCHES else ""
        versions = f"for CUDA {dotted(driver)}, the installed Warp for {dotted(toolkit)}"
        return f"the NVIDIA driver is {versions}; install {wanted}{other}"
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
    """Return the NVIDIA GPUs that the system shows, whether or not Warp can use them."""
    listings = sorted((KERNEL_DRIVER / "gpus").glob("*/information"))
    models = [line.partition(":")[2].strip() for file in listings for line in _content(file).splitlines()[:1]]
    named = models or [f"NVIDIA GPU at {place.name}" for place in sorted(_gpus_on_bus())]
    windows = sys.platform == "win32" or WINDOWS_GPU.exists()
    return named or (["NVIDIA GPU"] if windows and driver_version() else [])


@cache
def warn_of_unused_gpu() -> None:
    """Log, once in a process, that there is a GPU which Warp cannot use."""
    if (reason := missing_cuda()) and (gpus := visible_gpus()):
        logging.getLogger("warp_plate").warning("%s: not used: %s", "; ".join(gpus), reason)


def _gpus_on_bus() -> list[Path]:
    devices = [place for place in PCI_DEVICES.glob("*") if _content(place / "vendor").strip() == NVIDIA]
    return [place for place in devices if _content(place / "class").startswith(DISPLAY_CONTROLLER)]


def _content(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _load_driver() -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return None


def dotted(version: tuple[int, int]) -> str:
    """Return a version such as "13.0"."""
    return ".".join(map(str, version))
