"""Checkpoints and results that are cut short, changed, or that the disk has no room for."""

import os
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from support.scenes import refused, scene_of
from warp_plate import CheckpointFile, SceneError, load_checkpoint, load_result, localize, resume, save_result
from warp_plate.result.atomic_io import SEAL_BYTES, atomic_paths, make_seal, write_atomically
from warp_plate.result.checkpoint import save_checkpoint
from warp_plate.result.hdf5 import FileFormat

SMALL = {"search": {"particles": 4, "iterations": 3}, "record": {"points": ((0.1, 0.1),)}}


@pytest.fixture(scope="module")
def written_files(tmp_path_factory):
    """A checkpoint and a result, as bytes by kind, with the function that reads each."""
    folder = tmp_path_factory.mktemp("written")
    file = CheckpointFile(folder / "a.checkpoint.h5", 0)
    result = localize(
        scene_of((9, 9), damping=88.5, **SMALL), source="panel", device="cpu", estimate=False, checkpoints=file
    )
    save_result(result, folder / "a.h5")
    return {
        "checkpoint": (file.path.read_bytes(), load_checkpoint),
        "result": ((folder / "a.h5").read_bytes(), load_result),
    }


def refusal_of(read, path):
    """Return the one line with which a file is refused."""
    line = refused(read, path)
    assert line.startswith(f"{path}: ")
    return line


@pytest.mark.parametrize("kind", ["checkpoint", "result"])
def test_a_changed_file_is_refused(kind, written_files, tmp_path, random):
    """Cut it short, change a bit, zero a block, exchange two bytes, or append bytes."""
    content, read = written_files[kind]
    path, length = tmp_path / "a.h5", len(content)
    places = [*range(length - SEAL_BYTES, length), *range(0, 100, 7), *random.integers(0, length, 60).tolist()]
    changed = [content + more for more in (b"\n", b"x" * 100, content, content[-SEAL_BYTES:])]
    for place in places:
        other, swapped = int(random.integers(length)), bytearray(content)
        swapped[place], swapped[other] = swapped[other], swapped[place]
        bit = bytes([content[place] ^ 1 << int(random.integers(8))])
        ways = content[:place], content[:place] + bit + content[place + 1 :], bytes(swapped)
        changed.append(ways[int(random.integers(3))])
    for wrong in changed:
        path.write_bytes(wrong)
        if wrong != content:
            assert "damaged" in refusal_of(read, path)
    path.write_bytes(content)
    assert read(path).source == "panel"


@pytest.mark.parametrize("kind", ["checkpoint", "result"])
def test_the_last_line_is_verified_before_hdf5_opens_a_file(kind, written_files, tmp_path, monkeypatch):
    content, read = written_files[kind]
    data, line = content[: content.rindex(b"\nwarp-plate")], content.splitlines()[-1].decode()
    assert line == f"warp-plate sha256 {sha256(data).hexdigest()} of {len(data):020d} bytes"
    (tmp_path / "a.h5").write_bytes(content[:100] + bytes([content[100] ^ 1]) + content[101:])
    monkeypatch.setattr("h5py.File", None)
    assert "damaged" in refusal_of(read, tmp_path / "a.h5")


@pytest.mark.parametrize("kind", ["checkpoint", "result"])
def test_other_files_are_refused(kind, written_files, tmp_path, random, monkeypatch):
    _, read = written_files[kind]
    path, noise = tmp_path / "a.h5", random.bytes(5000)
    for content in (b"", b"plate", noise, noise + make_seal(noise), make_seal(b"")):
        path.write_bytes(content)
        assert "damaged" in refusal_of(read, path)
    path.write_bytes(written_files["result" if kind == "checkpoint" else "checkpoint"][0])
    assert f"not a {kind} of warp-plate" in refusal_of(read, path)
    refusal_of(read, tmp_path)
    assert "no such file" in refusal_of(read, tmp_path / "none.h5")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.h5")
        refusal_of(read, tmp_path / "pipe.h5")
        (tmp_path / "loop.h5").symlink_to(tmp_path / "loop.h5")
        assert "cannot be read: Too many levels" in refusal_of(read, tmp_path / "loop.h5")
    monkeypatch.setattr(Path, "read_bytes", Mock(side_effect=PermissionError(13, "Permission denied")))
    assert refusal_of(read, path) == f"{path}: cannot be read: Permission denied"


def test_a_checkpoint_that_contradicts_itself_is_refused(written_files, tmp_path):
    path = tmp_path / "a.checkpoint.h5"
    path.write_bytes(written_files["checkpoint"][0])
    checkpoint = load_checkpoint(path)
    state, random = checkpoint.search_state, checkpoint.search_state["random"]
    for changes in (
        {"random": {}},
        {"random": {**random, "bit_generator": "MT19937"}},
        {"random": {**random, "state": {"state": -1, "inc": 1}}},
        {"format": "swarm 0"},
    ):
        save_checkpoint(replace(checkpoint, search_state={**state, **changes}), path)
        assert refused(lambda: resume(load_checkpoint(path))).startswith("checkpoint: ")
    for changes, words in (
        ({"evaluator": "guess"}, "evaluator"),
        ({"matrices": np.ones((2, 5, 6))}, "matrices has shape"),
    ):
        save_checkpoint(replace(checkpoint, **changes), path)
        assert words in refusal_of(load_checkpoint, path)


def test_a_limit_on_the_size_of_files(written_files, tmp_path, caplog):
    """Writes that fail half-way, as on a full disk, keep the old files; a search warns of it once."""
    resource = pytest.importorskip("resource", reason="Windows has no limit on the size of files")
    binary, path = tmp_path / "file.bin", tmp_path / "a.checkpoint.h5"
    write_atomically(b"whole", binary)
    path.write_bytes(written_files["checkpoint"][0])
    checkpoint, file = load_checkpoint(path), CheckpointFile(path, 0)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, before[1]))
    try:
        with pytest.raises(SceneError, match=r"file\.bin: cannot be written: File too large"):
            write_atomically(bytes(30000), binary)
        file.save(checkpoint)
        file.save(checkpoint)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    (line,) = caplog.messages
    assert line.startswith(f"{path}: cannot be written: File too large")
    found = {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()}
    assert found == {"file.bin": b"whole", "a.checkpoint.h5": written_files["checkpoint"][0]}


def test_files_are_composed_side_by_side(tmp_path):
    """As by threads that save at once."""
    layout = FileFormat("result", 1)
    with layout.create(tmp_path / "a.h5") as one, layout.create(tmp_path / "b.h5") as other:
        one["number"], other["number"] = 1, 2
    for name, number in (("a.h5", 1), ("b.h5", 2)):
        with layout.open(tmp_path / name) as file:
            assert file["number"][()] == number


def test_a_rename_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    """Nothing is renamed before a flush."""
    path, flush, calls = tmp_path / "a.checkpoint.h5", os.fsync, []
    path.write_bytes(b"old")

    def stopped(source, target):
        calls.append("rename")
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", lambda handle: (calls.append("flush"), flush(handle)))
    monkeypatch.setattr(os, "replace", stopped)
    with pytest.raises(SceneError, match="Input/output error"):
        write_atomically(b"new", path)
    assert calls == ["flush", "rename"]
    assert [entry.read_bytes() for entry in tmp_path.iterdir()] == [b"old"]


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
