"""Tasks that tests give to workers, apart from the tests, so that a worker need not import those."""

import os
import time

from warp_plate import SceneError


def doubled(value):
    """A task: twice a number, or what goes wrong at some numbers."""
    if value == 13:
        raise SceneError("value = 13: no")
    if value == 14:
        raise ModuleNotFoundError("No module named 'absent'", name="absent")
    if value == 17:
        raise RuntimeError("CUDA error 700: an illegal memory access\nmore of it")
    return 2 * value


def process_number(seconds):
    time.sleep(seconds)
    return os.getpid()


def end_worker(_):
    os._exit(3)
