"""The application and its commands."""

from __future__ import annotations

import logging
import sys

import cyclopts

from warp_plate._version import __version__
from warp_plate.cli import log
from warp_plate.scene.errors import SceneError

app = cyclopts.App(
    name="warp-plate",
    help="Simulate thin vibrating panels, thousands at once, and find drives that move only a chosen part of a panel.",
    version=__version__,
    help_format="markdown",
    suppress_keyboard_interrupt=False,
)
# The module of each command, which is imported when the command runs, and the command's line in ``warp-plate --help``.
COMMANDS = {
    "localize": ("localize", "Search for the drive that puts most of the plate's kinetic energy into the target."),
    "compare": ("compare", "Compare search methods on a scene, each from several seeds with equal budgets."),
    "sweep": ("sweep", "Compute the results of one command over many scenes that differ in some keys."),
    "simulate": ("simulate", "Run one plate under one drive."),
    "check": ("check", "Show what a scene is, warnings about it, and the numerics of its run."),
    "effects": ("check", "Show the cost and influence of every effect, and suggest effects that the scene lacks."),
    "accuracy": ("check", "Measure error against run time, and recommend grids for errors from 10 % to 0.1 %."),
    "modes": ("modes", "Show natural frequencies, damping and shapes of a plate with its linear effects."),
    "fit": ("measurement", "Fit properties of a panel to measured natural frequencies or frequency responses."),
    "plan-measurement": ("measurement", "Choose the actuator and the sensor places that best determine [fit.free]."),
    "verify": ("measurement", "Compare velocities measured under a drive with those that its result predicts."),
    "frf": ("frf", "Show frequency responses of a linear plate, and the best localization at each frequency."),
    "focus": ("focus", "Compute a waveform for each actuator that moves the plate at a point and a moment."),
    "view": ("render", "Show the plates of a result in motion, in a window."),
    "render": ("render", "Draw pictures, movies and pages of a result; needs no display."),
    "explore": ("explore", "Explore a scene in the browser: sliders for every actuator, frequency and damping."),
    "export": ("export", "Write a result for ParaView, a spreadsheet or the amplifier."),
    "init": ("scene_files", "Write a preset as a TOML file to edit."),
    "keys": ("scene_files", "Show every key of a scene file with unit, default, range, example and meaning."),
    "doctor": ("doctor", "Check the GPUs, folders, drawing and extras of this installation."),
}
for name, (module, summary) in COMMANDS.items():
    app.command(f"warp_plate.cli.{module}:{name.replace('-', '_')}", name=name, help=summary)


def load(command: str) -> cyclopts.App:
    """Import a command, and return it with the whole help of its function."""
    loaded = app[command]
    loaded.help = None
    return loaded


class _OneLine(logging.Handler):
    """Prints the program's warnings as the commands print theirs."""

    def emit(self, record: logging.LogRecord) -> None:
        log(record.getMessage())


logging.getLogger("warp_plate").addHandler(_OneLine())


def run(arguments: list[str] | None = None) -> None:
    """Run a command; exit with status 2 after one line about bad input."""
    words = sys.argv[1:] if arguments is None else arguments
    try:
        if words and words[0] in COMMANDS:
            load(words[0])
        app(words, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except (SceneError, cyclopts.CycloptsError) as error:
        log(str(error))
        sys.exit(2)
    except MemoryError as error:
        log(f"out of memory: {error}; use fewer nodes, actuators, record.times or record.points")
        sys.exit(2)
