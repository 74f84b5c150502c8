"""The command ``warp-plate``: one file a command beside this one, put together here."""

from __future__ import annotations

import io
import os
import sys

import cyclopts

import warp_plate
from warp_plate.cli.accuracy import accuracy
from warp_plate.cli.bench import bench
from warp_plate.cli.effects import effects
from warp_plate.cli.init import init
from warp_plate.cli.localize import localize
from warp_plate.cli.modes import modes
from warp_plate.cli.simulate import simulate
from warp_plate.scene.errors import SceneError, printable

app = cyclopts.App(
    name="warp-plate",
    help="Simulate thin vibrating panels, thousands at once, and find the drive that moves only the chosen part.",
    version=warp_plate.__version__,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
)
for command in (localize, simulate, modes, effects, accuracy, init, bench):
    app.command(command)


def main(arguments: list[str] | None = None) -> None:
    """Run one command and leave the process: status 0; 2 after a line about bad input; 130 after Ctrl-C."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without Greek letters is no fault of the scene
            stream.reconfigure(errors="backslashreplace")
    try:
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except SceneError as error:
        _refuse(str(error))
    except cyclopts.CycloptsError as error:
        _refuse(" ".join(str(error).split()))
    except MemoryError as error:
        _refuse(f"out of memory: {error}; use fewer nodes, actuators, record.times or record.points")
    except KeyboardInterrupt:
        print("warp-plate: interrupted; nothing was written", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except OSError as error:
        # Python would try once more to write what standard output still holds.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        _refuse(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}")


def _refuse(line: str) -> None:
    print(f"warp-plate: {printable(line)}", file=sys.stderr)
    sys.exit(2)
