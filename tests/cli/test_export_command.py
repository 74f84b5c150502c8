"""``warp-plate export``: what each format prints and writes, invalid options, and how MATLAB reads a result."""

import json
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import wavfile

from support.commands import error_of, output_of
from warp_plate import load_result
from warp_plate.analysis.motion import motions

GUIDE = Path(__file__).parents[2] / "docs" / "exports.md"


@pytest.fixture
def result_folder(result_file, tmp_path, monkeypatch):
    """A working folder with the result of the search, run.h5."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(result_file, tmp_path)


def new_files():
    return sorted(path.name for path in Path().iterdir() if path.name != "run.h5")


@pytest.mark.parametrize(
    ("to", "files", "words"),
    [
        ("vtkhdf", ["run.vtkhdf"], "It has the 2 recorded times; --frames 60"),
        ("traces-csv", ["run-traces.csv"], "wrote run-traces.csv\n"),
        ("drive-wav", ["run-drive.wav"], "290 periods of 290 Hz in 48000 samples at 48000 Hz, which repeat seamlessly"),
        ("drive-csv", ["run-drive.csv"], "Drive best: 290 periods"),
    ],
)
def test_each_format(command, result_folder, to, files, words):
    assert words in output_of(command("export", "run.h5", "--to", to))
    assert new_files() == files
    for name in files:
        Path(name).unlink()
    record = json.loads(output_of(command("export", "run.h5", "--to", to, "--json")))
    assert sorted(record["files"]) == files
    assert (record["result"], record["to"]) == ("run.h5", to)
    if to == "vtkhdf":
        assert record["fields"] == ["displacement_best", "displacement_equal", "displacement_single"]
        assert (record["times"], record["recorded"]) == (2, True)


def test_options_of_a_drive(command, result_folder):
    options = "--case single --rate 8000 --duration 0.05 --full-scale 4 --encoding pcm16 --out s.wav --json"
    record = json.loads(output_of(command("export", "run.h5", "--to", "drive-wav", *options.split())))
    drive = load_result("run.h5").cases["single"].phasors
    rate, read = wavfile.read("s.wav")
    assert (record["case"], record["rate"], record["full_scale"]) == ("single", rate, 4.0)
    assert read.shape == (record["samples"], len(record["channels"]))
    assert record["seconds"] == record["samples"] / 8000 <= 0.05
    assert record["periods"] == pytest.approx(290 * record["seconds"] - record["seam_degrees"] / 360)
    np.testing.assert_allclose(read[0] / 32767 * 4, drive.real, atol=1e-4)
    out = command("export", "run.h5", "--to", "drive-csv", "--rate", 8000, "--duration", 0.05)[1]
    assert re.search(r"which repeat with a phase jump of -?\d\.?\d* degrees\. 1\.0 stands for", out)


def test_a_motion_repeats_the_run(command, result_folder):
    options = ("--case", "best", "--case", "single", "--start", 0.002, "--end", 0.004, "--frames", 4, "--device", "cpu")
    assert "recorded times" not in command("export", "run.h5", "--to", "vtkhdf", *options)[1]
    record = json.loads(output_of(command("export", "run.h5", "--to", "vtkhdf", *options, "--json")))
    assert (record["times"], record["recorded"], record["files"]) == (4, False, ["run.vtkhdf"])
    names = ("displacement", "velocity", "rms_velocity")
    assert record["fields"] == [f"{name}_{case}" for name in names for case in ("best", "single")]
    recorded = load_result("run.h5")
    with h5py.File("run.vtkhdf") as file:
        root = file["VTKHDF"]
        assert root["Steps/Values"][0] == pytest.approx(recorded.times[0])
        assert root["PointData/velocity_best"].attrs["units"] == "m/s"
        assert np.abs(root["PointData/velocity_best"]).max() > 0
        first = root["PointData/displacement_single"][0]
        (moved,) = motions(recorded.scene, {"best": recorded.cases["best"]}, (0.002, 0.004), 4, "cpu")
        np.testing.assert_array_equal(root["PointData/rms_velocity_best"], moved.rms_velocity[None].astype("<f4"))
        assert root["PointData/rms_velocity_best"].attrs["units"] == "m/s"
        assert root["Steps/PointDataOffsets/rms_velocity_best"][:].tolist() == [0] * 4
    np.testing.assert_array_equal(first, recorded.cases["single"].displacement[0])


def test_invalid_options_are_one_line(command, result_folder):
    for options, line in (
        ("--to vtkhdf --rate 3", "--rate 3: has no effect with --to vtkhdf; leave it out"),
        ("--to vtkhdf --case worst", "--case 'worst': must be one of"),
        ("--to drive-wav --case best --case single", "--case best single: a file holds one drive"),
        ("--to vtkhdf --device cpu", "--device cpu: nothing is run without --frames, --start or --end; leave it out"),
        ("--to vtkhdf --frames 1", "Must be >= 2."),
        ("--to vtkhdf --start 3", "--start 3"),
        ("--to vtkhdf --out run.vtk", "--out run.vtk: must end in .vtkhdf"),
    ):
        assert line in error_of(command("export", "run.h5", *options.split()))
        assert new_files() == []


def test_matlab_can_read_a_result(command, result_folder):
    """Datasets hold plain numbers (no compounds, enumerations or references) or text, attributes text in UTF-8, but for
    those of netCDF's dimensions; those of the guide's example exist, with the dimensions that it states."""
    example, *_, series = re.findall(r"```matlab\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.S)
    datasets = re.findall(r"h5read\(f, '([^']+)'\)", example)
    attributes = re.findall(r"h5readatt\(f, '([^']+)', '([^']+)'\)", example)
    assert (len(example.splitlines()), len(datasets), len(attributes)) == (10, 8, 2)

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            text = h5py.check_string_dtype(item.dtype)
            assert text or (item.dtype.kind in "fiu" and h5py.check_enum_dtype(item.dtype) is None), name
        for key, value in item.attrs.items():
            if key in ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST"):
                continue
            kind = h5py.check_string_dtype(item.attrs.get_id(key).dtype)
            assert kind.encoding == "utf-8" if isinstance(value, str) else isinstance(value, np.integer), (name, key)

    with h5py.File("run.h5") as file:
        visit("/", file)
        file.visititems(visit)
        assert all(isinstance(file[name], h5py.Dataset) for name in datasets)
        assert all(attribute in file[name].attrs for name, attribute in attributes)
        assert file["/cases/best/displacement"].shape == (2, len(file["/y"]), len(file["/x"]))
        phasors = file["/cases/best/magnitude"][:] * np.exp(-1j * file["/cases/best/phase"][:])
    np.testing.assert_allclose(phasors, load_result("run.h5").cases["best"].phasors)
    command("export", "run.h5", "--to", "vtkhdf", "--frames", 20, "--device", "cpu")
    names = re.findall(r"h5read\('paper-localize\.vtkhdf', '([^']+)'\)", series)
    with h5py.File("run.vtkhdf") as file:
        assert [file[name].shape for name in names] == [(20, 13, 13), (1, 13, 13), (20,)]
