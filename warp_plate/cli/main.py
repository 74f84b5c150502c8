"""The command ``warp-plate``. Whatever takes time to import comes inside, where Ctrl-C ends in a word."""

from __future__ import annotations

import io
import os
import sys


def main(arguments: list[str] | None = None) -> None:
    """Run one command and leave the process: status 0; 2 after a line about bad input; 130 after Ctrl-C."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without Greek letters is no fault of the scene
            stream.reconfigure(errors="backslashreplace")
    try:
        from warp_plate.cli.interrupts import at_safe_moments

        with at_safe_moments():
            from warp_plate.cli.commands import run

            run(arguments)
    except KeyboardInterrupt as interrupt:
        word = interrupt.args[0] if interrupt.args else "; nothing was written"
        print(f"warp-plate: interrupted{word}", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except OSError as error:
        from warp_plate.cli.output import tell

        # Python would try once more to write what standard output still holds.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        tell(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}")
        sys.exit(2)
