"""The command ``warp-plate``: its commands, exit statuses, and one line for errors and interrupts."""

from __future__ import annotations

import atexit
import io
import logging
import os
import signal
import sys
import time
from collections import namedtuple
from contextlib import nullcontext, suppress
from functools import cache
from typing import TYPE_CHECKING

from warp_plate._version import __version__
from warp_plate.cli import log, postpone_garbage, postpone_unused
from warp_plate.interrupts import (
    check_interrupt,
    end_signals,
    ignore_interrupts,
    interrupt_on_termination,
    repeat_lost_interrupts,
)
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    import cyclopts

# The module of each command, which is imported when the command runs, and the command's line in ``warp-plate --help``.
COMMANDS = {
    "localize": ("localize", "Search for the drive that puts most of the plate's kinetic energy into the target."),
    "specify": ("specify", "Find the drive that meets wanted and allowed levels, or prove that none does."),
    "sweep": ("sweep", "Compute the results of one command over many scenes that differ in some keys."),
    "simulate": ("simulate", "Run one plate under one drive."),
    "check": ("check", "Show what a scene is, warnings about it, and the numerics of its run."),
    "effects": ("check", "Show the cost and influence of every effect, and suggest effects that the scene lacks."),
    "accuracy": ("accuracy", "Measure error against run time, and recommend grids for errors from 10 % to 0.1 %."),
    "modes": ("modes", "Show natural frequencies, damping and shapes of a plate with its linear effects."),
    "fit": ("measurement", "Fit properties of a panel to measured natural frequencies or frequency responses."),
    "verify": ("measurement", "Compare velocities measured under a drive with those that its result predicts."),
    "measured": ("measured", "Find drives from measured responses alone: localization, levels, focus, with bounds."),
    "design": ("design", "Design the panel itself: thickness, ribs, masses and places that raise the bound of drives."),
    "frf": ("frf", "Show frequency responses of a linear plate, and the best localization at each frequency."),
    "sound": ("frf", "Show the sound that a linear plate radiates under its drive: power, pressure and directivity."),
    "focus": ("focus", "Compute a waveform for each actuator that moves the plate at a point and a moment."),
    "view": ("render", "Show the plates of a result in motion, in a window."),
    "render": ("render", "Draw pictures, movies and pages of a result; needs no display."),
    "explore": ("explore", "Explore a scene in the browser: sliders for every actuator, frequency, damping and links."),
    "export": ("export", "Write a result for ParaView, a spreadsheet or the amplifier."),
    "init": ("scene_files", "Write a preset as a TOML file to edit."),
    "keys": ("scene_files", "Show every key of a scene file with unit, default, range, example and meaning."),
    "doctor": ("doctor", "Check the GPUs, folders, drawing and extras of this installation."),
}
_began = time.perf_counter()


class _OneLine(logging.Handler):
    """Prints the program's warnings as the commands print theirs."""

    def emit(self, record: logging.LogRecord) -> None:
        log(record.getMessage())


@cache
def application() -> cyclopts.App:
    """Return the application, whose commands are imported when they run."""
    import cyclopts  # slow

    logging.getLogger("warp_plate").addHandler(_OneLine())
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns of folders where it cannot keep fonts
    app = cyclopts.App(
        name="warp-plate",
        help="Simulate thin vibrating panels, thousands at once, and find drives that move only a chosen part of a "
        "panel.",
        help_epilogue="Exit status: 0 done, 1 an error of doctor or of --install-completion, 2 refused, 130 ended by "
        "Ctrl-C, SIGTERM or SIGHUP.",
        version=__version__,
        help_format="markdown",
        suppress_keyboard_interrupt=False,
    )
    for name, (module, summary) in COMMANDS.items():
        app.command(f"warp_plate.cli.{module}:{name.replace('-', '_')}", name=name, help=summary)
    app.register_install_completion_command(add_to_startup=False)
    return app


def load(command: str) -> cyclopts.App:
    """Import a command, and return it with the whole help of its function."""
    loaded = application()[command]
    loaded.help = None
    return loaded


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
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # which it looks for among all that is installed
    postpone_garbage()
    _prepare_streams()
    interrupt_on_termination()
    repeat_lost_interrupts()
    # A command that is done ignores signals, but not in a program that called main.
    signals = nullcontext() if arguments is None else end_signals(signal.default_int_handler)
    try:
        with signals:
            _run(sys.argv[1:] if arguments is None else arguments)
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
    finally:  # the status stands when the process ends, not before: main may be called by another program
        atexit.unregister(ignore_interrupts)
        atexit.register(ignore_interrupts)
        with suppress(KeyboardInterrupt):  # one more, which came while the command ended
            check_interrupt()
        # Python ends by SIGINT if Ctrl-C came in an exec() of a text, until another text is executed, as here.
        namedtuple("Handled", "")


def _run(words: list[str]) -> None:
    """Run a command; exit with status 2 after one line about bad input."""
    from cyclopts import CycloptsError

    try:
        if (epoch := os.environ.get("SOURCE_DATE_EPOCH")) is not None:
            _check_epoch(epoch)
        if words and words[0] in COMMANDS:
            load(words[0])
            if not {"--help", "-h"}.intersection(words):
                postpone_unused()
        application()(words, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except (SceneError, CycloptsError) as error:
        log(str(error))
        sys.exit(2)
    except MemoryError as error:
        log(f"out of memory: {error}; use fewer nodes, actuators, particles, record.times or record.points")
        sys.exit(2)
    except (ImportError, RuntimeError, SystemError) as error:
        if isinstance(error.__context__, KeyboardInterrupt):  # while a class is made (Python 3.11), or a lock is taken
            raise error.__context__ from None
        raise
    except SystemExit as ended:
        if isinstance(ended.__context__, BrokenPipeError):  # while rich printed the help, which it ends with status 1
            raise ended.__context__ from None
        raise


def _check_epoch(text: str) -> None:
    """Raise a SceneError unless a time is one that NumPy and Matplotlib, which read it too, can use."""
    from datetime import UTC, datetime

    try:
        datetime.fromtimestamp(int(text), UTC)
    except (ValueError, OverflowError, OSError):
        raise SceneError(f"SOURCE_DATE_EPOCH = {text[:40]!r}: must be whole seconds since 1970, or not set") from None


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
