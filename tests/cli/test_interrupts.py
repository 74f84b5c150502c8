"""Ctrl-C at any moment: what was found is kept, nothing half-written stays, and no thread goes on unseen."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver, load_checkpoint, load_result
from warp_plate.scene.dump import dump_scene

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send to oneself")


@pytest.fixture(autouse=True)
def python_s_own_handler():
    """Whatever a test before, or a library that it used, made of Ctrl-C in this process."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)

ROOT = Path(__file__).parents[2]
# Runs a command, and calls ``on_loss(calls so far)`` each time that the search turns energies into losses.
DRIVER = """
import os, signal, sys, threading
import warp_plate.problem.problem as search
from warp_plate.cli.main import main
from warp_plate.problem.objectives import Objectives

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

losses, calls = Objectives.losses, []

def watched(*arguments):
    calls.append(1)
    on_loss(len(calls))
    return losses(*arguments)

Objectives.losses = watched
{watch}
main(sys.argv[1:])
"""
# Python only reports what a callback of ``weakref`` raises, and goes on.
LOST = """
import weakref
class Thing:
    pass

def on_loss(calls):
    if calls == 3:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        thing = Thing()
        watching = weakref.ref(thing, lambda gone: interrupt())
        del thing
"""
AFTER_THREE = """
def on_loss(calls):
    # A little after the third iteration, amid whatever is going on then.
    if calls == 3:
        threading.Timer(0.05, interrupt).start()
"""
BEFORE_ANY = """
search.measure_response = lambda solver: interrupt()
"""
@pytest.fixture
def panel(tmp_path, monkeypatch, scene):
    """A small scene whose search goes on for ever, in a file of the working folder."""
    monkeypatch.chdir(tmp_path)
    made = scene(damping=88.5, precision="float32", search={"particles": 6, "iterations": 10**6})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    return made


def python(*arguments):
    """A process of its own, to its end."""
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=300,
        check=False,
    )


def interrupted(watch):
    """``warp-plate localize panel.toml --json`` in a process of its own that sends itself Ctrl-C."""
    Path("driver.py").write_text(DRIVER.format(watch=watch), encoding="utf-8")
    command = ["localize", "panel.toml", "--json", "--device", "cpu", "--no-pictures"]
    return python("driver.py", *command)


@pytest.mark.parametrize("watch", [AFTER_THREE, LOST], ids=["at once", "lost by Python"])
def test_the_command_ends_with_the_best_so_far(watch, panel):
    """Saved and printed as if the search had come to its end there."""
    answer = interrupted(watch)
    assert answer.returncode == 0
    # One word on the way on.
    assert re.fullmatch(
        r"warp-plate: interrupted after \d+ of 1000000 iterations; go on with: warp-plate localize --resume "
        r"panel-localize\.checkpoint\.h5\n",
        answer.stderr,
    )
    found = json.loads(answer.stdout)
    assert found["interrupted"] is True
    assert found["evaluations"] >= 18
    assert found["evaluations"] == 6 * len(found["history"])
    result = load_result("panel-localize.h5")
    assert result.interrupted
    best = result.cases["best"].localization_factor
    assert best == found["localization_factor"]["best"]
    # What was found is what it says: the last run of its drive gives the share that the search saw, in
    # float32.
    assert best == pytest.approx(found["history"][-1]["best"], abs=2e-6)
    assert not list(Path().rglob("*.part*"))
    checkpoint = load_checkpoint("panel-localize.checkpoint.h5")
    assert found["checkpoint"] == "panel-localize.checkpoint.h5"
    assert checkpoint.iterations == len(found["history"])


def test_before_anything_is_found(panel):
    """Status 130 and one line, no traceback, no file."""
    answer = interrupted(BEFORE_ANY)
    assert answer.returncode == 128 + signal.SIGINT
    assert answer.stdout == ""
    assert len(answer.stderr.splitlines()) == 1
    assert sorted(path.name for path in Path().iterdir()) == ["driver.py", "panel.toml"]


# Sends Ctrl-C when a module begins to be imported, the first of many moments of a start that is not quick.
STARTING = """
import os, signal, sys

class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Watch())
from warp_plate.cli.main import main
main(sys.argv[1:])
"""
MODULES = ["cyclopts", "rich.console", "warp_plate.cli.localize", "warp_plate.scene.errors", "pydantic", "numpy"]
MODULES += ["h5py", "scipy.linalg", "warp", "warp_plate.studies.localize", "warp_plate.kernels.load"]


@pytest.mark.parametrize("module", MODULES)
def test_while_the_command_starts(module, panel):
    """Status 130 and one word, whatever is being imported."""
    answer = python("-c", STARTING.format(module=module), "localize", "panel.toml", "--no-pictures")
    assert answer.returncode == 128 + signal.SIGINT
    assert (answer.stdout, answer.stderr) == ("", "warp-plate: interrupted\n")


def test_progress_that_raises_leaves_a_usable_solver(device, path, scene, phasors):
    made = scene()
    drives = phasors(5, 3)
    expected = PlateSolver(made, device, path).run(drives).energy
    solver = PlateSolver(made, device, path, 2)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solver.run(drives, progress=stop)
    np.testing.assert_array_equal(solver.run(drives).energy, expected)


@pytest.mark.parametrize("after", [0.012, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.004, 0.02))])
def test_amid_a_launch_leaves_a_usable_solver(after, device, path, scene, phasors):
    """The next run starts only when the interrupted one has let go of the plates."""
    made = scene(precision="float32", window=(0.01, 3.0))
    solver = PlateSolver(made, device, path)
    drives, others = phasors(2, 3).repeat(10, axis=0), phasors(20, 3)
    expected = solver.run(drives).energy
    heard = threading.Event()

    def interrupt():
        """Again where Python lost it, as it does with what is raised while an object is taken away."""
        heard.wait(after)
        while not heard.is_set():
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            heard.wait(1.0)

    interrupting = threading.Thread(target=interrupt, daemon=True)
    try:
        interrupting.start()
        for _ in range(100):
            solver.run(others)
    except KeyboardInterrupt:
        heard.set()
        np.testing.assert_array_equal(solver.run(drives).energy, expected)
    else:
        heard.set()
        pytest.fail("100 runs were over before Ctrl-C came")


DRAWING = """
import os, signal, sys
import warp_plate.viz
from warp_plate.cli.main import main

{interrupt}
main(sys.argv[1:])
"""
# While the result is written Ctrl-C waits; while a picture is, it ends the drawing.
WRITING = """
import warp_plate.result
save = warp_plate.result.save_result
def saved(result, path):
    os.kill(os.getpid(), signal.SIGINT)
    return save(result, path)
warp_plate.result.save_result = saved
"""
SAVING = """
from matplotlib.figure import Figure
save = Figure.savefig
def saved(self, path, **options):
    save(self, path, **options)
    os.kill(os.getpid(), signal.SIGINT)
Figure.savefig = saved
"""


@pytest.mark.parametrize("interrupt", [WRITING, SAVING], ids=["result", "picture"])
def test_while_files_are_written(interrupt, panel):
    """The result is there and whole, and no picture by halves."""
    pytest.importorskip("matplotlib")
    short = panel.model_copy(update={"search": panel.search.model_copy(update={"iterations": 2})})
    Path("panel.toml").write_text(dump_scene(short), encoding="utf-8")
    answer = python("-c", DRAWING.format(interrupt=interrupt), "localize", "panel.toml", "--no-estimate")
    assert (answer.returncode, answer.stderr) == (0, "")
    assert "no pictures: interrupted by Ctrl-C" in answer.stdout
    assert not load_result("panel-localize.h5").interrupted
    names = ["panel-localize.best.toml", "panel-localize.h5", "panel.toml"]
    assert sorted(path.name for path in Path().iterdir()) == names
