"""Files that refer to the same data again and again are refused before they fill the memory.

Each is read in a process of its own with a limit on its memory.
"""

import struct
import subprocess
import sys

import h5py
import numpy as np
import pytest

from support.forged import forge
from support.scenes import scene_of
from warp_plate import CheckpointFile, localize, save_result
from warp_plate.result.atomic_io import SEAL_BYTES, make_seal

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit on the memory of a process")
TEXT, MANY = 2**22, 3900
READ = """
import resource, sys
from pathlib import Path
from warp_plate import SceneError, load_checkpoint, load_result
from warp_plate.result.hdf5 import FileFormat, read_array

resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))
way, path = sys.argv[1:]
try:
    if way == "texts":
        with FileFormat("sweep", 1).open(path) as file:
            read_array(file, "reason", text=True)
    else:
        (load_result if way == "result" else load_checkpoint)(path)
except SceneError as error:
    print(error)
"""


def refusal_of(way, path):
    """Return why a file is refused."""
    run = subprocess.run([sys.executable, "-c", READ, way, path], capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (0, "")
    (line,) = run.stdout.splitlines()
    return line


@pytest.fixture(scope="module")
def forged_files(tmp_path_factory):
    """The path of a checkpoint and of a result, with their contents beside them."""
    folder = tmp_path_factory.mktemp("written")
    scene = scene_of((9, 9), damping=88.5, search={"particles": 4, "iterations": 2})
    file = CheckpointFile(folder / "a.checkpoint.h5", 0)
    save_result(localize(scene, source="panel", device="cpu", estimate=False, checkpoints=file), folder / "a.h5")
    for path in (file.path, folder / "a.h5"):
        path.with_suffix(".right").write_bytes(path.read_bytes())
    return {"checkpoint": file.path, "result": folder / "a.h5"}


def point_at_one_text(path):
    """Let all references of an array of texts lead to the first of them, and seal the file."""
    content = bytearray(path.read_bytes())
    first = content.index(struct.pack("<I", TEXT))
    while struct.unpack_from("<I", content, first + 16) != (1,):
        first = content.index(struct.pack("<I", TEXT), first + 1)
    content[first : first + 16 * MANY] = content[first : first + 16] * MANY
    path.write_bytes(content + make_seal(bytes(content)))


def test_an_attribute_of_many_texts(forged_files):
    path = forged_files["result"]

    def change(file):
        file.attrs["source"] = np.array(["x" * TEXT, *["y"] * (MANY - 1)], dtype=h5py.string_dtype())

    forge(path, change)
    path.write_bytes(path.read_bytes()[:-SEAL_BYTES])
    point_at_one_text(path)
    assert "attribute source is more than a single value" in refusal_of("result", path)


def test_a_dataset_of_many_texts(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "warp-plate sweep 1"
        file["reason"] = np.array(["x" * TEXT, *["y"] * (MANY - 1)], dtype=h5py.string_dtype())
    point_at_one_text(path)
    assert "reason and what was read before take 4 times as much memory as the file" in refusal_of("texts", path)


def test_many_names_of_one_dataset(forged_files):
    path = forged_files["checkpoint"]

    def change(file):
        file["swarm/x"] = np.zeros(TEXT // 8)
        for index in range(2000):
            file[f"swarm/x{index}"] = file["swarm/x"]

    forge(path, change)
    assert "take 4 times as much memory as the file" in refusal_of("checkpoint", path)


def test_many_names_of_one_case(forged_files):
    path = forged_files["result"]

    def change(file):
        for index in range(5000):
            file[f"cases/x{index}"] = file["cases/equal"]

    forge(path, change)
    assert "take 4 times as much memory as the file" in refusal_of("result", path)


def test_groups_that_each_hold_the_next_twice(forged_files):
    path = forged_files["result"]

    def change(file):
        group = file.require_group("objectives_of")
        for _ in range(40):
            following = group.create_group("next")
            group["again"] = following
            group = following

    forge(path, change)
    assert "take 4 times as much memory as the file" in refusal_of("result", path)


def test_chunks(forged_files):
    """A chunk may be far larger than what is in it."""
    path = forged_files["checkpoint"]

    def change(file):
        file["swarm"].create_dataset(
            "x", shape=(1,), maxshape=(None,), chunks=(2**28,), dtype=float, compression="gzip"
        )

    forge(path, change)
    assert "swarm/x is in chunks" in refusal_of("checkpoint", path)
