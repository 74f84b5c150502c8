"""The application: each command is the function that its module is named after."""

from __future__ import annotations

import logging
import sys
from importlib import import_module

import cyclopts

import warp_plate
from warp_plate.cli.output import log
from warp_plate.scene.errors import SceneError

app = cyclopts.App(
    name="warp-plate",
    help="Simulate thin vibrating panels, thousands at once, and find drives that move only a chosen part of a panel.",
    version=warp_plate.__version__,
    help_format="markdown",
    suppress_keyboard_interrupt=False,
)
COMMANDS = (
    "localize compare sweep simulate check modes fit plan-measurement frf focus effects accuracy view explore render "
    "export verify init keys doctor"
)
for name in COMMANDS.split():
    module = name.replace("-", "_")
    app.command(getattr(import_module(f"warp_plate.cli.{module}"), module))


class _OneLine(logging.Handler):
    """Prints the program's warnings as the commands print theirs."""

    def emit(self, record: logging.LogRecord) -> None:
        log(record.getMessage())


logging.getLogger("warp_plate").addHandler(_OneLine())


def run(arguments: list[str] | None = None) -> None:
    """Run a command; exit with status 2 after one line about bad input."""
    try:
        app(arguments, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except (SceneError, cyclopts.CycloptsError) as error:
        log(str(error))
        sys.exit(2)
    except MemoryError as error:
        log(f"out of memory: {error}; use fewer nodes, actuators, record.times or record.points")
        sys.exit(2)
