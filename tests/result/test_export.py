"""Exports, read back by other programs' readers: VTK, SciPy's WAV reader, Python's csv."""

import csv
import os
import stat
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from fractions import Fraction

import h5py
import numpy as np
import pytest
from scipy.io import wavfile

from warp_plate.result import Case, Result
from warp_plate.result.atomic_io import atomic_paths
from warp_plate.result.export.drive_signals import BLOCK, make_drive_signal, whole_periods, write_drive_csv, write_wav
from warp_plate.result.export.paraview import write_pvd, write_vtkhdf
from warp_plate.result.export.traces import write_traces
from warp_plate.scene import SceneError

NODES, SIZE, TIMES = (13, 9), (0.3, 0.2), (0.001, 0.0035, 0.012)
POINTS = ((0.1, 0.05), (0.15, 0.1))
NEEDS_VTK = "PyVista is not installed: pip install 'warp-plate[viz]'"


@pytest.fixture
def result(random, scene):
    """A plate that is not square, with numbers that differ every time; names that formats must quote."""
    made = scene(NODES, SIZE, record={"times": TIMES, "points": POINTS})
    names = ('left, "upper"', "größer & <right>", "3")
    actuators = tuple(
        actuator.model_copy(update={"name": name}) for actuator, name in zip(made.actuators, names, strict=True)
    )
    made = made.model_copy(update={"actuators": actuators})

    def case():
        return Case(
            phasors=random.normal(size=3) + 1j * random.normal(size=3),
            energy={"plate": 2.0, "target": 1.0},
            displacement=random.normal(scale=1e-7, size=(3, *NODES[::-1])).astype(np.float32),
            trace=random.normal(scale=1e-7, size=(2, 150)).astype(np.float32),
        )

    return Result(
        command="localize",
        source="panel.toml",
        scene=made,
        device="cpu",
        seed=0,
        effects=(),
        cases={name: case() for name in ("best", "equal")},
        times=np.array(TIMES),
        trace_times=8e-5 * np.arange(150),
        seconds={},
        node_steps=1,
    )


def displacements(result):
    return {f"displacement_{name}": case.displacement for name, case in result.cases.items()}


def check_field(mesh, result, index):
    """One time of a series as VTK reads it: x fastest, float32 as it was."""
    assert mesh.dimensions == (*NODES, 1)
    assert mesh.bounds == pytest.approx((0, SIZE[0], 0, SIZE[1], 0, 0))
    for name, case in result.cases.items():
        read = np.asarray(mesh.point_data[f"displacement_{name}"])
        assert read.dtype == np.float32
        np.testing.assert_array_equal(read.reshape(NODES[::-1]), case.displacement[index])
    assert mesh.active_scalars_name == "displacement_best"
    # The target is the lower left quarter, and the middle lines count half.
    row, column = (np.where(np.arange(n) < n // 2, 1.0, np.where(np.arange(n) == n // 2, 0.5, 0)) for n in NODES[::-1])
    row[0], column[0] = 0.5, 0.5
    target = np.asarray(mesh.point_data["target"]).reshape(NODES[::-1])
    np.testing.assert_allclose(target, np.outer(row, column), atol=1e-6)
    cell = SIZE[0] / (NODES[0] - 1) * SIZE[1] / (NODES[1] - 1)
    areas = [(x1 - x0) * (y1 - y0) for x0, x1, y0, y1 in (actuator.area for actuator in result.scene.actuators)]
    assert mesh.point_data["actuators"].sum() * cell == pytest.approx(sum(areas), rel=1e-5)


def test_a_pvd_series_reads_back_in_vtk(result, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason=NEEDS_VTK)
    files = write_pvd(result.scene, result.times, displacements(result), tmp_path / "run & more.pvd")
    assert sorted(tmp_path.iterdir()) == sorted(files)
    reader = pyvista.get_reader(files[-1])
    assert reader.time_values == list(TIMES)
    for index, time in enumerate(TIMES):
        reader.set_active_time_value(time)
        (mesh,) = reader.read()
        check_field(mesh, result, index)
        assert mesh.field_data["TimeValue"] == [time]
        array = mesh.GetPointData().GetArray("displacement_best")
        assert array.GetInformation().Get(array.UNITS_LABEL()) == "m"


def test_a_vtkhdf_series_reads_back_in_vtk(result, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason=NEEDS_VTK)
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    (path,) = write_vtkhdf(result.scene, result.times, displacements(result), tmp_path / "run.vtkhdf")
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert times == TIMES
    for index in (2, 0, 1):
        reader.UpdateTimeStep(TIMES[index])
        check_field(pyvista.wrap(reader.GetOutputDataObject(0)), result, index)


def test_series_files_are_what_their_formats_ask_for(result, tmp_path):
    """Without VTK: well-formed XML that names its parts, and plain HDF5 of the documented layout."""
    *parts, index = write_pvd(result.scene, result.times, displacements(result), tmp_path / 'a "b" & c.pvd')
    entries = ElementTree.parse(index).getroot().findall("Collection/DataSet")
    assert [tmp_path / entry.get("file") for entry in entries] == parts
    for part in parts:
        assert ElementTree.parse(part).getroot().get("type") == "ImageData"
    (path,) = write_vtkhdf(result.scene, result.times, displacements(result), tmp_path / "run.vtkhdf")
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        assert root["PointData/displacement_equal"].shape == (3, *NODES[::-1])
        assert root["Steps"].attrs["NSteps"] == 3
        assert root["Steps/PointDataOffsets/displacement_equal"][:].tolist() == [0, 1, 2]
        assert root["Steps/PointDataOffsets/target"][:].tolist() == [0, 0, 0]


def test_traces_read_back_from_csv(result, tmp_path):
    (path,) = write_traces(result, result.cases, tmp_path / "traces.csv")
    with path.open(encoding="utf-8", newline="") as file:
        heading, *rows = csv.reader(file)
    assert heading == [
        "time [s]",
        "best u(x=0.1 y=0.05) [m]",
        "best u(x=0.15 y=0.1) [m]",
        "equal u(x=0.1 y=0.05) [m]",
        "equal u(x=0.15 y=0.1) [m]",
    ]
    read = np.array(rows, dtype=float)
    np.testing.assert_allclose(read[:, 0], result.trace_times, rtol=1e-14, atol=0)
    expected = np.concatenate([case.trace for case in result.cases.values()]).T
    np.testing.assert_array_equal(read[:, 1:].astype(np.float32), expected)


def played(signal, drive):
    """What a channel must play, written as the load is: Re(Z exp(iωt)) [N/m²]."""
    time = np.arange(signal.samples) / signal.rate
    return (np.exp(2j * np.pi * 290.0 * time)[:, None] * drive).real


def test_a_float_wav_plays_the_drive(result, tmp_path):
    case = result.cases["best"]
    signal = make_drive_signal(result.scene, case, 48000, 2.0)
    assert signal.samples == 96000 > BLOCK
    (path,) = write_wav(signal, tmp_path / "drive.wav")
    rate, read = wavfile.read(path)
    assert (rate, read.dtype, read.shape) == (48000, np.float32, (96000, 3))
    np.testing.assert_allclose(read * signal.full_scale, played(signal, case.phasors), atol=1e-6 * signal.full_scale)
    assert signal.full_scale == case.magnitude.max()
    assert np.abs(read).max() <= 1


def test_a_pcm_wav_plays_the_drive_to_its_last_bit(result, tmp_path):
    case = result.cases["equal"]
    scale = 4 * float(case.magnitude.max())
    signal = make_drive_signal(result.scene, case, 44100, 0.5, full_scale=scale)
    (path,) = write_wav(signal, tmp_path / "drive.wav", "pcm16")
    rate, read = wavfile.read(path)
    assert (rate, read.dtype) == (44100, np.int16)
    np.testing.assert_allclose(read / 32767 * scale, played(signal, case.phasors), atol=0.51 / 32767 * scale)


def test_a_wav_says_what_its_channels_and_full_scale_are(result, tmp_path):
    signal = make_drive_signal(result.scene, result.cases["best"], 8000, 0.1)
    (path,) = write_wav(signal, tmp_path / "drive.wav")
    content = path.read_bytes()
    size = int.from_bytes(content[4:8], "little")
    assert len(content) == size + 8
    start = content.index(b"ICMT") + 8
    comment = content[start : content.index(b"\0", start)].decode()
    assert 'channel 1 = left, "upper", channel 2 = größer & <right>' in comment
    assert "290.0 Hz" in comment
    assert f"full scale = {signal.full_scale:.9g} N/m^2" in comment


def test_drive_csv_plays_the_drive_and_says_its_full_scale(result, tmp_path):
    case = result.cases["best"]
    signal = make_drive_signal(result.scene, case, 10_000, 0.1)
    (path,) = write_drive_csv(signal, tmp_path / "drive.csv")
    with path.open(encoding="utf-8", newline="") as file:
        heading, *rows = csv.reader(file)
    unit = f" [1 = {signal.full_scale:.9g} N/m^2]"
    assert heading == ["time [s]", *(f"{name}{unit}" for name in signal.names)]
    read = np.array(rows, dtype=float)
    np.testing.assert_allclose(read[:, 0], np.arange(signal.samples) / 10_000, rtol=1e-14)
    np.testing.assert_allclose(read[:, 1:] * signal.full_scale, played(signal, case.phasors), atol=1e-8 * 9)


@pytest.mark.parametrize(
    ("frequency", "rate", "duration"),
    [(290.0, 48000, 1.0), (290.1, 48000, 1.0), (290.123, 44100, 0.05), (0.25, 8000, 4.0), (39_871.0, 96_000, 3.0)],
)
def test_signals_repeat_as_well_as_they_can(frequency, rate, duration):
    periods, samples, seam = whole_periods(frequency, rate, duration)
    exact = Fraction(str(frequency))
    most = int(Fraction(str(duration)) * exact)
    assert 1 <= periods <= most
    assert periods >= most // 2 or most == 1
    turns = exact * samples / rate
    assert seam == pytest.approx(float(360 * (turns - periods)), abs=1e-12)
    # No other number of periods in reach does better.
    reach = range(max(1, most // 2 + 1), most + 1)[-3000:]
    errors = [abs(round(count * rate / exact) - count * rate / exact) for count in reach]
    assert abs(seam) <= float(360 * exact / rate * min(errors)) + 1e-12


def test_what_needs_no_seam_has_none():
    assert whole_periods(290.0, 48000, 1.0) == (290, 48000, 0.0)
    assert whole_periods(290.0, 48000, 0.25) == (58, 9600, 0.0)
    assert whole_periods(290.1, 48000, 10.0) == (2901, 480_000, 0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rate": 580}, "--rate 580: 290 Hz takes more than 580"),
        ({"duration": 0.003}, "--duration 0.003: must be at least a period of 290 Hz, 0.00345 s"),
        ({"duration": float("nan")}, "--duration nan"),
        ({"duration": float("inf")}, "--duration inf"),
        ({"duration": 1e6}, "--duration 1e.06: 3 channels take more than 4 GiB"),
        ({"full_scale": 1e-3}, "--full-scale 0.001: must be at least the drive's largest magnitude"),
        ({"full_scale": float("nan")}, "--full-scale nan"),
    ],
)
def test_signals_that_cannot_be_are_refused(result, options, words):
    with pytest.raises(SceneError, match=words):
        make_drive_signal(result.scene, result.cases["best"], **{"rate": 48000, "duration": 1.0, **options})


def test_a_drive_at_rest_has_no_signal(result):
    with pytest.raises(SceneError, match="its drive is zero"):
        make_drive_signal(result.scene, replace(result.cases["best"], phasors=np.zeros(3, complex)), 48000, 1.0)


def test_too_many_channels_for_a_wav_are_refused(result, tmp_path):
    signal = make_drive_signal(result.scene, result.cases["best"], 8000, 0.01)
    many = replace(signal, names=("a",) * 20_000, phasors=np.ones(20_000))
    with pytest.raises(SceneError, match="room for 16383 channels"):
        write_wav(many, tmp_path / "drive.wav")
    with pytest.raises(SceneError, match="--rate 2000000000: too many"):
        write_wav(replace(signal, rate=2_000_000_000), tmp_path / "drive.wav")
    assert not list(tmp_path.iterdir())


def test_what_a_result_lacks_is_named_by_the_key_of_the_scene(result, tmp_path):
    bare = result.scene.model_copy(update={"record": result.scene.record.model_copy(update={"points": ()})})
    with pytest.raises(SceneError, match=r"add record\.points = \[\[x, y\], \.\.\.\]"):
        write_traces(replace(result, scene=bare), result.cases, tmp_path / "traces.csv")
    for write in (write_pvd, write_vtkhdf):
        with pytest.raises(SceneError, match=r"add record\.times = \[\.\.\.\]"):
            write(result.scene, np.zeros(0), displacements(result), tmp_path / "run")
    assert not list(tmp_path.iterdir())


def write_words(words, paths, then=None):
    """Write the same words into all of them, but end in an error first."""
    with atomic_paths(*paths) as temporaries:
        for temporary in temporaries:
            temporary.write_text(words)
        if then is not None:
            raise then


def test_several_files_are_written_whole_or_not_at_all(tmp_path):
    paths = first, _ = tmp_path / "first", tmp_path / "last"
    first.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        write_words("new", paths, KeyboardInterrupt())
    with pytest.raises(SceneError, match=r"last: cannot be written: .*No space"):
        write_words("new", paths, OSError(28, "No space left on device"))
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("first", "old")]
    write_words("new", paths)
    assert sorted((path.name, path.read_text()) for path in tmp_path.iterdir()) == [("first", "new"), ("last", "new")]
    with pytest.raises(SceneError, match="cannot be written"):
        write_words("new", [tmp_path / "nowhere" / "file"])


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_files_are_as_readable_as_any_other(result, tmp_path):
    (tmp_path / "other").touch()
    files = write_pvd(result.scene, result.times, displacements(result), tmp_path / "run.pvd")
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {stat.S_IMODE((tmp_path / "other").stat().st_mode)}
