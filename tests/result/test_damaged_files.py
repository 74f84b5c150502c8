"""Checkpoints and results that are cut short, changed, made to do harm, or that a full disk has no room for."""

import contextlib
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from warp_plate import CheckpointFile, SceneError, load_checkpoint, load_result, localize, resume, save_result
from warp_plate.cli.main import main
from warp_plate.result.atomic_io import SEAL_BYTES, check_seal, make_seal, write_atomically
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
    """The one line with which a file is refused."""
    with pytest.raises(SceneError) as caught:
        read(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert "\n" not in line
    return line


def test_cut_short_anywhere(kind, written, tmp_path):
    """At every length, by a byte at a time; by way of the whole reader at some of them."""
    content, read = written[kind]
    path = tmp_path / "a.h5"
    path.write_bytes(content)
    with path.open("rb+") as file:
        for length in range(len(content) - 1, -1, -1):
            file.truncate(length)
            assert "damaged" in refused(check_seal if length % 97 else read, path)


@pytest.mark.slow
def test_every_byte_flipped(kind, written, tmp_path):
    content, _ = written[kind]
    path = tmp_path / "a.h5"
    path.write_bytes(content)
    with path.open("rb+", buffering=0) as file:
        for place, byte in enumerate(content):
            for there in (byte ^ 1 << place % 8, byte):
                file.seek(place)
                file.write(bytes([there]))
                if there != byte:
                    assert "damaged" in refused(check_seal, path)
    assert path.read_bytes() == content


def test_longer_than_it_was(kind, written, tmp_path):
    content, read = written[kind]
    for more in (b"\n", b"x" * 100, content, content[-SEAL_BYTES:]):
        (tmp_path / "a.h5").write_bytes(content + more)
        assert "damaged" in refused(read, tmp_path / "a.h5")


def test_bytes_flipped_anywhere(kind, written, tmp_path, random):
    """One bit, a byte, a block of zeros, two bytes exchanged: never a number is read from such a file."""
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
        if bytes(changed) == content:
            read(path)
        else:
            assert "damaged" in refused(read, path)


def test_the_untouched_file_is_read(kind, written, tmp_path):
    content, read = written[kind]
    (tmp_path / "a.h5").write_bytes(content)
    assert read(tmp_path / "a.h5").source == "panel"
    with h5py.File(tmp_path / "a.h5") as file:  # and by everyone else
        assert file.attrs["source"] == "panel"


def test_other_files_are_refused(kind, written, tmp_path, random):
    """Empty, text, noise, noise with a seal, a folder, nothing, and the other kind of file."""
    _, read = written[kind]
    path, noise = tmp_path / "a.h5", random.bytes(5000)
    other = written["result" if kind == "checkpoint" else "checkpoint"][0]
    for content in (b"", b"plate", noise, noise + make_seal(noise), make_seal(b""), other):
        path.write_bytes(content)
        refused(read, path)
    refused(read, tmp_path)
    assert "no such file" in refused(read, tmp_path / "none.h5")


@pytest.fixture
def forged(kind, written, tmp_path):
    """Change a file and seal it again; the line that reading it is refused with."""

    def forge(change):
        content, read = written[kind]
        path = tmp_path / "forged.h5"
        path.write_bytes(content)
        with h5py.File(path, "r+") as file:
            change(file, {"checkpoint": "swarm/positions", "result": "cases/best/displacement"}[kind])
        changed = path.read_bytes()
        path.write_bytes(changed + make_seal(changed))
        return refused(read, path)

    return forge


def test_nothing_outside_the_file_is_read(forged, tmp_path):
    """External links, soft links, data in another file, virtual data and filters are refused by name."""
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["data"] = np.ones((4, 4))
    (tmp_path / "secret.raw").write_bytes(bytes(10**5))
    before = os.stat(secret).st_atime_ns

    def external_link(file, name):
        del file[name]
        file[name] = h5py.ExternalLink(str(secret), "data")

    def soft_link(file, name):
        file["kept"] = file[name]
        del file[name]
        file[name] = h5py.SoftLink("/kept")

    def link_of_a_group(file, name):
        group = name.split("/")[0]
        del file[group]
        file[group] = h5py.ExternalLink(str(secret), "/")

    def external_data(file, name):
        shape, dtype = file[name].shape, file[name].dtype
        del file[name]
        size = int(np.prod(shape)) * dtype.itemsize
        file.create_dataset(name, shape, dtype, external=[(str(tmp_path / "secret.raw"), 0, size)])

    def virtual_data(file, name):
        shape = file[name].shape
        del file[name]
        layout = h5py.VirtualLayout(shape, float)
        layout[...] = h5py.VirtualSource(str(secret), "data", shape)
        file.create_virtual_dataset(name, layout)

    def compressed(file, name):
        values = file[name][()]
        del file[name]
        file.create_dataset(name, data=values, compression="gzip")

    assert "is a link" in forged(external_link)
    assert "is a link" in forged(soft_link)
    assert "is a link" in forged(link_of_a_group)
    assert "in another file or by a filter" in forged(external_data)
    assert "in another file or by a filter" in forged(virtual_data)
    assert "in another file or by a filter" in forged(compressed)
    assert os.stat(secret).st_atime_ns == before


def test_what_is_of_another_kind_is_refused(forged):
    def replaced(values):
        def change(file, name):
            del file[name]
            if values is not None:
                file[name] = values

        return change

    def larger(file, name):
        """As if it held more than the file is long: never asked for in memory."""
        shape = file[name].shape
        del file[name]
        file.create_dataset(name, (10**12, *shape[1:]), float)

    def attribute(name, value):
        def change(file, _):
            file.attrs[name] = value

        return change

    assert "missing" in forged(replaced(None))
    assert "no dataset of real numbers" in forged(replaced(np.array([b"text"])))
    assert "no dataset of real numbers" in forged(replaced(np.ones((4, 4), dtype=complex)))
    assert "has shape" in forged(replaced(np.ones((1, 2, 3, 4, 5))))
    assert "more than the file holds" in forged(larger)
    assert "seed" in forged(attribute("seed", "many"))
    assert "seed" in forged(attribute("seed", -1))
    assert "seed" in forged(attribute("seed", np.inf))
    assert "source" in forged(attribute("source", 7))
    assert "seconds" in forged(attribute("seconds", "[1]"))
    assert "damaged" in forged(attribute("seconds", "[" * 10**5))
    assert "scene" in forged(attribute("scene", "title = 3"))
    assert "its scene" in forged(attribute("scene", "[plate]\nthickness = 1"))
    assert "not a" in forged(attribute("format", "pickle"))


def test_a_swarm_that_does_not_fit_its_scene_is_refused(written, tmp_path):
    path = tmp_path / "a.checkpoint.h5"
    path.write_bytes(written["checkpoint"][0])
    checkpoint = load_checkpoint(path)
    random = checkpoint.search_state["random"]
    for changes in (
        {"random": {}},
        {"random": {**random, "bit_generator": "MT19937"}},
        {"random": {**random, "state": {"state": -1, "inc": 1}}},
        {"random": {**random, "state": {"state": 2**999, "inc": 1}}},
        {"format": "swarm 0"},
    ):
        save_checkpoint(replace(checkpoint, search_state={**checkpoint.search_state, **changes}), path)
        with pytest.raises(SceneError, match=r"^checkpoint: ") as caught:
            resume(load_checkpoint(path))
        assert len(str(caught.value).splitlines()) == 1


@pytest.fixture
def small_disk(tmp_path):
    """(folder, bytes to fill it up with): a file system of its own with little room, where root may mount one."""
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


def fill(folder):
    with contextlib.suppress(OSError), (folder / "ballast").open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))


def test_a_full_disk_loses_nothing(small_disk, scene, monkeypatch, capsys):
    """Checkpoint and result that cannot be written: one line each, the last checkpoint stays and goes on."""
    monkeypatch.chdir(small_disk)
    made = scene((9, 9), damping=88.5, search={"particles": 4, "iterations": 6})
    whole = localize(made, "panel.toml", "cpu", estimate=False)
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    path, warned = Path("panel-localize.checkpoint.h5"), []

    def told(done, total, best):
        if done == 3:
            fill(small_disk)
        if done == 5:
            raise KeyboardInterrupt

    file = CheckpointFile(path, 0, warn=warned.append)
    localize(made, "panel.toml", "cpu", on_progress=told, estimate=False, checkpoints=file)
    assert len(warned) == 1  # not one for each that fails
    assert "panel-localize.checkpoint.h5: cannot be written: No space left on device" in warned[0]
    assert load_checkpoint(path).iterations == 3
    assert load_checkpoint(previous_path(path)).iterations == 2
    with pytest.raises(SystemExit) as left:
        main(["localize", "--resume", str(path), "--no-pictures", "--no-estimate"])
    assert left.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1
    assert "panel-localize.h5: cannot be written: No space left on device" in lines[0]
    assert sorted(entry.name for entry in small_disk.iterdir()) == [
        "ballast", path.name, previous_path(path).name, "panel.toml"
    ]  # fmt: skip
    Path("ballast").unlink()
    checkpoint, word = load_newest(path)
    assert (checkpoint.iterations, word) == (3, None)
    found = resume(checkpoint, estimate=False)
    for name in ("best", "mean", "evaluations"):
        np.testing.assert_array_equal(found.history[name], whole.history[name])
    main(["localize", "--resume", str(path), "--no-pictures", "--no-estimate"])
    assert load_result("panel-localize.h5").cases["best"].energy == whole.cases["best"].energy
    assert not path.exists()


LIMITED = """
import resource, sys
from pathlib import Path
from warp_plate import CheckpointFile, load_checkpoint
from warp_plate.result.atomic_io import write_atomically
from warp_plate.scene.errors import SceneError

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
    """What stands in for a full disk where none can be made: the write fails half-way."""
    (tmp_path / "a.checkpoint.h5").write_bytes(written["checkpoint"][0])
    answer = subprocess.run(
        [sys.executable, "-c", LIMITED],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=True,
    )
    assert answer.stderr == ""
    first, second = answer.stdout.splitlines()
    assert first == "file.bin: cannot be written: File too large; what was there before is kept"
    assert second.startswith("a.checkpoint.h5: cannot be written: File too large")
    assert (tmp_path / "file.bin").read_bytes() == b"whole"
    assert (tmp_path / "a.checkpoint.h5").read_bytes() == written["checkpoint"][0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.checkpoint.h5", "file.bin"]


def test_an_interrupted_swap_leaves_one_that_can_be_read(written, tmp_path, monkeypatch):
    """Whichever of the two renames fails or is never reached, the newest whole one is found."""
    path = tmp_path / "a.checkpoint.h5"
    content = written["checkpoint"][0]
    replace_file = os.replace
    for stop in (0, 1):
        for entry in tmp_path.iterdir():
            entry.unlink()
        path.write_bytes(content)
        calls = []

        def stopped(source, target, stop=stop, calls=calls):
            calls.append(target)
            if len(calls) > stop:
                raise OSError(5, "Input/output error")
            replace_file(source, target)

        monkeypatch.setattr(os, "replace", stopped)
        with pytest.raises(SceneError, match="Input/output error"):
            write_atomically(b"new", path, previous_path(path))
        monkeypatch.setattr(os, "replace", replace_file)
        checkpoint, word = load_newest(path)
        assert checkpoint.source == "panel"
        assert (word is None) == (stop == 0)
        assert [entry.read_bytes() for entry in tmp_path.iterdir()] == [content]
