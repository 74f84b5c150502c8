"""Choice of the device, and the number of cores of the CPU."""

from __future__ import annotations

import contextlib
import os
import platform
import sys
from collections.abc import Iterator
from pathlib import Path

import warp as wp

from warp_plate.scene.errors import SceneError
from warp_plate.solve import nvidia
from warp_plate.solve.kernel_cache import cache_errors

MOST_THREADS = 1024  # each takes memory


def find_device(name: str) -> wp.Device:
    """Return the Warp device of a name; "auto" is the first CUDA device that Warp can use, otherwise the CPU.

    Where "auto" leaves a GPU unused, the logger "warp_plate" gets a warning that says why.

    Raises:
        SceneError: Warp knows no such device here, cannot compile for it, or has no folder to do so.
        ImportError: Warp's library cannot be loaded.
    """
    if wp.config.log_level == wp.LOG_INFO:  # Warp's default, at which it greets on standard output
        wp.config.log_level = wp.LOG_ERROR
    try:
        with _quiet_standard_error(), cache_errors():
            wp.init()
    except RuntimeError as error:  # its library cannot be loaded
        raise ImportError(str(error)) from None
    try:
        with _quiet_standard_error():
            usable = nvidia.usable_devices()
            device = (usable or [wp.get_device("cpu")])[0] if name == "auto" else wp.get_device(name)
    except (ValueError, RuntimeError):
        known = ", ".join(["auto", *(device.alias for device in wp.get_devices())])
        reason = f" ({nvidia.missing_cuda()})" if name.startswith("cuda") and not wp.is_cuda_available() else ""
        raise SceneError(f"device = {name!r}: not on this machine; there are: {known}{reason}") from None
    if device.is_cuda and device not in usable:
        raise SceneError(f"device = {name!r}: {nvidia.too_old(device)}")
    if name == "auto" and device.is_cpu:
        nvidia.warn_of_unused_gpu()
    return device


def device_aliases() -> list[str]:
    """Return Warp's names for the devices of this machine."""
    find_device("cpu")
    return [device.alias for device in wp.get_devices()]


def kernel_folder() -> Path:
    """Return the folder of Warp's cache of compiled kernels."""
    find_device("cpu")
    return Path(str(wp.config.kernel_cache_dir))


def can_compile_for_cpu() -> bool:
    """Return whether Warp has a compiler for the CPU."""
    return bool(wp.is_cpu_available())


def processor_of(device: wp.Device) -> str:
    """Return the model of a device."""
    if device.is_cuda:
        return str(device.name)
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def cpu_threads() -> int:
    """Return the number of threads to use on CPU: WARP_PLATE_THREADS, else the cores that this process may use.

    Raises:
        SceneError: The environment variable is not a whole number from 1 to ``MOST_THREADS``.
    """
    setting = os.environ.get("WARP_PLATE_THREADS", "")
    if setting:
        if not setting.isdecimal() or len(setting) > 4 or not 1 <= int(setting) <= MOST_THREADS:
            raise SceneError(f"WARP_PLATE_THREADS = {setting!r}: must be a whole number from 1 to {MOST_THREADS}")
        return int(setting)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def _quiet_standard_error() -> Iterator[None]:
    """Drop what Warp's C++ side writes where there is no CUDA driver, which is no fault on most machines."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
