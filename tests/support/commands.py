"""Commands: what they write, and programs of their own."""

import atexit
import shutil
import signal
import subprocess
import sys
import time
import unicodedata

from warp_plate.interrupts import TERMINAL_SIGNALS

# Words of util-linux before a command, which becomes the process itself: Linux kills it when its parent ends.
ENDS_WITH_PARENT = [setpriv, "--pdeathsig", "KILL"] if (setpriv := shutil.which("setpriv")) else []


def output_of(answer):
    """Return the standard output of a command that succeeded and wrote nothing on standard error."""
    status, out, err = answer
    assert (status, err) == (0, "")
    return out


def error_of(answer):
    """Return what a command wrote that refused its input: one printable line on standard error, with status 2."""
    status, out, err = answer
    assert (status, out) == (2, "")
    assert err.startswith("warp-plate: ")
    assert err.endswith("\n")
    assert err[:-1].isprintable()
    return err


def start_program(*arguments, **options):
    """Start Python with arguments such as ``-m warp_plate``; its standard output and error are pipes.

    It ends with the tests at the latest, on Linux even if they are killed, and Ctrl-C ends it even where they ignore
    it, as in the background.
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    before = {number: signal.signal(number, signal.default_int_handler) for number in TERMINAL_SIGNALS}
    try:
        process = subprocess.Popen([*ENDS_WITH_PARENT, sys.executable, *map(str, arguments)], **{**pipes, **options})
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    atexit.register(process.kill)
    return process


def until(condition, patience=60.0):
    """Wait until a condition holds, on a busy machine at most so long [s]."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def is_printable(text):
    """Return whether a text has no characters but printable ones and spaces, such as those that do not break."""
    return all(c.isprintable() or unicodedata.category(c) == "Zs" for c in text)
