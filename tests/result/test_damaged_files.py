"""Checkpoints and results that are cut short, changed, or that a full disk has no room for."""

import contextlib
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from warp_plate import CheckpointFile, SceneError, load_checkpoint, load_result, localize, resume, save_result
from warp_plate.cli.main import main
from warp_plate.result.atomic_io import SEAL_BYTES, atomic_paths, check_seal, make_seal, write_atomically
from warp_plate.result.checkpoint import load_newest, previous_path, save_checkpoint
from warp_plate.scene.dump import dump_scene

ROOT = Path(__file__).parents[2]
SMALL = {"search": {"particles": 4, "iterations": 3}, "record": {"points": ((0.1, 0.1),)}}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A checkpoint and a result, as bytes by kind, with the function that reads each."""
    from conftest import scene_of

    folder = tmp_path_factory.mktemp("written")
    file = CheckpointFile(folder / "a.checkpoint.h5", 0)
    result = localize(scene_of((9, 9), damping=88.5, **SMALL), "panel", "cpu", estimate=False, checkpoints=file)
    save_result(result, folder / "a.h5")
    return {
        "checkpoint": (file.path.read_bytes(), load_checkpoint),
        "result": ((folder / "a.h5").read_bytes(), load_result),
    }


@pytest.fixture(params=["checkpoint", "result"])
def kind(request):
    return request.param


def refused(read, path):
    """Return the one line with which a file is refused."""
    with pytest.raises(SceneError) as caught:
        read(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert "\n" not in line
    return line


def test_a_file_cut_short_is_refused(written, tmp_path):
    """At every length, by the seal; at some lengths by the whole reader."""
    content, read = written["checkpoint"]
    path = tmp_path / "a.h5"
    path.write_bytes(content)
    with path.open("rb+") as file:
        for length in range(len(content) - 1, -1, -1):
            file.truncate(length)
            assert "damaged" in refused(check_seal if length % 997 else read, path)


def test_a_changed_file_is_refused(kind, written, tmp_path, random):
    """Change one bit, a byte, a block of zeros, two bytes exchanged, or bytes at the end."""
    content, read = written[kind]
    path = tmp_path / "a.h5"
    seal = range(len(content) - SEAL_BYTES, len(content))
    for place in [*seal, *range(100), *random.integers(0, len(content), 300).tolist()]:
        changed = bytearray(content)
        how = int(random.integers(4))
        if how == 0:
            changed[place] ^= 1 << int(random.integers(8))
        elif how == 1:
            changed[place] = int(random.integers(256))
        elif how == 2:
            changed[place : place + 64] = bytes(len(changed[place : place + 64]))
        else:
            other = int(random.integers(len(content)))
            changed[place], changed[other] = changed[other], changed[place]
        path.write_bytes(changed)
        if bytes(changed) != content:
            assert "damaged" in refused(read, path)
    for more in (b"\n", b"x" * 100, content, content[-SEAL_BYTES:]):
        path.write_bytes(content + more)
        assert "damaged" in refused(read, path)
    path.write_bytes(content)
    assert read(path).source == "panel"


def test_other_files_are_refused(kind, written, tmp_path, random):
    """Empty, text, noise, noise with a seal, the other kind of file, a folder, a pipe, and no file."""
    _, read = written[kind]
    path, noise = tmp_path / "a.h5", random.bytes(5000)
    other = written["result" if kind == "checkpoint" else "checkpoint"][0]
    for content in (b"", b"plate", noise, noise + make_seal(noise), make_seal(b"")):
        path.write_bytes(content)
        assert "damaged" in refused(read, path)
    path.write_bytes(other)
    assert f"not a {kind} of warp-plate" in refused(read, path)
    refused(read, tmp_path)
    assert "no such file" in refused(read, tmp_path / "none.h5")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.h5")
        refused(read, tmp_path / "pipe.h5")


def test_a_checkpoint_that_contradicts_itself_is_refused(written, tmp_path):
    path = tmp_path / "a.checkpoint.h5"
    path.write_bytes(written["checkpoint"][0])
    checkpoint = load_checkpoint(path)
    state, random = checkpoint.search_state, checkpoint.search_state["random"]
    for changes in (
        {"random": {}},
        {"random": {**random, "bit_generator": "MT19937"}},
        {"random": {**random, "state": {"state": -1, "inc": 1}}},
        {"format": "swarm 0"},
    ):
        save_checkpoint(replace(checkpoint, search_state={**state, **changes}), path)
        with pytest.raises(SceneError, match=r"^checkpoint: ") as caught:
            resume(load_checkpoint(path))
        assert len(str(caught.value).splitlines()) == 1
    accuracy = {"accuracy": 0.01}
    for changes, words in (
        ({"single_actuator": 3}, "single is 3, of 3 actuators"),
        ({"evaluator": "guess"}, "evaluator"),
        ({"matrices": np.ones((2, 5, 6))}, "matrices has shape"),
        ({"scene": checkpoint.scene.with_tables(effects={"stretching": {}})}, "matrices do not fit"),
        ({"scene": checkpoint.scene.with_tables(grid=accuracy)}, "has no grid"),
    ):
        save_checkpoint(replace(checkpoint, **changes), path)
        assert words in refused(load_checkpoint, path)


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a file system of its own with little room, where root may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = shutil.which("mount")
    if os.name != "posix" or mount is None or os.geteuid() != 0:
        pytest.skip("only root may mount a small file system; the test with a limit on file sizes stands in")
    options = ["-t", "tmpfs", "-o", "size=160k", "tmpfs", str(folder)]
    if subprocess.run([mount, *options], capture_output=True, check=False).returncode:
        pytest.skip("no file system may be mounted here; the test with a limit on file sizes stands in")
    try:
        yield folder
    finally:
        os.chdir(tmp_path)
        subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_loses_nothing(small_disk, scene, monkeypatch, capsys):
    """Get one line each for a checkpoint and a result that cannot be written; the last checkpoint stays and goes on."""
    monkeypatch.chdir(small_disk)
    made = scene((9, 9), damping=88.5, search={"particles": 4, "iterations": 6})
    whole = localize(made, "panel.toml", "cpu", estimate=False)
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    path, warned = Path("panel-localize.checkpoint.h5"), []

    def fill_disk_and_stop(done, total, best):
        if done == 3:
            with contextlib.suppress(OSError), Path("ballast").open("wb", buffering=0) as file:
                while True:
                    file.write(bytes(4096))
        if done == 5:
            raise KeyboardInterrupt

    file = CheckpointFile(path, 0, warn=warned.append)
    localize(made, "panel.toml", "cpu", on_progress=fill_disk_and_stop, estimate=False, checkpoints=file)
    assert len(warned) == 1  # not one for each that fails
    assert "panel-localize.checkpoint.h5: cannot be written: No space left on device" in warned[0]
    assert load_checkpoint(path).iterations == 3
    assert load_checkpoint(previous_path(path)).iterations == 2
    with pytest.raises(SystemExit) as left:
        main(["localize", "--resume", str(path), "--no-pictures", "--no-estimate"])
    captured = capsys.readouterr()
    assert (left.value.code, captured.out) == (2, "")
    (line,) = captured.err.splitlines()
    assert "panel-localize.h5: cannot be written: No space left on device" in line
    names = {entry.name for entry in small_disk.iterdir()}
    assert names == {"ballast", path.name, previous_path(path).name, "panel.toml"}
    Path("ballast").unlink()
    checkpoint, word = load_newest(path)
    assert (checkpoint.iterations, word) == (3, None)
    main(["localize", "--resume", str(path), "--no-pictures", "--no-estimate"])
    loaded = load_result("panel-localize.h5")
    assert loaded.cases["best"].energy == whole.cases["best"].energy
    for name, values in whole.history.items():
        np.testing.assert_array_equal(loaded.history[name], values)
    assert not path.exists()


LIMITED = """
import resource
from pathlib import Path
from warp_plate import CheckpointFile, SceneError, load_checkpoint
from warp_plate.result.atomic_io import write_atomically

resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
path = Path("file.bin")
write_atomically(b"whole", path)
try:
    write_atomically(bytes(30000), path)
except SceneError as error:
    print(error)
checkpoint = load_checkpoint(Path("a.checkpoint.h5"))
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 20000))
CheckpointFile(Path("a.checkpoint.h5"), 0, True, print).save(checkpoint)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit on the size of files")
def test_a_limit_on_the_size_of_files(written, tmp_path):
    """A write that fails half-way, where no full disk can be made, keeps the old files."""
    (tmp_path / "a.checkpoint.h5").write_bytes(written["checkpoint"][0])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", LIMITED]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment, check=True)
    assert answer.stderr == ""
    first, second = answer.stdout.splitlines()
    assert first.startswith("file.bin: cannot be written: File too large")
    assert second.startswith("a.checkpoint.h5: cannot be written: File too large")
    found = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert found == {"file.bin": b"whole", "a.checkpoint.h5": written["checkpoint"][0]}


def test_an_interrupted_swap_leaves_one_that_can_be_read(written, tmp_path, monkeypatch):
    """Whichever rename fails, the newest complete checkpoint is found; nothing is renamed before a flush."""
    path, content = tmp_path / "a.checkpoint.h5", written["checkpoint"][0]
    replace_file, flush, calls = os.replace, os.fsync, []
    monkeypatch.setattr(os, "fsync", lambda handle: (calls.append("flush"), flush(handle)))
    for stop in (0, 1):
        for entry in tmp_path.iterdir():
            entry.unlink()
        path.write_bytes(content)
        calls.clear()

        def stopped(source, target, stop=stop):
            calls.append("rename")
            if calls.count("rename") > stop:
                raise OSError(5, "Input/output error")
            replace_file(source, target)

        monkeypatch.setattr(os, "replace", stopped)
        with pytest.raises(SceneError, match="Input/output error"):
            write_atomically(b"new", path, previous_path(path))
        assert calls[:2] == ["flush", "rename"]
        monkeypatch.setattr(os, "replace", replace_file)
        checkpoint, word = load_newest(path)
        assert checkpoint.source == "panel"
        assert (word is None) == (stop == 0)
        assert [entry.read_bytes() for entry in tmp_path.iterdir()] == [content]


def test_several_files_are_written_completely_or_not_at_all(tmp_path):
    paths = first, _ = tmp_path / "first", tmp_path / "last"
    first.write_text("old")

    def fail(error):
        with atomic_paths(*paths) as temporaries:
            for temporary in temporaries:
                temporary.write_text("new")
            raise error

    for error, caught in ((KeyboardInterrupt(), KeyboardInterrupt), (OSError(28, "No space left"), SceneError)):
        with pytest.raises(caught):
            fail(error)
        assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("first", "old")]
    with atomic_paths(*paths) as temporaries:
        for name, temporary in zip(("1", "2"), temporaries, strict=True):
            temporary.write_text(name)
    assert sorted((path.name, path.read_text()) for path in tmp_path.iterdir()) == [("first", "1"), ("last", "2")]
    (tmp_path / "other").touch()
    assert first.stat().st_mode == (tmp_path / "other").stat().st_mode
    with pytest.raises(SceneError, match=r"file: cannot be written"), atomic_paths(tmp_path / "nowhere" / "file"):
        pass
