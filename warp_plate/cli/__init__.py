"""The command line."""

import atexit
import gc
import sys
from contextlib import suppress

from warp_plate.scene.errors import printable

# New objects after which Python looks for garbage: while a command starts, and otherwise.
STARTING, USUAL = 100_000, gc.get_threshold()


def postpone_garbage() -> None:
    """Let Python look for garbage rarely while a command starts, and not at its end.

    Nearly all objects that are made until then live on; looking through them takes a quarter of a short command.
    """
    gc.set_threshold(STARTING)
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)


def collect_garbage() -> None:
    """Let Python look for garbage as usual from now on, but not among the objects of the start."""
    if gc.get_threshold() != USUAL:
        gc.set_threshold(*USUAL)
        if not gc.get_freeze_count():  # later objects of another program's command may be garbage
            gc.freeze()


def log(line: str) -> None:
    """Print one line on standard error."""
    with suppress(OSError):  # a closed standard error does not end a run
        print(f"warp-plate: {printable(' '.join(line.split()))}", file=sys.stderr)
