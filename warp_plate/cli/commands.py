"""The application and its commands."""

from __future__ import annotations

import logging
import sys
from importlib import import_module

import cyclopts

from warp_plate._version import __version__
from warp_plate.cli.output import log
from warp_plate.scene.errors import SceneError

app = cyclopts.App(
    name="warp-plate",
    help="Simulate thin vibrating panels, thousands at once, and find drives that move only a chosen part of a panel.",
    version=__version__,
    help_format="markdown",
    suppress_keyboard_interrupt=False,
)
# Commands by module.
MODULES = {
    "localize": ("localize",),
    "compare": ("compare",),
    "sweep": ("sweep",),
    "simulate": ("simulate",),
    "check": ("check", "effects", "accuracy"),
    "modes": ("modes",),
    "measurement": ("fit", "plan_measurement", "verify"),
    "frf": ("frf",),
    "focus": ("focus",),
    "render": ("view", "render"),
    "explore": ("explore",),
    "export": ("export",),
    "scene_files": ("init", "keys"),
    "doctor": ("doctor",),
}
for module, names in MODULES.items():
    for name in names:
        app.command(getattr(import_module(f"warp_plate.cli.{module}"), name))
COMMANDS = [name.replace("_", "-") for names in MODULES.values() for name in names]


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
