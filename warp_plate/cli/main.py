"""The command ``warp-plate``: exit statuses, and one line for what ends a command early."""

from __future__ import annotations

import io
import os
import sys

from warp_plate.interrupts import remember_lost_interrupts


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit: status 0; 2 after one line about bad input; 130 after Ctrl-C."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without Greek letters is no error of the scene
            stream.reconfigure(errors="backslashreplace")
    remember_lost_interrupts()
    try:
        from warp_plate.cli.commands import run  # slow to import: Ctrl-C may come here too

        run(arguments)
    except KeyboardInterrupt as interrupt:
        print(f"warp-plate: interrupted{interrupt}", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except OSError as error:
        from warp_plate.cli.output import log

        # At exit Python would try again to write what standard output still holds.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        log(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}")
        sys.exit(2)
