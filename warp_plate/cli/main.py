"""The command ``warp-plate``: exit statuses, and one line for errors and interrupts."""

from __future__ import annotations

import io
import os
import sys
import time

from warp_plate.cli import log
from warp_plate.interrupts import interrupt_on_termination, remember_lost_interrupts

_began = time.perf_counter()


def elapsed() -> float:
    """Return the seconds since the command began."""
    return time.perf_counter() - _began


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit: status 0; 2 after one line about bad input; 130 after Ctrl-C or SIGTERM."""
    global _began
    _began = time.perf_counter()
    # Threads of linear algebra sleep soon while they wait for a task: commands have small ones, far apart.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    os.environ.pop("MPLBACKEND", None)  # commands draw to files
    _prepare_streams()
    interrupt_on_termination()
    remember_lost_interrupts()
    try:
        from warp_plate.cli.commands import run  # slow to import: Ctrl-C may come here too

        run(arguments)
    except KeyboardInterrupt as interrupt:
        print(f"warp-plate: interrupted{interrupt}", file=sys.stderr)
        sys.exit(130)
    except (ImportError, SystemError) as error:  # the latter where memory runs out inside an import
        log(f"a library cannot be loaded: {error.__cause__ or error}; is it damaged, or memory limited?")
        sys.exit(2)
    except BrokenPipeError:
        _discard_output()
        sys.exit(0)
    except OSError as error:
        _discard_output()
        log(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}")
        sys.exit(2)


def _prepare_streams() -> None:
    """Let commands print to closed streams, and characters that the terminal lacks."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:  # closed; the next file to be opened would get its number
            os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(descriptor, "w" if descriptor else "r", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    if not os.environ.get("COLUMNS", "").strip("0"):  # some shells say 0 for unknown
        os.environ.pop("COLUMNS", None)


def _discard_output() -> None:
    """Discard buffered standard output, which Python would try to write again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
