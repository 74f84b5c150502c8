"""Unusual environments: caches that cannot be written or are damaged, too many threads, links and pipes, closed
streams, terminals of no width, and names of files that are not UTF-8."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from support.commands import error_of, output_of
from support.scenes import scene_of
from warp_plate import Scene, SceneError, load_result
from warp_plate.solve.devices import cache_errors

QUICK = ("--device", "cpu", "--no-pictures", "--no-estimate", "--json")


def simulate(**environment):
    """Simulate panel.toml by time steps in a new process; return status, output and error."""
    line = [sys.executable, "-m", "warp_plate", "simulate", "panel.toml", *QUICK, "--path", "resident"]
    run = subprocess.run(line, capture_output=True, text=True, env={**os.environ, **environment})
    return run.returncode, run.stdout, run.stderr


def test_a_cache_that_cannot_be_made(write_scene):
    write_scene(damping=88.5)
    line = error_of(simulate(WARP_CACHE_PATH=str(Path("panel.toml").resolve() / "inside")))
    assert "cannot keep compiled kernels" in line
    assert "WARP_CACHE_PATH" in line
    assert str(Path("panel.toml").resolve()) in line


@pytest.mark.skipif(sys.platform != "linux", reason="other systems take only UTF-8")
def test_a_cache_whose_name_is_not_utf8(write_scene, tmp_path):
    write_scene(damping=88.5)
    line = error_of(simulate(WARP_CACHE_PATH=os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9")))
    assert "cannot keep compiled kernels: 'utf-8' codec can't encode" in line


def test_a_lost_file_of_the_cache_is_named():
    with pytest.raises(SceneError, match=r"cannot keep compiled kernels: a\.meta was not found"), cache_errors():
        raise FileNotFoundError("a.meta was not found")  # as Warp does


@pytest.mark.slow
def test_a_kernel_cut_short(write_scene, tmp_path):
    write_scene(damping=88.5)
    cache = {"WARP_CACHE_PATH": str(tmp_path / "cache")}
    output_of(simulate(**cache))
    objects, tables = ([*tmp_path.glob(f"cache/*/*/*.{ending}")] for ending in ("o", "meta"))
    damages = [
        *((tables, damage) for damage in (lambda data: b"", lambda data: data[: len(data) // 2], lambda data: b"\xff")),
        (objects, lambda data: data[:-1000]),
        (objects, lambda data: data[:200].ljust(len(data), b"\0")),  # blocks that a power cut did not write
    ]
    for files, damage in damages:
        assert files
        saved = {file: file.read_bytes() for file in files}
        for file, data in saved.items():
            file.write_bytes(damage(data))
        status, _, err = simulate(**cache)
        assert status == 2
        assert "delete this folder of compiled kernels" in err.splitlines()[-1]
        assert len(err.splitlines()) <= 2  # LLVM has a line before
        for file, data in saved.items():
            file.write_bytes(data)


@pytest.mark.parametrize("threads", ["1025", "9" * 5000, "²"])
def test_too_many_threads(threads, write_scene, command, monkeypatch):
    write_scene(damping=88.5)
    monkeypatch.setenv("WARP_PLATE_THREADS", threads)
    assert "WARP_PLATE_THREADS" in error_of(command("simulate", "panel.toml", *QUICK, "--path", "resident"))


@pytest.mark.parametrize("text", ["", "1.5", "now", "9" * 20, str(2**63 - 1), str(10**12)])
def test_a_time_that_libraries_cannot_use_is_refused(text, command, monkeypatch):
    """NumPy and Matplotlib read it too, and end in errors of their own."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", text)
    assert f"SOURCE_DATE_EPOCH = '{text}': must be whole seconds since 1970" in error_of(command("keys"))


def test_a_link_is_followed_and_stays(write_scene, command):
    write_scene(damping=88.5)
    Path("elsewhere").mkdir()
    Path("link.h5").symlink_to("elsewhere/result.h5")
    for _ in range(2):
        output_of(command("simulate", "panel.toml", *QUICK, "--out", "link.h5"))
        assert Path("link.h5").is_symlink()
        assert load_result("elsewhere/result.h5").source == "panel.toml"
    assert sorted(os.listdir("elsewhere")) == ["result.h5"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_a_pipe_and_a_loop_are_refused(write_scene, command):
    write_scene(damping=88.5, fit={"free": {"plate.young_modulus": (1e8, 1e10)}})
    Path("loop.h5").symlink_to("loop.h5")
    assert "leads to itself" in error_of(command("simulate", "panel.toml", *QUICK, "--out", "loop.h5"))
    os.mkfifo("pipe.h5")
    assert "is a pipe" in error_of(command("simulate", "panel.toml", *QUICK, "--out", "pipe.h5"))
    assert Path("pipe.h5").is_fifo()
    for name in ("pipe.h5", "."):  # reading from a pipe may never end
        assert f"{name}: is a folder, a pipe or a device" in error_of(command("check", name))
        assert f"{name}: is a folder, a pipe or a device" in error_of(command("fit", "panel.toml", "--data", name))


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such limit")
@pytest.mark.parametrize("limit", [150_000, pytest.param(300_000, marks=pytest.mark.slow)])
def test_libraries_that_do_not_fit_in_a_limit_of_memory(limit, write_scene):
    write_scene(damping=88.5)
    line = [sys.executable, "-m", "warp_plate", "simulate", "panel.toml", *QUICK]
    script = f'ulimit -v {limit}; exec "$@"'
    run = subprocess.run(["sh", "-c", script, "sh", *line], capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (2, "")
    assert "Traceback" not in run.stderr
    assert "memory" in run.stderr
    assert not Path("panel-simulate.h5").exists()


@pytest.mark.slow
def test_a_home_where_matplotlib_can_keep_nothing(write_scene):
    write_scene(damping=88.5)
    line = [sys.executable, "-m", "warp_plate", "modes", "panel.toml", "--out", "m.svg"]
    unusable = {"MPLCONFIGDIR": str(Path("panel.toml").resolve() / "inside"), "MPLBACKEND": "none"}
    run = subprocess.run(line, capture_output=True, text=True, env={**os.environ, **unusable})
    assert (run.returncode, run.stderr) == (0, "")
    assert Path("m.svg").exists()


FORKED = """
import os, signal, time
import numpy as np
from warp_plate import PlateSolver, Scene
from warp_plate.row_blocks import FEWEST_ROWS, over_blocks

def energies():
    over_blocks(lambda rows: time.sleep(0.1), 4 * FEWEST_ROWS)
    return PlateSolver(Scene.load("panel.toml"), "cpu").run(np.tile(np.eye(3), (20, 1))).energy

expected, child = energies(), os.fork()
if child == 0:
    signal.alarm(60)
    os._exit(0 if np.array_equal(energies(), expected) else 1)
raise SystemExit(abs(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no forks")
def test_a_forked_process_has_threads_of_its_own(write_scene):
    write_scene(damping=88.5)
    run = subprocess.run([sys.executable, "-c", FORKED], env={**os.environ, "WARP_PLATE_THREADS": "2"})
    assert run.returncode == 0


def in_shell(line, **environment):
    """Run a line of the shell, in which COMMAND stands for warp-plate; return status, output and error."""
    words = line.replace("COMMAND", f"{shlex.quote(sys.executable)} -m warp_plate")
    run = subprocess.run(["sh", "-c", words], capture_output=True, text=True, env={**os.environ, **environment})
    return run.returncode, run.stdout, run.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="shells of Unix")
def test_a_search_whose_streams_are_closed_keeps_its_result(write_scene):
    write_scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    assert in_shell(f"COMMAND localize panel.toml {' '.join(QUICK[:-1])} <&- >&- 2>&-") == (0, "", "")
    assert load_result("panel-localize.h5").source == "panel.toml"


@pytest.mark.skipif(sys.platform == "win32", reason="shells of Unix")
def test_a_closed_standard_error_changes_no_status():
    assert in_shell("COMMAND init none 2>&-")[:2] == (2, "")


@pytest.mark.skipif(sys.platform == "win32", reason="shells of Unix")
def test_names_that_are_not_utf8(write_scene, command):
    write_scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    name = os.fsdecode(b"caf\xe9")
    try:
        os.rename("panel.toml", f"{name}.toml")
    except OSError:
        pytest.skip("this file system takes only UTF-8")
    for study, options in (("localize", ""), ("sweep", "--what check --vary drive.frequency=280,290")):
        output_of(command(study, f"{name}.toml", "--device", "cpu", *options.split()))
        assert list(Path().glob(f"{name}-{study}.*"))
    assert load_result(f"{name}-localize.h5").source == r"caf\udce9.toml"
    error_of(command("simulate", f"{name}x.toml"))


def test_names_of_any_letters_are_drawn_exported_and_printed(write_scene, command):
    """They are neither formulas, markup, emoji nor commands of a terminal, and XML cannot hold them as they are."""
    name = "ü $\\frac{1}{$ [b] :smile: \x1b[2J"
    targets = [{"name": key, "area": (0.0, 0.1, 0.0, end)} for key, end in (("a", 0.1), (name, 0.2))]
    actuators = [{"name": key, "area": (x, x + 0.05, 0.1, 0.15)} for key, x in (("b", 0.02), (name, 0.1))]
    tables = {"record": {"times": (0.01,)}, "search": {"particles": 3, "iterations": 2}}
    made = scene_of(title=name, damping=88.5, **tables).model_dump(exclude={"target", "targets", "actuators"})
    write_scene(Scene.model_validate({**made, "targets": targets, "actuators": actuators}))
    lines = ["localize panel.toml --device cpu --no-estimate", "render panel-localize.h5 --out a.svg --device cpu"]
    case = ("--case", f"best {name}")
    for line in (*lines, *(f"export panel-localize.h5 --to {kind}" for kind in ("vtkhdf", "drive-wav"))):
        out = output_of(command(*line.split(), *case * (not line.startswith("localize"))))
        assert out.replace("\n", "").isprintable()
        assert not line.startswith("localize") or out.startswith("ü $\\frac{1}{$ [b] :smile: \\x1b[2J\n")
