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
    before = len(_written())
    try:
        from warp_plate.cli.interrupts import at_safe_moments

        with at_safe_moments():
            from warp_plate.cli.commands import run

            run(arguments)
    except KeyboardInterrupt as interrupt:
        print(f"warp-plate: interrupted{_said(interrupt) or _what_was_written(before)}", file=sys.stderr)
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


def _said(interrupt: BaseException | None) -> str:
    """What a command says of its end; also of one that a second Ctrl-C cut short."""
    while interrupt is not None:
        if isinstance(interrupt, KeyboardInterrupt) and interrupt.args:
            return str(interrupt.args[0])
        interrupt = interrupt.__context__
    return ""


def _what_was_written(before: int) -> str:
    """In a word, of the files after so many."""
    files = [file for file in dict.fromkeys(_written()[before:]) if os.path.exists(file)]
    if not files:
        return "; nothing was written"
    from warp_plate.scene.errors import printable

    return printable(f"; wrote {', '.join(files)}")


def _written() -> list[str]:
    """The files that this process has written; whoever writes one has imported what knows them."""
    return getattr(sys.modules.get("warp_plate.result.atomic_io"), "WRITTEN", [])
