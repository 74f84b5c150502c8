"""The command line."""

import atexit
import gc
import importlib.util
import sys
from contextlib import suppress
from functools import cache

from warp_plate.scene.errors import printable

# New objects after which Python looks for garbage: while a command starts or draws, and while it works. Then libraries
# are still imported, so that old objects are looked through a fifth as often as by default.
STARTING, WORKING = 1_000_000, (2000, 10, 50)
# Parts of NumPy that no command uses. SciPy touches every part when it is imported, and these take half that time.
UNUSED = "f2py", "testing"


# Once: later objects of a program that runs several commands may be garbage.
_freeze_start = cache(gc.freeze)


def postpone_garbage() -> None:
    """Let Python look for garbage rarely while a command starts or draws, and not at its end.

    Nearly all objects that are made then live on; looking through them takes a quarter of a short command.
    """
    gc.set_threshold(STARTING)
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)


def collect_garbage() -> None:
    """Let Python look for garbage from now on, but not among the objects of the start."""
    if gc.get_threshold() != WORKING:
        _freeze_start()
        gc.set_threshold(*WORKING)


def postpone_unused() -> None:
    """Import the ``UNUSED`` parts of NumPy only if something in them is used, by the recipe in importlib's docs."""
    import numpy

    for name in UNUSED:
        spec = importlib.util.find_spec(f"numpy.{name}")
        if spec is not None and spec.loader is not None and spec.name not in sys.modules:
            spec.loader = importlib.util.LazyLoader(spec.loader)
            module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            setattr(numpy, name, module)


def log(line: str) -> None:
    """Print one line on standard error."""
    with suppress(OSError):  # a closed standard error does not end a run
        print(f"warp-plate: {printable(' '.join(line.split()))}", file=sys.stderr)
