"""Choice of the device, the cores of the CPU, and Warp's cache of compiled kernels.

The cache has a checksum beside each file: a damaged one would give wrong numbers or crash. The checksums are against
accidents. Whoever may write to the folder may run code as its user.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import platform
import sys
from collections.abc import Iterator
from glob import escape
from pathlib import Path

import warp as wp

from warp_plate.result.atomic_io import write_atomically
from warp_plate.scene.errors import SceneError
from warp_plate.solve import nvidia

MOST_THREADS = 1024  # each takes memory
ENDING, LOADED = ".sha256", (".o", ".ptx", ".cubin", ".meta")
_loaded: set[tuple[str, str, int | None]] = set()


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
    except OSError as error:
        folder = wp.config.kernel_cache_dir or error.filename
        raise SceneError(
            f"{folder}: cannot keep compiled kernels: {error.strerror}; WARP_CACHE_PATH can name another folder"
        ) from None


def load_kernel(kernel: wp.Kernel, device: wp.Device, block_dim: int | None = None) -> None:
    """Compile a kernel for a device, or load it from the cache if its files there are unchanged."""
    key = str(kernel.module.name), str(device.alias), block_dim
    if key in _loaded:
        return
    with cache_errors():
        for file, seal in _files(kernel):
            if seal.exists() and seal.read_bytes() != _digest(file):
                logging.getLogger("warp_plate").warning("%s: damaged; compiled again", file)
                file.unlink()
                seal.unlink()
        wp.load_module(module=kernel.module, device=device, block_dim=block_dim)
    for file, seal in _files(kernel):
        if not seal.exists():
            with contextlib.suppress(OSError, SceneError):  # another user's folder
                write_atomically(_digest(file), seal)
    _loaded.add(key)


def _files(kernel: wp.Kernel) -> list[tuple[Path, Path]]:
    """Return the files of a kernel's module that Warp loads, in all variants, and the files of their checksums."""
    files = Path(str(wp.config.kernel_cache_dir)).glob(f"wp_{escape(kernel.module.name)}_*/*")
    return [(file, file.with_name(file.name + ENDING)) for file in sorted(files) if file.suffix in LOADED]


def _digest(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).hexdigest().encode()
