"""Ctrl-C ends a command within about a second or one iteration, keeps what was found, and leaves no partial file."""

import json
import os
import pkgutil
import signal
import sys
import threading
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from support.commands import ENDS_WITH_PARENT, output_of, until
from support.commands import start_program as start
from support.inline_pool import InterruptedPool
from support.scenes import scene_of
from warp_plate import CheckpointFile, PlateSolver, __version__, load_checkpoint, load_result, localize
from warp_plate.cli import output
from warp_plate.interrupts import check_interrupt

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot send SIGINT to one process")
QUICK = ["--device", "cpu", "--no-pictures", "--no-estimate"]
LONG = {"particles": 6, "iterations": 100_000}  # a search that takes minutes


@pytest.fixture(autouse=True)
def default_handler():
    """Restore Python's handler of Ctrl-C, which a test before may have replaced."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def endless(write_scene):
    """A small scene in a file of the working folder, with a search that takes seconds."""
    return write_scene(damping=88.5, precision="float32", search={"particles": 6, "iterations": 2500})


def end(process):
    """Status, standard output and standard error of a process, and the seconds that it took to end."""
    started = time.monotonic()
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err, time.monotonic() - started


def test_programs_of_tests_that_run_in_the_background_can_be_interrupted():
    """Tests ignore Ctrl-C if a shell or cron has started them there, and what they start would inherit it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    process = start("-c", "import signal; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)")
    assert end(process)[:3] == (0, "True\n", "")


@pytest.mark.skipif(not ENDS_WITH_PARENT, reason="setpriv of util-linux is not installed")
def test_programs_of_tests_that_are_killed_end():
    """Also those that nobody waits for: the tests' own process is killed, and cannot end them itself."""
    code = "import time; print('started', flush=True); time.sleep(600)"
    start_one = f"from support.commands import start_program as start; print(start('-c', {code!r}, stdout=None).pid, "
    folders = os.pathsep.join([str(Path(__file__).parents[1]), os.environ["PYTHONPATH"]])
    tests = start("-c", start_one + "flush=True); input()", stdin=-1, env={**os.environ, "PYTHONPATH": folders})
    lines = {tests.stdout.readline().strip(), tests.stdout.readline().strip()}
    assert "started" in lines
    tests.kill()
    assert tests.communicate(timeout=60)[0] == ""  # its end is closed by the last process that could write


@pytest.mark.parametrize("number", ["SIGTERM", pytest.param("SIGINT", marks=pytest.mark.slow)])
def test_a_search_ends_with_its_best_and_a_checkpoint(number, endless, write_scene):
    write_scene(endless.with_tables(search=LONG))
    file = Path("panel-localize.checkpoint.h5")
    process = start("-m", "warp_plate", "localize", "panel.toml", *QUICK, "--json", "--checkpoint-every", 0)
    while not file.exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(getattr(signal, number))
    if number != "SIGINT":  # also twice
        process.send_signal(signal.SIGTERM)
    status, out, err, seconds = end(process)
    assert (status, len(err.splitlines())) == (0, 1)
    assert seconds < 10  # seconds of slack for a busy machine
    assert "resume with: warp-plate localize --resume panel-localize.checkpoint.h5" in err
    found, checkpoint, result = json.loads(out), load_checkpoint(file), load_result("panel-localize.h5")
    assert (found["interrupted"], found["checkpoint"]) == (True, str(file))
    assert 0 < checkpoint.iterations == len(found["history"]) < LONG["iterations"]
    assert found["evaluations"] == 6 * len(found["history"])
    assert result.interrupted
    assert result.cases["best"].localization_factor == found["localization_factor"]["best"]
    assert found["localization_factor"]["best"] == pytest.approx(found["history"][-1]["best"], abs=2e-6)
    assert not list(Path().rglob("*.part*"))


def test_a_second_ctrl_c_ends_a_search_at_once(tmp_path):
    """With the last checkpoint and without a result, as the state of the search may be half updated."""
    scene, done = scene_of((9, 9), search={"particles": 4, "iterations": 9}), []
    file = CheckpointFile(tmp_path / "a.checkpoint.h5", 0.0)

    def on_progress(iterations, total, best):
        done.append(iterations)
        if iterations == 3:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)
            done.append("not at once")

    with pytest.raises(KeyboardInterrupt):
        localize(scene, device="cpu", estimate=False, on_progress=on_progress, checkpoints=file)
    assert (done, load_checkpoint(file.path).iterations) == ([1, 2, 3], 3)


@pytest.mark.parametrize("every", ["0", "30"])
def test_a_search_that_ends_keeps_its_last_checkpoint(every, command, write_scene, monkeypatch):
    write_scene(scene_of((9, 9), search={"particles": 4, "iterations": 2}))
    monkeypatch.setattr("warp_plate.studies.localize.evaluate_targets", Mock(side_effect=KeyboardInterrupt))
    status, _, err = command("localize", "panel.toml", *QUICK, "--checkpoint-every", every)
    assert (status, "--resume" in err, len(err.splitlines())) == (130, every == "0", 1)
    assert [file.name for file in Path().glob("*.h5")] == ["panel-localize.checkpoint.h5"] * (every == "0")


def test_an_estimate_is_left_out_on_interrupts(endless, command, monkeypatch):
    monkeypatch.setattr("warp_plate.studies.simulate.estimate", Mock(side_effect=KeyboardInterrupt))
    output_of(command("simulate", "panel.toml", "--device", "cpu", "--path", "resident", "--no-pictures"))
    assert "estimate" not in load_result("panel-simulate.h5").accuracy


def test_a_long_iteration_ends_within_a_launch(endless, write_scene):
    """A plate that takes minutes is interrupted: status 130, one line, nothing written."""
    grid = {"nodes": (101, 101), "precision": "float64"}
    write_scene(endless.with_tables(grid=grid, window={"start": 0.0, "end": 100.0}))
    code = "import sys; from warp_plate.cli.main import main; import warp_plate.studies.simulate; "
    process = start("-c", code + "print(flush=True); main(sys.argv[1:])", "simulate", "panel.toml", *QUICK)
    process.stdout.readline()
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    status, _, err, seconds = end(process)
    assert (status, err) == (130, "warp-plate: interrupted\n")
    assert seconds < 10
    assert [path.name for path in Path().iterdir()] == ["panel.toml"]


@pytest.mark.slow
def test_a_closed_terminal_leaves_result_and_checkpoint(endless, write_scene):
    write_scene(endless.with_tables(search=LONG))
    """The terminal is gone when SIGHUP comes, so that nothing can be printed."""
    pty = pytest.importorskip("pty")
    child, terminal = pty.fork()
    if child == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which nohup ignores
        os.execv(
            sys.executable,
            [sys.executable, "-m", "warp_plate", "localize", "panel.toml", *QUICK, "--checkpoint-every", "0"],
        )
    try:
        until(lambda: Path("panel-localize.checkpoint.h5").exists())
    finally:
        os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.WIFEXITED(status)
    assert load_result("panel-localize.h5").interrupted
    assert 0 < load_checkpoint("panel-localize.checkpoint.h5").iterations < LONG["iterations"]


# Sends Ctrl-C when a module begins to be imported.
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


@pytest.mark.parametrize("module", ["cyclopts", pytest.param("warp_plate.kernels.loads", marks=pytest.mark.slow)])
def test_a_command_that_starts_ends_in_one_line(module, endless):
    status, out, err, _ = end(start("-c", STARTING.format(module=module), "localize", "panel.toml", *QUICK))
    assert (status, out, err) == (130, "", "warp-plate: interrupted\n")
    assert [path.name for path in Path().iterdir()] == ["panel.toml"]


# Sends Ctrl-C while a text is executed, as libraries do when they are imported; where Python can only report it, as in
# its own import system; and where another error follows: while a class is made (Python 3.11), or a lock is taken.
EXECUTING = """
import os, signal, sys, threading, time, weakref
from warp_plate.cli import main
lock = threading.Lock()
interrupt = lambda *_: os.kill(os.getpid(), signal.SIGINT)

class Attribute:
    __set_name__ = interrupt

main.load = lambda name: {code}
main.main(sys.argv[1:])
"""


@pytest.mark.parametrize(
    "code",
    [
        "exec('interrupt()')",
        pytest.param("(weakref.finalize(set(), interrupt), [time.sleep(0.1) for _ in range(200)])", id="weakref"),
        pytest.param("exec('with lock: lock.release(); interrupt()')", id="lock"),
        pytest.param("type('Made', (), {'attribute': Attribute()})", id="class"),
    ],
)
def test_the_status_is_that_of_an_interrupt_wherever_it_comes(code, endless):
    status, out, err, _ = end(start("-c", EXECUTING.replace("{code}", code), "check", "panel.toml"))
    assert (status, out, err) == (130, "", "warp-plate: interrupted\n")


# The same while pictures are drawn, which are left out.
LEFT_OUT = """
import os, signal, sys
from warp_plate.cli import main, output

def report(*given):
    draw = lambda: exec("os.kill(os.getpid(), signal.SIGINT)")
    print(output.write_files({"file": str}, draw)[1])

output.report = report
main.main(sys.argv[1:])
"""


def test_the_status_is_0_where_pictures_are_left_out_wherever_the_interrupt_comes():
    status, out, err, _ = end(start("-c", LEFT_OUT, "keys"))
    assert (status, out, err) == (0, "no pictures: interrupted by Ctrl-C\n", "")


# Sends Ctrl-C while VTK is imported, and prints whether that went on.
DRAWING = STARTING.replace(
    "main(sys.argv", "import atexit; atexit.register(lambda: print('pyvista.plotting' in sys.modules))\nmain(sys.argv"
)


def test_vtk_is_loaded_whole(endless, command):
    """Where Ctrl-C comes while its libraries are loaded, Python may crash."""
    pytest.importorskip("pyvista")
    output_of(command("simulate", "panel.toml", *QUICK))
    code = DRAWING.format(module="pyvista.core")
    status, out, err, _ = end(start("-c", code, "render", "panel-simulate.h5", "--device", "cpu"))
    assert (status, out, err) == (130, "True\n", "warp-plate: interrupted\n")


# Sends a signal when the modules of a command that is done are cleared.
ENDING = """
import os, signal, sys
from warp_plate.cli.main import main

class Late:
    def __del__(self, kill=os.kill, arguments=(os.getpid(), signal.{number})):
        kill(*arguments)

sys.late = Late()
main(sys.argv[1:])
"""


@pytest.mark.parametrize(
    "number", ["SIGTERM", *(pytest.param(n, marks=pytest.mark.slow) for n in ("SIGINT", "SIGHUP"))]
)
def test_a_command_that_is_done_keeps_its_status(number):
    status, out, err, _ = end(start("-c", ENDING.format(number=number), "--version"))
    assert (status, out, err) == (0, f"{__version__}\n", "")


@pytest.mark.parametrize(
    "line",
    ["simulate panel.toml --device cpu --no-estimate --no-pictures", "export panel-simulate.h5 --to drive-csv --json"],
)
def test_a_command_whose_files_are_written_is_done(line, endless, command, monkeypatch):
    """A signal comes while the answer is printed, and one after it."""
    output_of(command("simulate", "panel.toml", *QUICK))
    report = output.report
    for name in ("console", "json_value"):
        function = getattr(output, name)
        monkeypatch.setattr(
            output, name, lambda *given, f=function: (os.kill(os.getpid(), signal.SIGTERM), f(*given))[1]
        )
    monkeypatch.setattr(
        output, "report", lambda *given, **options: (report(*given, **options), os.kill(os.getpid(), signal.SIGINT))
    )
    handler = signal.getsignal(signal.SIGINT)
    assert "panel-" in output_of(command(*line.split()))
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.parametrize("target", ["warp_plate.result.model.save_result", "matplotlib.figure.Figure.savefig"])
def test_files_are_written_whole_or_not_at_all(target, endless, write_scene, command, monkeypatch):
    """Ctrl-C comes when the result is about to be written, or the first picture."""
    pytest.importorskip("matplotlib")
    write_scene(endless.with_tables(search={"particles": 6, "iterations": 2}))
    function = pkgutil.resolve_name(target)

    def interrupted(*arguments, **options):
        os.kill(os.getpid(), signal.SIGINT)
        return function(*arguments, **options)

    monkeypatch.setattr(target, interrupted)
    out = output_of(command("localize", "panel.toml", "--no-estimate", "--device", "cpu"))
    assert "no pictures: interrupted by Ctrl-C" in out
    assert not load_result("panel-localize.h5").interrupted
    names = ["panel-localize.best.toml", "panel-localize.h5", "panel.toml"]
    assert sorted(path.name for path in Path().iterdir()) == names


@pytest.mark.parametrize(
    ("line", "file"),
    [
        ("frf panel.toml --to csv --range 20:60", "panel-frf.csv"),
        ("sound panel.toml --to hdf5 --range 280:300", "panel-sound.h5"),
        ("focus panel.toml", "panel-focus.h5"),
        ("simulate panel.toml --device cpu --no-estimate", "panel-simulate.h5"),
        ("fit panel.toml --data measured.csv", "panel.fitted.toml"),
    ],
)
def test_pictures_are_left_out_on_interrupts(line, file, command, write_scene, monkeypatch, request):
    pytest.importorskip("matplotlib")
    if line.startswith("simulate"):
        request.getfixturevalue("drawing")
    points = {"points": [(0.07, 0.06)], "highest": 200.0, "time": 0.01, "rate": 4000}
    write_scene(damping=10.0, fit={"free": {"plate.young_modulus": (1e8, 1e10)}}, focus=points)
    Path("measured.csv").write_text("frequency\n21.5\n44.0\n44.3\n64.9\n", encoding="utf-8")

    def interrupted(*arguments, **options):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)

    for target in ("matplotlib.figure.Figure.savefig", "PIL.Image.Image.save"):
        monkeypatch.setattr(target, interrupted)
    out = output_of(command(*line.split()))
    assert out.replace("\n", " ").endswith(f"wrote {file} no pictures: interrupted by Ctrl-C ")
    assert sorted(path.name for path in Path().iterdir()) == sorted({"measured.csv", "panel.toml", file})


@pytest.mark.parametrize("line", ["frf paper --to csv --range 20:60", "sound paper --to csv --range 200:300"])
def test_the_picture_that_out_names_is_not_left_out(line, command, monkeypatch, tmp_path):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda *_, **__: os.kill(os.getpid(), signal.SIGINT))
    status, out, err = command(*line.split(), "--out", "a.png")
    assert (status, out, err) == (130, "", "warp-plate: interrupted; wrote only a.csv\n")
    assert [path.name for path in Path().iterdir()] == ["a.csv"]


@pytest.mark.parametrize(
    ("line", "status", "said"),
    [
        ("localize panel.toml --evaluator direct", 0, "no pictures: interrupted"),
        ("sweep panel.toml --what check --vary drive.frequency=200,300", 0, "no pictures: interrupted"),
        ("localize panel.toml --evaluator direct --checkpoint-every 0", 130, "after 0 of 2 iterations; resume with"),
    ],
)
def test_ctrl_c_waits_while_workers_close(line, status, said, endless, command, monkeypatch, write_scene):
    write_scene(endless.with_tables(search={"particles": 6, "iterations": 2}))
    monkeypatch.setattr("warp_plate.cluster.opening._connect", Mock())
    monkeypatch.setattr("warp_plate.cluster.opening.WorkerPool", lambda *given: InterruptedPool())
    ended, out, err = command(*line.split(), "--cluster", "tcp://far:8786", "--device", "cpu")
    assert said in out + err
    assert (ended, Path(f"panel-{line.split()[0]}.h5").exists()) == (status, status == 0)
    check_interrupt()  # none is left for the program that called the command


def test_a_solver_can_be_used_after_an_interrupted_run(device, path, phasors):
    scene = scene_of(precision="float32", window=(0.01, 0.3))
    solver = PlateSolver(scene, device, path, 2)
    drives, others = phasors(2, 3).repeat(10, axis=0), phasors(20, 3)
    expected, heard = solver.run(drives).energy, threading.Event()

    def interrupt():
        """Repeat the signal, which Python loses if it comes while an object is being finalised."""
        heard.wait(0.012)
        while not heard.is_set():
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            heard.wait(1.0)

    def run_for_long():
        for _ in range(300):
            solver.run(others)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        run_for_long()
    heard.set()
    np.testing.assert_array_equal(solver.run(drives).energy, expected)


# Sends Ctrl-C in the third program of a specification.
SPECIFYING = """
import os, signal, sys
from warp_plate.problem.specified_drives import Tone

solve, calls = Tone.solve, []

def interrupted(*arguments, **options):
    calls.append(arguments)
    if len(calls) == 3:
        os.kill(os.getpid(), signal.SIGINT)
    return solve(*arguments, **options)

Tone.solve = interrupted
from warp_plate.cli.main import main
main(sys.argv[1:])
"""


def test_a_specification_ends_in_one_line_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err, _ = end(start("-c", SPECIFYING, "specify", "console", "--json"))
    assert (status, out, err) == (130, "", "warp-plate: interrupted\n")
    assert not list(tmp_path.iterdir())
