"""Choice of the device, GPUs that Warp cannot use, the cores of the CPU, and the folder of compiled kernels."""

import contextlib
import json
import logging
import os
import platform
import sys
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import warp as wp

from warp_plate.scene.errors import SceneError, check_type

MOST_THREADS = 1024  # each takes memory
WARP_GUIDE = "https://nvidia.github.io/warp/stable/user_guide/installation.html"
# Lock for Warp's start and its kernels, which only one thread at a time may make and load.
LOADING = threading.RLock()
# Where the kernel driver of Linux lists the NVIDIA GPUs.
GPU_LISTINGS = Path("/proc/driver/nvidia/gpus")


def find_device(name: str) -> wp.Device:
    """Return the Warp device of a name; "auto" is the first CUDA device that Warp can use, otherwise the CPU.

    Where "auto" leaves a GPU unused, the logger "warp_plate" gets a warning that says why.

    Raises:
        SceneError: Warp knows no such device here, cannot compile for it, or has no folder to do so.
        ImportError: Warp's library cannot be loaded.
    """
    check_type("device", name, str)
    if wp.config.log_level == wp.LOG_INFO:  # Warp's default, at which it greets on standard output
        wp.config.log_level = wp.LOG_ERROR
    try:
        with _quiet_standard_error(), cache_errors():
            wp.init()
    except RuntimeError as error:  # its library cannot be loaded
        raise ImportError(str(error)) from None
    try:
        with _quiet_standard_error():
            usable = usable_devices()
            device = (usable or [wp.get_device("cpu")])[0] if name == "auto" else wp.get_device(name)
    except (ValueError, RuntimeError):
        known = ", ".join(["auto", *(device.alias for device in wp.get_devices())])
        reason = f" ({missing_cuda()})" if name.startswith("cuda") and not wp.is_cuda_available() else ""
        raise SceneError(f"device = {name!r}: not on this machine; there are: {known}{reason}") from None
    if device.is_cuda and device not in usable:
        raise SceneError(f"device = {name!r}: {too_old(device)}")
    if name == "auto" and device.is_cpu:
        _warn_of_unused_gpu()
    return device


def cuda_devices() -> list[wp.Device]:
    """Return the CUDA devices that Warp finds, also those that it cannot compile for."""
    return list(wp.get_cuda_devices())


def usable_devices() -> list[wp.Device]:
    """Return the CUDA devices that the installed Warp compiles for."""
    return [device for device in wp.get_cuda_devices() if device.arch >= _oldest_architecture()]


def _oldest_architecture() -> int:
    """Return the lowest compute capability that the installed Warp compiles for, such as 75 for 7.5; 0 without CUDA."""
    return min(wp.get_cuda_supported_archs(), default=0)


def describe_warp() -> str:
    """Return the version of Warp, and of the CUDA that it is built with."""
    toolkit = wp.get_cuda_toolkit_version()
    return f"{wp.config.version}, {f'for CUDA {toolkit[0]}.{toolkit[1]}' if toolkit else 'without CUDA'}"


def describe_driver() -> str:
    """Return the newest version of CUDA that the driver of a GPU runs."""
    major, minor = wp.get_cuda_driver_version() or (0, 0)
    return f"driver for CUDA {major}.{minor}"


def missing_cuda() -> str | None:
    """Return a sentence on why Warp can use no GPU here, with a remedy, or None if it can use one."""
    if usable_devices():
        return None
    if devices := wp.get_cuda_devices():
        return too_old(devices[0])
    toolkit = wp.get_cuda_toolkit_version()
    if toolkit is None:
        return f"the installed Warp is built without CUDA; other builds: {WARP_GUIDE}"
    return (
        f"Warp finds no GPU with a driver for CUDA {toolkit[0]} or later; see 'nvidia-smi', CUDA_VISIBLE_DEVICES, and "
        f"in a container '--gpus all'; builds of Warp for older drivers: {WARP_GUIDE}"
    )


def too_old(device: wp.Device) -> str:
    """Return a sentence on a device whose compute capability is too low for the installed Warp."""
    capability, least = (f"{arch // 10}.{arch % 10}" for arch in (device.arch, _oldest_architecture()))
    return (
        f"{device.name} has compute capability {capability}, and the installed Warp needs {least}; install a Warp for "
        f"an older CUDA: {WARP_GUIDE}"
    )


def visible_gpus() -> list[str]:
    """Return the models of the NVIDIA GPUs that the system lists, whether or not Warp can use them."""
    listings = sorted(GPU_LISTINGS.glob("*/information"))
    return [file.read_text(encoding="utf-8").split("\n", 1)[0].partition(":")[2].strip() for file in listings]


@cache
def _warn_of_unused_gpu() -> None:
    """Log, once in a process, that there is a GPU which Warp cannot use."""
    if (reason := missing_cuda()) and (gpus := visible_gpus()):
        logging.getLogger("warp_plate").warning("%s: not used: %s", "; ".join(gpus), reason)


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
    if sys.stderr is None:  # closed
        yield
        return
    with LOADING:
        sys.stderr.flush()
        saved = os.dup(2)
        try:
            with open(os.devnull, "w") as nowhere:
                os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)


@contextlib.contextmanager
def cache_errors() -> Iterator[None]:
    """Name the cache, and how to choose another, in errors of its files."""
    try:
        yield
    except (OSError, UnicodeEncodeError) as error:  # the latter of folders whose name is not UTF-8
        reason = getattr(error, "strerror", None) or error
        folder = wp.config.kernel_cache_dir or getattr(error, "filename", None) or "the working folder"
        raise SceneError(
            f"{folder}: cannot keep compiled kernels: {reason}; WARP_CACHE_PATH can name another folder"
        ) from None


def load_kernel(kernel: wp.Kernel, device: wp.Device, block_dim: int | None = None) -> None:
    """Compile a kernel for a device, or load it from Warp's cache.

    Raises:
        SceneError: The cache cannot be written, or holds a damaged file.
    """
    with LOADING, cache_errors():
        try:
            wp.load_module(module=kernel.module, device=device, block_dim=block_dim)
            # An object whose end is lost but not its length may load without its functions.
            loaded = [made for (context, _), made in kernel.module.execs.items() if context == device.context]
            if device.is_cpu and any(made.get_kernel_hooks(kernel).forward is None for made in loaded):
                raise RuntimeError(f"Failed to load {kernel.key}")
        except Exception as error:
            # Of objects, for which Warp has no class, and of the JSON beside them.
            damaged = isinstance(error, json.JSONDecodeError | UnicodeDecodeError)
            if not damaged and not str(error).startswith("Failed to load"):
                raise
            reason = f"a .meta file is damaged: {error}" if damaged else str(error)
            folder = wp.config.kernel_cache_dir
            raise SceneError(f"{folder}: {reason}; delete this folder of compiled kernels") from None
