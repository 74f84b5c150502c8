"""Measurements in files of other programs: arrays, universal files, time signals whose filter is known."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy

from support.commands import error_of, output_of
from support.scenes import scene_of
from warp_plate import SceneError
from warp_plate.fitting.measured_modes import read_modes
from warp_plate.fitting.measured_responses import read_responses
from warp_plate.scene.fit import Fit
from warp_plate.studies.frequency_response import frf

RATE = 2000
# A resonator, and a second sensor of four times the gain and opposite sign.
FILTER = [0.05, 0.02], [1.0, -1.6, 0.9]
FREE = {"plate.density": (1.0, 2.0)}


@pytest.fixture
def responses(random):
    """Return 5 frequencies, (3, 5) responses and their coherence."""
    values = random.normal(size=(3, 5)) + 1j * random.normal(size=(3, 5))
    return np.linspace(10, 50, 5), values, random.uniform(0.5, 1, (3, 5))


@pytest.mark.parametrize("turned", [False, True])
def test_mat_files(turned, responses, tmp_path):
    """Responses lie in rows, or in columns as MATLAB likes them."""
    frequencies, values, coherence = responses
    arrays = (
        {"response": values.T, "coherence": coherence.T} if turned else {"response": values, "coherence": coherence}
    )
    scipy.io.savemat(tmp_path / "data.mat", {"frequency": frequencies, **arrays}, do_compression=turned)
    found = read_responses(tmp_path / "data.mat", 3)
    np.testing.assert_array_equal(found.frequencies, frequencies)
    np.testing.assert_array_equal(found.responses, values)
    np.testing.assert_array_equal(found.coherence, coherence)


@pytest.mark.parametrize("value", [1.5, -0.5, np.inf, 1e300])
def test_a_coherence_beyond_its_range_is_refused(value, responses, tmp_path):
    frequencies, values, coherence = responses
    coherence[1, 2] = value
    scipy.io.savemat(tmp_path / "data.mat", {"frequency": frequencies, "response": values, "coherence": coherence})
    with pytest.raises(SceneError, match="coherence must be from 0 to 1"):
        read_responses(tmp_path / "data.mat", 3)


def test_hdf5_files(responses, tmp_path):
    """Complex numbers as h5py and as MATLAB's names have them, two parts, compressed chunks, an axis of inputs."""
    frequencies, values, coherence = responses
    pairs = np.empty(values.shape, dtype=[("real", "f8"), ("imag", "f8")])
    pairs["real"], pairs["imag"] = values.real, values.imag
    parts = {"real": values.real[None], "imaginary": values.imag[None]}
    for ending, arrays in (("h5", {"response": values}), ("hdf5", {"response": pairs}), ("nc", parts)):
        with h5py.File(tmp_path / f"data.{ending}", "w") as file:
            for name, content in {"frequency": frequencies, "coherence": coherence, **arrays}.items():
                file.create_dataset(name, data=content, compression="gzip")
        found = read_responses(tmp_path / f"data.{ending}", 3, Fit(free=FREE, range=(15, 45)))
        np.testing.assert_array_equal(found.frequencies, frequencies[1:4])
        np.testing.assert_array_equal(found.responses, values[:, 1:4])
        np.testing.assert_array_equal(found.coherence, coherence[:, 1:4])


def test_several_files(responses, tmp_path):
    frequencies, values, _ = responses
    paths = [tmp_path / f"{index}.mat" for index in range(3)]
    for path, value in zip(paths, values, strict=True):
        scipy.io.savemat(path, {"frequency": frequencies, "response": value})
    np.testing.assert_array_equal(read_responses(paths, 3).responses, values)
    scipy.io.savemat(paths[1], {"frequency": frequencies + 1, "response": values[1]})
    with pytest.raises(SceneError, match=r"1.mat: is at other frequencies than .*0.mat"):
        read_responses(paths, 3)
    with pytest.raises(SceneError, match=r"2 files of data for 3 tables \[\[measurement\]\]"):
        read_responses(paths[:2], 3)


def signals(random, of_force=0.0, of_motion=0.0, seconds=100):
    """Return (3, samples) of a force and two sensors, with noise relative to each."""
    force = random.normal(size=seconds * RATE)
    motion = scipy.signal.lfilter(*FILTER, force)
    channels = np.stack([force, motion, -4 * motion])
    noise = random.normal(size=channels.shape) * channels.std(axis=1, keepdims=True)
    return channels + noise * [[of_force], [of_motion], [of_motion]]


@pytest.mark.parametrize(
    ("estimator", "of_force", "of_motion", "coherent"),
    [("H1", 0.0, 0.3, 1), ("H2", 0.3, 0.0, 1), ("Hv", 0.0, 0.0, 1), ("H1", 0.5, 0.0, 1 / 1.25)],
)
def test_estimators(estimator, of_force, of_motion, coherent, random, tmp_path):
    """The estimator that fits the noise is unbiased; noise of a half of the force makes H1 too small by 1.25."""
    values = signals(random, of_force, of_motion)
    scipy.io.wavfile.write(tmp_path / "data.wav", RATE, (values.T / 60).astype(np.float32))
    table = {"estimator": estimator, "segment": 0.5, "force_gain": 1 / 60}
    found = read_responses(tmp_path / "data.wav", 2, Fit(free=FREE, range=(100, 800), signals=table))
    _, exact = scipy.signal.freqz(*FILTER, worN=found.frequencies, fs=RATE)
    biased = coherent / 60 * np.stack([exact, -4 * exact])
    errors = (found.responses - biased) / np.sqrt(np.mean(np.abs(biased) ** 2, axis=1, keepdims=True))
    assert np.sqrt(np.mean(np.abs(errors) ** 2)) < 0.06
    assert abs(np.mean(errors)) < 0.01
    assert found.coherence.max() <= 1
    if of_force:
        assert np.mean(found.coherence[:, :50]) == pytest.approx(1 / (1 + of_force**2), abs=0.02)


def test_signals_in_text(random, tmp_path):
    """A single segment without a window has the exact response of a periodic signal, and no coherence."""
    times = np.arange(RATE) / RATE
    force = np.cos(2 * np.pi * 40 * times) + np.cos(2 * np.pi * 60 * times)
    motion = 3 * np.cos(2 * np.pi * 40 * times + 0.5) + 2 * np.sin(2 * np.pi * 60 * times)
    np.savetxt(tmp_path / "data.csv", np.column_stack([times, motion, force]), delimiter=",", fmt="%.12g")
    table = {"force_channel": 2, "window": "boxcar"}
    found = read_responses(tmp_path / "data.csv", 1, Fit(free=FREE, range=(40, 60), signals=table))
    np.testing.assert_allclose(found.responses[0, [0, -1]], [3 * np.exp(0.5j), -2j], rtol=1e-8)
    assert found.coherence is None


def test_modes_of_universal_files(random, tmp_path):
    """Normal and complex modes; the rigid one is left out."""
    pyuff = pytest.importorskip("pyuff")
    nodes = {"type": 15, "node_nums": [7, 9], "x": [0.1, 0.02], "y": [0.05, 0.06], "z": [0.0, 0.0]}
    shared = {"type": 55, "data_ch": 2, "spec_data_type": 8, "load_case": 0, "node_nums": [9, 7]}
    zero = np.zeros(2)
    normal = {**shared, "analysis_type": 2, "mode_n": 1, "r1": zero, "r2": zero}
    modes = [
        {**normal, "freq": freq, "modal_damp_vis": zeta, "r3": r}
        for freq, zeta, r in ((0.0, 0.0, [1, 1]), (80.0, 0.02, [0.5, -1.0]))
    ]
    pole = 2 * np.pi * 30 * (-0.01 + 1j * np.sqrt(1 - 0.01**2))
    shapes = {"r1": zero + 0j, "r2": zero + 0j, "r3": np.array([1 + 1j, 2.0])}
    modes.append({**shared, "analysis_type": 3, "mode_n": 2, "eig": pole, **shapes})
    pyuff.UFF(str(tmp_path / "data.uff")).write_sets([nodes, *modes], mode="overwrite")
    found = read_modes(tmp_path / "data.uff")
    np.testing.assert_allclose(found.frequencies, [30, 80], rtol=1e-5)
    np.testing.assert_allclose(found.damping, [0.01, 0.02], rtol=1e-4)
    np.testing.assert_allclose(found.shapes, [[1 + 1j, 2], [0.5, -1]], rtol=1e-5)
    np.testing.assert_allclose(found.points, [[0.02, 0.06], [0.1, 0.05]])
    text = (tmp_path / "data.uff").read_text()
    (tmp_path / "data.uff").write_text(text.replace(f"{8:10d}{2:10d}{3:10d}", f"{8:10d}{2:10d}{-5:10d}"))
    with pytest.raises(SceneError, match=r"data\.uff: mode 1 of 3 \(dataset 55\): record 6 states -5 values a node"):
        read_modes(tmp_path / "data.uff")


def dataset_58(points):
    """The text of a response of two points, 1 at 1 Hz and 2 Hz, whose header states other points."""
    node = f"{'NONE':>5s}{1:10d}{3:4d}"
    axes = "".join(f"{code:10d}{0:5d}{0:5d}{0:5d} NONE                 NONE\n" for code in (18, 12, 13, 0))
    head = f"{4:5d}{0:10d}{1:5d}{0:10d} {node} {node}\n{5:10d}{points:10d}{1:10d}{1:13.5e}{1:13.5e}{0:13.5e}\n"
    return "    -1\n    58\n" + "NONE\n" * 5 + head + axes + f"{1:13.5e}{0:13.5e}" * 2 + "\n    -1\n"


@pytest.mark.parametrize("points", [999_999_999, 3, 1, 0, -5])
def test_points_that_a_universal_file_states_but_lacks(points, tmp_path):
    pytest.importorskip("pyuff")
    path = tmp_path / "data.uff"
    path.write_text(dataset_58(2))
    np.testing.assert_array_equal(read_responses(path, 1).responses, [[1, 1]])
    path.write_text(dataset_58(2) + dataset_58(points))
    stated = f"data\\.uff: dataset 58, number 2 of 2: record 7 states {points} points and 2 follow"
    with pytest.raises(SceneError, match=stated):
        read_responses(path, 2)


def test_shapes_in_text(tmp_path):
    (tmp_path / "data.csv").write_text("frequency,shape 0.1 0.05,shape 0.02 0.06\n20,1,-2\n10,3,4\n", encoding="utf-8")
    found = read_modes(tmp_path / "data.csv")
    np.testing.assert_array_equal(found.shapes, [[3, 4], [1, -2]])
    np.testing.assert_array_equal(found.points, [[0.1, 0.05], [0.02, 0.06]])
    (tmp_path / "data.csv").write_text("frequency,shape 0.1\n20,1\n", encoding="utf-8")
    with pytest.raises(SceneError, match=r"column 'shape 0.1': write 'shape X Y'"):
        read_modes(tmp_path / "data.csv")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.mat", {"f": [1.0, 2.0]}, "has none of the arrays frequency, response"),
        ("a.mat", {"frequency": [1.0, 2.0]}, "needs the arrays frequency, and response or real and imaginary"),
        ("a.mat", {"frequency": [1.0, 2.0], "response": 1j * np.eye(2)}, "one axis, and no other, must be as long"),
        ("a.mat", {"frequency": [1.0, 2.0], "response": "no"}, "response is not an array of numbers"),
        ("a.mat", {"frequency": [1.0, 2.0], "response": [{"a": 1}, {}]}, "response is not an array of numbers"),
        ("a.mat", {"frequency": scipy.sparse.eye_array(2), "response": np.eye(2)}, "is not an array of numbers"),
        (
            "a.mat",
            {"frequency": [1.0, 2.0], "response": 1j * np.ones((3, 2))},
            "has 3 responses; the scene has 1 tables",
        ),
        ("a.mat", b"MATLAB 5.0 MAT-file" * 20, "cannot be read as a MAT file"),
        ("a.h5", b"\x89HDF\r\n\x1a\n" * 20, "cannot be read as a HDF5 file"),
        ("a.wav", b"RIFF", "not a WAV file"),
        ("a.csv", b"f,re\n1,2\n", "needs the columns frequency, real and imaginary part of each response"),
        ("a.csv", b"1,1,1\n1,1,1\n", "frequencies must rise, from 0 hertz or above"),
        ("a.csv", b"1,1,1\nnan,1,1\n", "frequencies must rise, from 0 hertz or above"),
        ("a.csv", b"0,0,0\n1,1,1\n", "1 frequencies; 2 to 4000 can be fitted"),
        ("a.csv", b"1,1,1\n2,0,0\n", "response 1 at 2 Hz is 0+0j; must be a complex number other than 0"),
        ("a.csv", b"1,1,1\n2,1e300,0\n", "response 1 at 2 Hz is 1e+300+0j; must be a complex number other than 0"),
        ("a.csv", b"1,1,1\n2,1," + b'"1"' + b"1" * 2**17, "a cell has more than 131072 characters"),
        ("a.csv", b"1,1,x\n", "not a table of numbers with decimal points"),
        ("a.uff", b"nothing", "a.uff: "),
    ],
)
def test_bad_files(name, content, message, tmp_path):
    if name.endswith("uff"):
        pytest.importorskip("pyuff")
    if isinstance(content, dict):
        scipy.io.savemat(tmp_path / name, content)
    else:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError) as caught:
        read_responses(tmp_path / name, 1)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"segment": 9.0}, "fit.signals.segment = 9 s must have 2 to 8000 samples"),
        ({"segment": 0.001}, "fit.signals.segment = 0.001 s: 1 frequencies; 2 to 4000 can be fitted"),
        ({"force_channel": 4}, "has 3 channels; fit.signals.force_channel = 4"),
        ({"window": "hamming"}, "must be"),
        ({"estimator": "H3"}, "must be"),
    ],
)
def test_bad_signals(table, message, random, tmp_path):
    scipy.io.wavfile.write(tmp_path / "data.wav", RATE, signals(random, seconds=4).T.astype(np.float32))
    with pytest.raises(SceneError) as caught:
        read_responses(tmp_path / "data.wav", 2, Fit(free=FREE, signals=table))
    assert message in str(caught.value)


def test_command(command, write_scene):
    """Several files of one command; a fit of modes takes one."""
    rows = [{"force_at": (0.05, 0.06), "point": point} for point in ((0.1, 0.05), (0.12, 0.1))]
    fit = {"starts": 1, "free": {"plate.density": (900.0, 1100.0)}, "range": (11, 40)}
    scene = scene_of(effects={"loss_factor": {"eta": 0.05}}, fit=fit, measurement=rows, grid={"modal_density": 0.5})
    write_scene(scene)
    exact = frf(scene, [(0.05, 0.06)], [row["point"] for row in rows], (10, 40), "accelerance")
    for index, values in enumerate(exact.responses):
        scipy.io.savemat(f"{index}.mat", {"frequency": exact.frequencies, "response": values})
    words = ("--data", "0.mat", "--data", "1.mat", "--no-pictures", "--json")
    record = json.loads(output_of(command("fit", "panel.toml", *words)))
    assert min(record["frequencies"]) > 11
    assert max(record["rms_decibels"]) < 0.1
    written = Path("panel.fitted.toml").read_text(encoding="utf-8")
    assert written.startswith("# Fitted by warp-plate to '0.mat', '1.mat'")
    write_scene(scene.with_tables(measurement=()))
    message = "data b.csv: must be one file, for the scene has no tables [[measurement]]"
    assert message in error_of(command("fit", "panel.toml", "--data", "a.csv", "--data", "b.csv", "--force"))


def test_mat_files_that_are_cut_short(responses, tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"frequency": responses[0], "response": responses[1][:1]}, do_compression=True)
    good = path.read_bytes()
    for length in range(0, len(good), 29):
        path.write_bytes(good[:length])
        with pytest.raises(SceneError):
            read_responses(path, 1)


@pytest.mark.parametrize(
    ("count", "kind"),
    [(2**40, "f8"), (2, np.dtype((np.float64, (2**24,)))), (2, h5py.string_dtype()), (2, h5py.vlen_dtype(float))],
)
def test_large_items_of_hdf5_files_are_refused(count, kind, tmp_path):
    """Also those that compression hides."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frequency"] = [1.0, 2.0]
        file.create_dataset("response", (count,), kind, chunks=(min(count, 2**20),), compression="gzip")
    with pytest.raises(SceneError, match=r"response is not an array of numbers|bytes when unpacked"):
        read_responses(tmp_path / "a.h5", 1)
