"""Unusual environments: caches that cannot be written or are damaged, too many threads, output by links and pipes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.commands import error_of, output_of
from warp_plate import load_result

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


@pytest.mark.slow
def test_a_kernel_cut_short(write_scene, tmp_path):
    write_scene(damping=88.5)
    cache = {"WARP_CACHE_PATH": str(tmp_path / "cache")}
    output_of(simulate(**cache))
    for file in tmp_path.glob("cache/*/*/*.o"):
        file.write_bytes(file.read_bytes()[:-1000])
    status, _, err = simulate(**cache)
    assert status == 2
    assert "delete this folder of compiled kernels" in err.splitlines()[-1]  # LLVM has a line before


@pytest.mark.parametrize("threads", ["1025", "1000000", "9" * 5000, "-1", "²"])
def test_too_many_threads(threads, write_scene, command, monkeypatch):
    write_scene(damping=88.5)
    monkeypatch.setenv("WARP_PLATE_THREADS", threads)
    assert "WARP_PLATE_THREADS" in error_of(command("simulate", "panel.toml", *QUICK, "--path", "resident"))


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
def test_a_pipe_is_refused(write_scene, command):
    write_scene(damping=88.5)
    os.mkfifo("pipe.h5")
    assert "is a pipe" in error_of(command("simulate", "panel.toml", *QUICK, "--out", "pipe.h5"))
    assert Path("pipe.h5").is_fifo()


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


def test_a_backend_of_matplotlib_that_it_does_not_know(write_scene):
    write_scene(damping=88.5)
    line = [sys.executable, "-m", "warp_plate", "frf", "panel.toml", "--range", "100:200"]
    run = subprocess.run(line, capture_output=True, text=True, env={**os.environ, "MPLBACKEND": "none"})
    assert (run.returncode, run.stderr) == (0, "")
    assert list(Path().glob("*.png"))


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
