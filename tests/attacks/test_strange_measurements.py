"""Measurements from strangers: bombs, complex frequencies, loud signals and headings of any length end in a line."""

import io
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy

from support.commands import error_of
from support.scenes import refused
from warp_plate.fitting.measured_matrix import read_matrix
from warp_plate.fitting.measured_modes import read_modes
from warp_plate.fitting.measured_responses import read_responses
from warp_plate.plate.files import read_table
from warp_plate.plate.waveforms import wav_channels
from warp_plate.result.hdf5 import read_arrays
from warp_plate.scene.load import read_beside
from warp_plate.scene.measured import MeasuredScene

FIT = {"fit": {"free": {"plate.young_modulus": (6e8, 2e9)}}}


def refusal_of_responses(path):
    return refused(read_responses, path, 1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"frequency": [10 + 5j, 20, 30], "response": [1, 2, 3j]}, "frequency is complex; only response may be"),
        ({"frequency": [10, 20], "response": [1j, 2], "coherence": [1j, 1]}, "coherence is complex; only response"),
        ({"frequency": [10, 20, 30], "response": [1, 2, 3]}, "response is real; write complex numbers"),
        ({"frequency": [10, 20], "response": h5py.SoftLink("/frequency")}, "response is a link"),
        ({"frequency": h5py.Empty("f8"), "response": [1, 2, 3]}, "frequency is not an array of numbers"),
        ({"frequency": [], "response": np.zeros((0, 3), complex)}, "has 0 responses; the scene has 1 tables"),
    ],
)
def test_odd_arrays(content, message, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in content.items():
            file[name] = values
    assert message in refusal_of_responses(tmp_path / "a.h5")


@pytest.mark.parametrize("way", ["link", "external", "virtual"])
def test_measurements_in_other_files_are_not_read(way, tmp_path):
    """Of a readable file of numbers, as of any other: neither by a link nor by a dataset that is kept there."""
    np.arange(1.0, 3.0).tofile(tmp_path / "numbers.bin")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["response"] = [1.0, 2.0]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frequency"] = [10.0, 20.0]
        if way == "link":
            file["response"] = h5py.ExternalLink("other.h5", "/response")
        elif way == "external":
            file.create_dataset("response", (2,), "f8", external=[(str(tmp_path / "numbers.bin"), 0, 16)])
        else:
            layout = h5py.VirtualLayout((2,), "f8")
            layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "response", (2,))
            file.create_virtual_dataset("response", layout)
    words = "is a link, which" if way == "link" else "is kept in another file"
    assert f"response {words}" in refusal_of_responses(tmp_path / "a.h5")


@pytest.mark.parametrize("ending", ["csv", "h5", "mat", "wav"])
def test_files_that_are_too_large(ending, tmp_path):
    """A measurement, and a file that a scene names."""
    with (tmp_path / f"a.{ending}").open("wb") as file:
        file.truncate(2**27 + 1)
    refusal = "134217729 bytes; at most 134217728 are read"
    assert refusal in refusal_of_responses(tmp_path / f"a.{ending}")
    assert refusal in refused(read_beside, "drive.signal.file", f"a.{ending}", tmp_path)


def test_files_that_may_not_be_read(tmp_path, monkeypatch):
    """Root may read them, so that a mode does not serve."""
    for name in ("a.h5", "a.csv"):
        (tmp_path / name).write_bytes(b"a")
        with monkeypatch.context() as unreadable:
            unreadable.setattr(os, "access", lambda path, mode: mode != os.R_OK)
            assert f"{name}: cannot be read: Permission denied" in refusal_of_responses(tmp_path / name)


def test_scans_that_are_too_large(tmp_path):
    with (tmp_path / "a.h5").open("wb") as file:
        file.truncate(2**30 + 1)
    scene = MeasuredScene(measured={"file": "a.h5"}, target={"area": (0.0, 0.1, 0.0, 0.1)})
    assert "1073741825 bytes; at most 1073741824 are read" in refused(read_matrix, scene.in_folder(tmp_path))


def test_half_precision_is_read_without_warnings(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frequency"], file["real"], file["imaginary"] = np.array([[10, 20, 30], [1, 2, 3], [0, 1, 2]], np.float16)
    np.testing.assert_array_equal(read_responses(tmp_path / "a.h5", 1).responses, [[1, 2 + 1j, 3 + 2j]])


def test_arrays_of_mat_files_are_unpacked_to_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("warp_plate.result.hdf5.UNPACKED_BYTES", 2**16)
    arrays = {"frequency": np.arange(20.0), "response": np.zeros((20, 4096))}
    scipy.io.savemat(tmp_path / "a.mat", arrays, do_compression=True)
    monkeypatch.setattr(scipy.io, "loadmat", None)
    assert "holds more than 4096 numbers when unpacked" in refusal_of_responses(tmp_path / "a.mat")
    for content in (np.array([np.ones(9), "x"], dtype=object), {"a": np.ones(9)}, scipy.sparse.eye_array(3)):
        scipy.io.savemat(tmp_path / "a.mat", {"frequency": [1.0, 2.0], "response": content})
        assert "response is not an array of numbers" in refusal_of_responses(tmp_path / "a.mat")


def test_signalling_nan_is_read_without_warnings(tmp_path):
    values = np.ones(4, np.float32)
    values.view(np.uint32)[1] = 0x7F800001
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frequency"] = values
    content = io.BytesIO()
    scipy.io.wavfile.write(content, 1000, values)
    for read in (read_arrays(tmp_path / "a.h5", ["frequency"])["frequency"], *wav_channels(content.getvalue())[0]):
        assert np.isnan(read).tolist() == [False, True, False, False]


def test_samples_that_a_wav_file_states_but_does_not_hold():
    content = io.BytesIO()
    scipy.io.wavfile.write(content, 1000, np.ones((8, 2), np.int16))
    data = bytearray(content.getvalue())
    at = data.index(b"data") + 4
    with_chunk = data[:12] + b"JUNK\x01\0\0\0ab" + data[12:]
    for each, place in ((data, at), (with_chunk, at + 10)):
        assert wav_channels(bytes(each))[0].shape == (2, 8)
        for stated in (33, 64, 10**9):
            each[place : place + 4] = stated.to_bytes(4, "little")
            with pytest.raises(ValueError, match=f"states {stated} bytes of samples and holds 32"):
                wav_channels(bytes(each))
        each[place : place + 4] = b"\xff" * 4  # of recorders that did not know the end
        assert wav_channels(bytes(each))[0].shape == (2, 8)


def test_no_samples_a_second_are_refused():
    content = io.BytesIO()
    scipy.io.wavfile.write(content, 0, np.ones(8, np.int16))
    with pytest.raises(ValueError, match="states 0 samples a second"):
        wav_channels(content.getvalue())


def test_too_many_samples_of_a_wav_file_are_refused_before_they_are_converted(monkeypatch):
    monkeypatch.setattr("warp_plate.plate.waveforms.MOST_SAMPLES", 15)
    content = io.BytesIO()
    scipy.io.wavfile.write(content, 1000, np.ones((8, 2), np.int16))
    with pytest.raises(ValueError, match="16 samples; at most 15 are read"):
        wav_channels(content.getvalue())


def test_a_mask_of_too_many_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr("warp_plate.plate.files.MOST_NUMBERS", 5)
    (tmp_path / "a.csv").write_text("1,1,1\n1,1,1\n")
    assert "target.mask = 'a.csv': holds 6 numbers; at most 5" in refused(
        read_table, "target.mask", "a.csv", tmp_path, 0, 1
    )


def test_headings_of_any_number_are_shortened(tmp_path):
    for text in (",".join(f"c{number}" for number in range(9999)), ",".join(["c"] * 9999)):
        (tmp_path / "a.csv").write_text(text + "\n")
        assert len(refused(read_modes, tmp_path / "a.csv")) < 400 + len(str(tmp_path))


def test_a_signal_too_loud_for_its_squares(tmp_path):
    scipy.io.wavfile.write(tmp_path / "a.wav", 10_000, np.full((20_000, 2), 1e200))
    assert "numbers up to 1e+30" in refusal_of_responses(tmp_path / "a.wav")


def test_errors_are_lines_that_can_be_read(write_scene, command):
    write_scene(damping=88.5, **FIT)
    Path("a.csv").write_text(",".join(f"name{number}" for number in range(100_000)), encoding="utf-8")
    line = error_of(command("fit", "panel.toml", "--data", "a.csv"))
    assert "a.csv: needs 1 to 200 numbers in a column 'frequency'" in line
    assert len(line) < 11_000
