"""Files that are written completely or not at all, and a seal at their end that reveals any change of a byte.

The seal is one line of text after the content, with its SHA-256 and length. HDF5 ignores what lies behind its own end,
so a sealed HDF5 file opens everywhere. The seal is verified before HDF5 opens the file, for its library may loop or
crash over damaged bytes.
"""

import csv
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from warp_plate.scene.errors import SceneError, printable_line

# First characters of formulas.
FORMULAS = frozenset("=+-@")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` whose content replaces ``path`` at the end, but not after an error.

    The new file is on the disk before any name changes, so that a complete file survives a power failure. It has the
    permissions of the file that it replaces.

    Raises:
        OSError: the folder is missing or cannot be written to, or the disk is full.
        SceneError: the file is read-only.
    """
    path = Path(os.path.realpath(path))  # the file that a symbolic link leads to is replaced, not the link
    if is_read_only(path):
        raise SceneError(f"{path}: is read-only")
    temporary = path.parent / f".{path.name}.{secrets.token_hex(6)}.part{path.suffix}"
    temporary.touch(exist_ok=False)
    try:
        if path.exists():
            shutil.copymode(path, temporary)
        yield temporary
        with temporary.open("rb+") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    if hasattr(os, "O_DIRECTORY"):
        with suppress(OSError):  # not every file system can flush the names in a folder
            folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def is_read_only(path: Path) -> bool:
    """Return whether a file is there that this user may not write, or that nobody but root may."""
    return os.path.isfile(path) and not (os.access(path, os.W_OK) and path.stat().st_mode & 0o222)


@contextmanager
def atomic_paths(*paths: Path) -> Iterator[list[Path]]:
    """Yield temporary paths whose contents replace ``paths``, in this order, at the end, but not after an error.

    A SceneError that names the last path is raised if a file cannot be written; see :func:`atomic_path`.
    """
    try:
        with ExitStack() as stack:
            # The last one entered is the first one to leave.
            temporaries = [stack.enter_context(atomic_path(path)) for path in reversed(paths)]
            yield temporaries[::-1]
    except OSError as error:
        raise SceneError(f"{paths[-1]}: cannot be written: {error.strerror or error}") from None


def write_atomically(content: bytes, path: Path) -> None:
    """Write a file atomically, or raise a SceneError; see :func:`atomic_path`."""
    with atomic_paths(path) as (temporary,):
        temporary.write_bytes(content)


def write_table(path: Path, heading: list[str], blocks: Iterable[np.ndarray]) -> list[Path]:
    """Write blocks of rows as comma-separated UTF-8 text, the first column with 15 digits and the others with 9.

    Headings are one line of texts: control characters are escaped, and an apostrophe precedes what a spreadsheet would
    take for a formula.
    """
    names = list(map(printable_line, heading))
    with atomic_paths(path) as (temporary,), temporary.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(f"'{name}" if name[:1] in FORMULAS else name for name in names)
        for block in blocks:
            np.savetxt(file, block, fmt=["%.15g", *["%.9g"] * (block.shape[1] - 1)], delimiter=",")
    return [path]


def make_seal(content: bytes | memoryview) -> bytes:
    """Return the line to append to the content."""
    return b"\nwarp-plate sha256 %s of %020d bytes\n" % (hashlib.sha256(content).hexdigest().encode(), len(content))


SEAL_BYTES = len(make_seal(b""))


def check_seal(path: Path) -> None:
    """Verify that a file is as it was sealed.

    Raises:
        SceneError: it is missing, cannot be read, is cut short, changed, not sealed, or a folder or device.
    """
    try:
        if path.exists() and not path.is_file():  # reading from a pipe may never end
            raise SceneError(f"{path}: is no file")
        content = memoryview(path.read_bytes())
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None
    if content[-SEAL_BYTES:] != make_seal(content[:-SEAL_BYTES]):
        raise SceneError(f"{path}: damaged: no valid checksum; it was cut short, or changed or made by another program")
