"""The application: all commands, each from its own module."""

from __future__ import annotations

import sys

import cyclopts

import warp_plate
from warp_plate.cli.accuracy import accuracy
from warp_plate.cli.bench import bench
from warp_plate.cli.check import check
from warp_plate.cli.compare import compare
from warp_plate.cli.effects import effects
from warp_plate.cli.explore import explore
from warp_plate.cli.export import export
from warp_plate.cli.init import init
from warp_plate.cli.localize import localize
from warp_plate.cli.modes import modes
from warp_plate.cli.output import log
from warp_plate.cli.render import render
from warp_plate.cli.simulate import simulate
from warp_plate.cli.sweep import sweep
from warp_plate.cli.view import view
from warp_plate.scene.errors import SceneError

app = cyclopts.App(
    name="warp-plate",
    help="Simulate thin vibrating panels, thousands at once, and find the drive that moves only the chosen part.",
    version=warp_plate.__version__,
    help_format="markdown",
    suppress_keyboard_interrupt=False,
)
COMMANDS = (
    localize, compare, sweep, simulate, check, modes, effects, accuracy, view, explore, render, export, init, bench,
)  # fmt: skip
for command in COMMANDS:
    app.command(command)


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
