"""Signals from files: the band that resampling passes, phase lags, and damaged files."""

import struct

import numpy as np
import pytest

from support.scenes import refused
from warp_plate import SceneError
from warp_plate.plate.waveforms import Samples, read_samples, resample
from warp_plate.scene.drive import SampledSignal

STEPS = 3000


def tone(frequency, rate, seconds=0.5, phase=0.3):
    return np.cos(2 * np.pi * frequency * np.arange(round(seconds * rate)) / rate + phase)


def level(frequency, band=1.0, rate=22050.0):
    """Return the largest value of a resampled tone well inside the file."""
    samples = Samples(tone(frequency, rate), rate, 0.0, False)
    return np.abs(resample(samples, 1e-4, STEPS, band)[STEPS // 4 : STEPS // 2]).max()


def read(folder, data, name="a.csv", **keys):
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    return read_samples(SampledSignal(file=name, **keys), folder)


GUID = bytes.fromhex("0000 0000 1000 8000 00aa 0038 9b71")  # end of the name of a format in the extensible one


def wav(data, code=1, bits=16, channels=1, rate=8000, extra=b"", form_extra=b""):
    frame = channels * (bits // 8)
    form = struct.pack("<HHIIHH", code, channels, rate, rate * frame, frame, bits) + form_extra
    chunks = b"WAVEfmt " + struct.pack("<I", len(form)) + form + extra + b"data" + struct.pack("<I", len(data)) + data
    return b"RIFF" + struct.pack("<I", len(chunks)) + chunks


@pytest.mark.parametrize(("rate", "time_step"), [(3000.0, 1e-4), (10000.0, 7.3e-5), (96000.0, 1e-4)])
def test_below_nine_tenths_of_the_slower_rate_a_tone_passes(rate, time_step):
    """Within 1e-3, and its analytic signal is the tone's: a phase lag of Z is one of the tone."""
    for part in (0.02, 0.5, 0.88):
        frequency = part * min(rate, 1 / time_step) / 2
        carrier = resample(Samples(tone(frequency, rate), rate, 0.0, False), time_step, STEPS)
        times = time_step * np.arange(STEPS)
        inside = (times > 0.1) & (times < 0.28)
        wanted = np.exp(1j * (2 * np.pi * frequency * times + 0.3))
        # The real part is the interpolation's alone; the imaginary part feels the file's ends, as 1/(2πf·distance).
        np.testing.assert_allclose(carrier.real[inside], wanted.real[inside], atol=1e-3)
        ends = 1 / (2 * np.pi * frequency * 0.1)
        np.testing.assert_allclose(carrier.imag[inside], wanted.imag[inside], atol=1e-3 + ends)


@pytest.mark.parametrize("channels", [1, 2])
def test_a_lagging_pulse_is_that_between_silence(random, channels):
    """Its Hilbert transform is the sum over its samples of 2/πn at odd n, also at low frequencies."""
    values = random.random((channels, 400))
    lag = np.subtract.outer(np.arange(400), np.arange(400))
    kernel = np.where(lag % 2, 2 / (np.pi * np.where(lag % 2, lag, 1)), 0.0)
    np.testing.assert_allclose(Samples(values, 1e3, 0.0, False).analytic(), values + 1j * values @ kernel.T, atol=1e-12)
    np.testing.assert_array_equal(Samples(values[0], 1e3, 0.0, False).analytic().real, values[0])


def test_above_the_steps_nyquist_frequency_a_tone_is_stopped():
    """More than 60 dB down, from just above 5 kHz to the end of the file's band; half the band, half the limit."""
    assert max(level(frequency) for frequency in (5001.0, 5600.0, 8000.0, 10925.0)) < 1e-3
    assert level(2600.0, band=0.5) < 1e-3
    assert level(2200.0, band=0.5) == pytest.approx(1, abs=1e-2)


def test_repeats_without_a_seam():
    """A whole number of periods, repeated, is an endless tone, and the imaginary part its quarter turn."""
    carrier = resample(Samples(tone(300, 9000, 0.05), 9000, 0.0, True), 1e-4, STEPS)
    np.testing.assert_allclose(carrier, np.exp(1j * (2 * np.pi * 300e-4 * np.arange(STEPS) + 0.3)), atol=1e-3)


def test_silence_before_and_after():
    """A file that starts at 0.1 s and lasts 0.1 s drives from then to then, but for the filter's 50 samples."""
    carrier = resample(Samples(tone(300, 5000, 0.1), 5000, 0.1, False), 1e-4, STEPS)
    times = 1e-4 * np.arange(STEPS)
    assert not carrier[(times < 0.0895) | (times > 0.2105)].any()
    wanted = np.cos(2 * np.pi * 300 * (times - 0.1) + 0.3)
    inside = (times > 0.115) & (times < 0.185)
    np.testing.assert_allclose(carrier.real[inside], wanted[inside], atol=2e-3)
    late = resample(Samples(tone(300, 6000, 0.1), 6000, 0.1, True), 1e-4, STEPS)
    assert not late[times < 0.0999].any()


def test_highest_frequency_is_where_the_energy_ends():
    mixed = tone(100, 8000) + 0.2 * tone(900, 8000) + 1e-3 * tone(3000, 8000)
    assert Samples(mixed, 8000, 0.0, False).highest_frequency() == 900


@pytest.mark.parametrize(
    ("code", "bits", "extensible"),
    [(1, 8, True), (1, 16, False), (1, 24, True), (1, 32, False), (3, 32, True), (3, 64, False)],
)
def test_wav_of_every_width(tmp_path, code, bits, extensible):
    """Full scale is −1 to 1, other chunks are skipped, and the extensible format is read."""
    values = np.array([0.0, 0.5, -0.5, -1.0, 0.25])
    if code == 3:
        data = values.astype(f"<f{bits // 8}").tobytes()
    else:
        whole = (values * 2 ** (bits - 1)).astype(np.int64) + 128 * (bits == 8)
        data = b"".join(int(v).to_bytes(bits // 8, "little", signed=bits > 8) for v in whole)
    subformat = struct.pack("<HHIH", 22, bits, 4, code) + GUID if extensible else b""
    content = wav(data, 0xFFFE if extensible else code, bits, extra=b"LIST\3\0\0\0abc\0", form_extra=subformat)
    samples = read(tmp_path, content, "Take 1.WAV", gain=3.0)
    np.testing.assert_array_equal(samples.values, 3 * values)
    assert (samples.rate, samples.start) == (8000, 0)


def test_csv_of_one_and_two_columns(tmp_path):
    one = read(tmp_path, "value\n# a remark\n1\n\n-2.5\r\n3e-1\n", rate=50.0)
    np.testing.assert_array_equal(one.values, [1, -2.5, 0.3])
    assert (one.rate, one.start) == (50, 0)
    two = read(tmp_path, "\ufefftime; value\n0.10; 1\n0.12;2\n0.14;4\n")
    np.testing.assert_array_equal(two.values, [1, 2, 4])
    assert (two.rate, two.start) == (pytest.approx(50), 0.1)
    # 44.1 kHz written with six decimals: off by 2 % of a step, but even.
    rounded = "".join(f"{index / 44100:.6f},{index % 7}\n" for index in range(2000))
    assert read(tmp_path, rounded).rate == pytest.approx(44100, rel=1e-5)


@pytest.mark.parametrize("bits", [16, 24])
def test_a_channel_for_each_actuator(tmp_path, bits):
    """Channels come from interleaved WAV, and from CSV with and without times; ``start`` delays all of them."""
    values = np.array([[0.0, 0.5, -0.5], [-1.0, 0.25, 0.125]])
    whole = (values.T * 2 ** (bits - 1)).astype(int).ravel().tolist()
    data = b"".join(number.to_bytes(bits // 8, "little", signed=True) for number in whole)
    (tmp_path / "a.wav").write_bytes(wav(data, bits=bits, channels=2))
    np.savetxt(tmp_path / "b.csv", values.T, delimiter=",")
    np.savetxt(tmp_path / "c.csv", np.column_stack([[0.1, 0.2, 0.3], values.T]), delimiter=",")
    for name, rate, start in (("a.wav", None, 0.5), ("b.csv", 10.0, 0.5), ("c.csv", None, 0.6)):
        table = SampledSignal(file=name, per_actuator=True, rate=rate, start=0.5)
        samples = read_samples(table, tmp_path, 2)
        np.testing.assert_array_equal(samples.values, values)
        assert samples.start == pytest.approx(start)
    with pytest.raises(SceneError, match="2 columns instead of 4, or time first"):
        read_samples(SampledSignal(file="b.csv", per_actuator=True, rate=10.0), tmp_path, 4)


@pytest.mark.parametrize(
    ("name", "content", "keys", "why"),
    [
        ("a.csv", "1,2", {}, "1 samples"),
        ("a.csv", "1\n2\n", {}, "drive.signal.rate"),
        ("a.csv", "0,1\n1,2\n", {"rate": 10.0}, "delete drive.signal.rate"),
        ("a.csv", "0,1,2\n1,2,3\n", {}, "3 columns instead of 1, or time first; per_actuator = true"),
        ("a.csv", "0,1,2\n1,2,3\n", {"per_actuator": True}, "3 columns instead of 1"),
        ("a.wav", wav(bytes(8), channels=2), {"per_actuator": True}, "write 1, one for each actuator"),
        ("a.csv", "0,1\n1,two\n", {}, "could not convert string 'two' to float64 at row 2, column 2"),
        ("a.csv", "0,1_0\n1,2\n2,3\n", {}, "1_0"),
        ("a.csv", "time, s;value\n0;1,05\n1;2\n", {}, "decimal points: could not convert string '1,05'"),
        ("a.csv", "0,1\n1,nan\n", {}, "no number"),
        ("a.csv", "0,1\n0,2\n", {}, "do not rise"),
        ("a.csv", "0,1\n1,2\n2.2,2\n3,2\n", {}, "not evenly spaced (sample 3)"),
        ("a.csv", "-1,1\n1,2\n", {}, "starts at -1 s"),
        ("a.csv", "0,0\n1,0\n", {}, "all samples are zero"),
        ("a.csv", "0,1\n1e9,1\n", {}, "samples a second"),
        ("a.csv", b"\xff\xfe1\x00", {}, "not UTF-8"),
        ("a.wav", b"RIFF\0\0\0\0WAVE", {}, "without samples"),
        ("a.wav", wav(bytes(8), channels=2), {}, "2 channels"),
        ("a.wav", wav(bytes(8), bits=65), {}, "damaged"),
        ("a.wav", wav(bytes(8), code=85), {}, "Unknown wave file format"),
        ("a.wav", wav(b"\1\2\3\4" * 9)[:-5], {}, "ends too early"),
        ("a.wav", wav(b"\1\2" * 9, rate=0), {}, "0 samples a second"),
    ],
)  # fmt: skip
def test_bad_files_are_refused_on_one_line(tmp_path, name, content, keys, why):
    line = refused(read, tmp_path, content, name, **keys)
    assert line.startswith(f"drive.signal.file = {name!r}: ")
    assert why in line


def test_nothing_outside_the_folder_is_read(tmp_path):
    (tmp_path / "secret.csv").write_text("0,1\n1,2\n")
    folder = tmp_path / "scenes"
    (folder / "folder.csv").mkdir(parents=True)
    (folder / "a.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "loop.csv").symlink_to(folder / "loop.csv")
    names = {"a": "out of the scene's folder", "b": "no such", "folder": "is no file", "loop": "read: Too many"}
    for name, why in names.items():
        with pytest.raises(SceneError, match=f"{name}.csv': .*{why}"):
            read_samples(SampledSignal(file=f"{name}.csv"), folder)
    with pytest.raises(SceneError, match="its folder is unknown"):
        read_samples(SampledSignal(file="a.csv"), None)


SAMPLES = (np.arange(1, 30) * 517 % 251 - 125).astype("<i2")


def test_a_wav_file_cut_anywhere_is_refused(tmp_path):
    subformat = struct.pack("<HHIH", 22, 16, 4, 1) + GUID
    content = wav(SAMPLES.tobytes(), 0xFFFE, extra=b"LIST\4\0\0\0abcd", form_extra=subformat)
    assert read(tmp_path, content, "a.wav").values.size == SAMPLES.size
    for length in range(len(content)):
        with pytest.raises(SceneError):
            read(tmp_path, content[:length], "a.wav")


def test_long_signals_are_refused(tmp_path):
    with pytest.raises(SceneError, match="16777217 samples; at most 16777216"):
        read(tmp_path, wav(bytes(2**24 + 1), bits=8), "a.wav")
    with pytest.raises(SceneError, match=r"1e\+05 for each step"):
        resample(Samples(np.ones(9), 1e7, 0.0, True), 1e-2, 10)
