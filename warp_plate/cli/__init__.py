"""The command line."""

import sys
from contextlib import suppress

from warp_plate.scene.errors import printable


def log(line: str) -> None:
    """Print one line on standard error."""
    with suppress(OSError):  # a closed standard error does not end a run
        print(f"warp-plate: {printable(' '.join(line.split()))}", file=sys.stderr)
