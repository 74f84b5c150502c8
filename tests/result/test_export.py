"""Exports, read back by other programs' readers: VTK, SciPy's WAV reader, Python's csv."""

import csv
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.io import wavfile

from support.results import result_of
from warp_plate.plate.waveforms import read_samples
from warp_plate.result.case import Case
from warp_plate.result.export import (
    ROWS_AT_ONCE,
    make_drive_signal,
    whole_periods,
    write_drive_csv,
    write_traces,
    write_vtkhdf,
    write_wav,
)
from warp_plate.scene.drive import SampledSignal
from warp_plate.scene.errors import SceneError

NODES, SIZE, TIMES = (13, 9), (0.3, 0.2), (0.001, 0.0035, 0.012)
POINTS = ((0.1, 0.05), (0.15, 0.1))
NEEDS_VTK = "PyVista is not installed: pip install 'warp-plate[viz]'"


@pytest.fixture
def oblong(random, scene):
    """A plate that is not square, with names that formats must quote."""
    x0, x1, y0, y1 = 0.05, 0.1, 0.04, 0.08
    names = ('left, "upper"', "größer & <right>", "3")
    actuators = [{"name": name, "area": (x0 + k / 20, x1 + k / 20, y0, y1 + k / 50)} for k, name in enumerate(names)]
    made = scene(NODES, SIZE, record={"times": TIMES, "points": POINTS}).with_tables(actuators=actuators)
    cases = {
        name: Case(
            phasors=random.normal(size=3) + 1j * random.normal(size=3),
            energy={"plate": 2.0, "target": 1.0},
            displacement=random.normal(scale=1e-7, size=(3, *NODES[::-1])).astype(np.float32),
            trace=random.normal(scale=1e-7, size=(2, 150)).astype(np.float32),
        )
        for name in ("best", "equal")
    }
    return result_of(made, cases, times=np.array(TIMES), trace_times=8e-5 * np.arange(150))


def displacements(oblong):
    return {f"displacement_{name}": case.displacement for name, case in oblong.cases.items()}


def check_field(mesh, oblong, index):
    """Compare one time of a series as VTK reads it: x fastest, float32 as it was."""
    assert mesh.dimensions == (*NODES, 1)
    assert mesh.bounds == pytest.approx((0, SIZE[0], 0, SIZE[1], 0, 0))
    for name, case in oblong.cases.items():
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
    areas = [(x1 - x0) * (y1 - y0) for x0, x1, y0, y1 in (actuator.area for actuator in oblong.scene.actuators)]
    assert mesh.point_data["actuators"].sum() * cell == pytest.approx(sum(areas), rel=1e-5)


def test_a_vtkhdf_series_reads_back_in_vtk(oblong, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason=NEEDS_VTK)
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    (path,) = write_vtkhdf(oblong.scene, oblong.times, displacements(oblong), tmp_path / "run.vtkhdf")
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS()) == TIMES
    for index in (2, 0, 1):
        reader.UpdateTimeStep(TIMES[index])
        check_field(pyvista.wrap(reader.GetOutputDataObject(0)), oblong, index)


def test_a_full_disk_refuses_a_vtkhdf_series(oblong, tmp_path):
    """HDF5 itself would crash on it."""
    resource = pytest.importorskip("resource", reason="Windows has no limit on the size of files")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, before[1]))
    try:
        with pytest.raises(SceneError, match=r"run\.vtkhdf: cannot be written: File too large"):
            write_vtkhdf(oblong.scene, oblong.times, displacements(oblong), tmp_path / "run.vtkhdf")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


def read_csv(path):
    with path.open(encoding="utf-8", newline="") as file:
        heading, *rows = csv.reader(file)
    return heading, np.array(rows, dtype=float)


def test_traces_read_back_from_csv(oblong, tmp_path):
    heading, read = read_csv(*write_traces(oblong, oblong.cases, tmp_path / "traces.csv"))
    columns = [f"{name} u(x={x} y={y}) [m]" for name in ("best", "equal") for x, y in POINTS]
    assert heading == ["time [s]", *columns]
    np.testing.assert_allclose(read[:, 0], oblong.trace_times, rtol=1e-14, atol=0)
    expected = np.concatenate([case.trace for case in oblong.cases.values()]).T
    np.testing.assert_array_equal(read[:, 1:].astype(np.float32), expected)


def played(signal, phasors):
    """Return the load as each channel must play it, Re(Z exp(iωt)) [N/m²]."""
    time = np.arange(signal.samples) / signal.rate
    return (np.exp(2j * np.pi * 290.0 * time)[:, None] * phasors).real


@pytest.mark.parametrize(
    ("encoding", "rate", "share", "error"), [("float32", 48000, 1, 1e-6), ("pcm16", 44100, 4, 0.51 / 32767)]
)
def test_a_wav_plays_the_drive(oblong, tmp_path, encoding, rate, share, error):
    case = oblong.cases["best"]
    full_scale = None if share == 1 else share * float(case.magnitude.max())
    signal = make_drive_signal(oblong.scene, case, rate, 2.0, full_scale)
    assert signal.samples == 2 * rate > ROWS_AT_ONCE
    assert signal.full_scale == share * case.magnitude.max()
    (path,) = write_wav(signal, tmp_path / "drive.wav", encoding)
    read_rate, read = wavfile.read(path)
    assert (read_rate, read.dtype, read.shape) == (rate, np.float32 if share == 1 else np.int16, (2 * rate, 3))
    values = read / (1 if share == 1 else 32767) * signal.full_scale
    np.testing.assert_allclose(values, played(signal, case.phasors), atol=error * signal.full_scale)
    content = path.read_bytes()
    assert content[20:22] == b"\xfe\xff"  # WAVE_FORMAT_EXTENSIBLE
    assert content[40:44] == bytes(4)  # no loudspeaker positions
    assert len(content) == int.from_bytes(content[4:8], "little") + 8
    start = content.index(b"ICMT") + 8
    comment = content[start : content.index(b"\0", start)].decode()
    assert 'channel 1 = left, "upper", channel 2 = größer & <right>' in comment
    assert comment.endswith(f"290.0 Hz; full scale = {signal.full_scale:.9g} N/m^2")


def test_a_wav_of_24_bits_reads_back_as_a_signal(oblong, tmp_path):
    """Files are read as channels of ``[drive.signal]``, with an odd number of bytes of samples."""
    signal = replace(make_drive_signal(oblong.scene, oblong.cases["best"], 48000, 0.1), samples=4799)
    (path,) = write_wav(signal, tmp_path / "drive.wav", "pcm24")
    read = read_samples(SampledSignal(file="drive.wav", per_actuator=True), tmp_path, 3)
    expected = played(signal, signal.phasors).T * (1 - 2**-23)
    np.testing.assert_allclose(read.values, expected, rtol=0, atol=0.51 / 2**23)
    content = path.read_bytes()
    assert len(content) == int.from_bytes(content[4:8], "little") + 8
    assert len(content) % 2 == 0


def test_names_in_csv_are_one_line_of_texts(oblong, tmp_path):
    signal = make_drive_signal(oblong.scene, oblong.cases["best"], 8000, 0.02)
    signal = replace(signal, names=("a\rb\n\tc", "@SUM(1)", "-1"))
    heading, read = read_csv(*write_drive_csv(signal, tmp_path / "drive.csv"))
    assert [name.partition(" [")[0] for name in heading] == ["time", r"a\rb\n\tc", "'@SUM(1)", "'-1"]
    assert read.shape == (signal.samples, 4)
    assert len((tmp_path / "drive.csv").read_text(encoding="utf-8").splitlines()) == 1 + signal.samples


def test_a_drive_csv_plays_the_drive(oblong, tmp_path):
    case = oblong.cases["best"]
    signal = make_drive_signal(oblong.scene, case, 10_000, 0.1)
    heading, read = read_csv(*write_drive_csv(signal, tmp_path / "drive.csv"))
    assert heading == ["time [s]", *(f"{name} [1 = {signal.full_scale:.9g} N/m^2]" for name in signal.names)]
    np.testing.assert_allclose(read[:, 0], np.arange(signal.samples) / 10_000, rtol=1e-14)
    np.testing.assert_allclose(read[:, 1:] * signal.full_scale, played(signal, case.phasors), atol=1e-7)


@pytest.mark.parametrize(
    ("frequency", "rate", "duration"), [(290.1, 48000, 1.0), (290.123, 44100, 0.05), (0.25, 8000, 4.0)]
)
def test_signals_repeat_as_well_as_they_can(frequency, rate, duration):
    assert whole_periods(290.0, 48000, 0.25) == (58, 9600, 0.0)  # the longest of several
    assert whole_periods(290.1, 48000, 10.0) == (2901, 480_000, 0.0)
    periods, samples, seam = whole_periods(frequency, rate, duration)
    exact = Fraction(str(frequency))
    most = int(Fraction(str(duration)) * exact)
    assert max(most // 2, 1) <= periods <= most
    assert seam == pytest.approx(float(360 * (exact * samples / rate - periods)), abs=1e-12)
    # No other number of periods does better.
    errors = [abs(round(count * rate / exact) - count * rate / exact) for count in range(most // 2 + 1, most + 1)]
    assert abs(seam) <= float(360 * exact / rate * min(errors)) + 1e-12


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rate": 580}, "--rate 580: "),
        ({"duration": 0.003}, "--duration 0.003: .* 0.00345 s"),
        ({"duration": float("nan")}, "--duration nan"),
        ({"duration": 1e6}, "--duration 1e.06: 3 channels"),
        ({"full_scale": 1e-3}, "--full-scale 0.001: "),
        ({"full_scale": float("nan")}, "--full-scale nan"),
        ({"case": Case(np.zeros(3, complex), {}, np.zeros(0), np.zeros(0))}, "zero"),
    ],
)
def test_impossible_signals_are_refused(oblong, options, words):
    with pytest.raises(SceneError, match=words):
        make_drive_signal(oblong.scene, **{"case": oblong.cases["best"], "rate": 48000, "duration": 1.0, **options})


def test_what_no_file_can_hold_or_the_result_lacks_is_refused(oblong, tmp_path):
    signal = make_drive_signal(oblong.scene, oblong.cases["best"], 8000, 0.01)
    many = replace(signal, names=("a",) * 20_000, phasors=np.ones(20_000))
    with pytest.raises(SceneError, match="16383 channels"):
        write_wav(many, tmp_path / "drive.wav")
    with pytest.raises(SceneError, match="--rate 2000000000"):
        write_wav(replace(signal, rate=2_000_000_000), tmp_path / "drive.wav")
    with pytest.raises(SceneError, match=r"record\.times"):
        write_vtkhdf(oblong.scene, np.zeros(0), displacements(oblong), tmp_path / "run")
    assert not list(tmp_path.iterdir())
