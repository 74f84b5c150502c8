"""Warp's cache of compiled kernels, with a checksum beside each file: a damaged one would give wrong numbers or crash.

The checksums are against accidents. Whoever may write to the folder may run code as its user.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

import warp as wp

from warp_plate.result.atomic_io import write_atomically
from warp_plate.scene.errors import SceneError

ENDING, LOADED = ".sha256", (".o", ".ptx", ".cubin", ".meta")
_loaded: set[tuple[str, str, int | None]] = set()


@contextmanager
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
            with suppress(OSError, SceneError):  # another user's folder
                write_atomically(_digest(file), seal)
    _loaded.add(key)


def _files(kernel: wp.Kernel) -> list[tuple[Path, Path]]:
    """Return the files of a kernel's module that Warp loads, in all variants, and the files of their checksums."""
    found = Path(str(wp.config.kernel_cache_dir)).glob(f"wp_{escape(kernel.module.name)}_*/*")
    return [(file, file.with_name(file.name + ENDING)) for file in sorted(found) if file.suffix in LOADED]


def _digest(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).hexdigest().encode()
