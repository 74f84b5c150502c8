"""Drives in time: waves times coefficients are the pressure of the scene's tables at every step."""

import numpy as np
import pytest

from support.scenes import PAPER, refusal, refused
from warp_plate import SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import highest_frequency, make_signals
from warp_plate.plate.waveforms import read_samples, resample

TIME_STEP, STEPS = 1e-4, 4000
TIMES = TIME_STEP * np.arange(STEPS)
RATE, SIGNAL = 8000.0, "[drive.signal]\nfile = 'a.wav'"
OWN_FREQUENCY = "[[actuators]]\nname = 'x'\narea = [0, 0.1, 0, 0.1]\nfrequency = 1.0"
# Two plates a quarter of a turn apart, whose loads are the envelope times cos and sin.
SHIFTED = np.array([[1.0] * 3, [-1j] * 3])


@pytest.fixture
def driven_scene(scene):
    """A factory of scenes with a drive."""

    def make(frequencies=(None, None, None), frequency=290.0, effects=None, **drive):
        plain = scene(window=(0.1, 0.5), frequency=frequency)
        pairs = zip(plain.actuators, frequencies, strict=True)
        actuators = [{**actuator.model_dump(), "frequency": value} for actuator, value in pairs]
        return plain.with_tables(drive={"frequency": frequency, **drive}, effects=effects or {}, actuators=actuators)

    return make


def pressure(signals, phasors):
    """Return (plates, steps, actuators), with the first step made whole again."""
    wave = signals.wave.copy()
    wave[0] *= 2
    return np.einsum("nt,ptk->pnk", wave, signals.coefficients(phasors))


def direct(phasors, carriers):
    """Return (plates, steps, actuators) Re(Z·carrier) for carriers (steps, actuators)."""
    return (phasors[:, None, :] * carriers).real


def tones(*frequencies):
    return np.exp(2j * np.pi * TIMES[:, None] * frequencies)


def rise_and_fall(times, duration, ramp):
    """Return the textbook's envelope with raised-cosine ramps."""
    inside = np.clip(np.minimum(times, duration - times) / ramp, 0, 1)
    return np.where((times >= 0) & (times <= duration), (1 - np.cos(np.pi * inside)) / 2, 0)


def write_signal(folder, values):
    np.savetxt(folder / "a.csv", np.column_stack([np.arange(len(values)) / RATE, values]), fmt="%.17g", delimiter=",")


def test_plain_drive(driven_scene, phasors):
    """Cosine and sine, the first step halved, with Re Z and −Im Z, to the last bit."""
    scene = driven_scene()
    scheme, drives = make_scheme(scene), phasors(5, 3)
    signals = make_signals(scene, scheme.time_step, scheme.steps)
    assert signals.linear
    assert scene.linear
    assert scene.nonharmonic_key is None
    assert highest_frequency(scene) == 290
    angle = scheme.angular_frequency * scheme.time_step * np.arange(scheme.steps)
    expected = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    expected[0] /= 2
    np.testing.assert_array_equal(signals.wave, expected)
    np.testing.assert_array_equal(signals.coefficients(drives), np.stack([drives.real, -drives.imag], axis=1))


def test_frequencies_of_actuators(driven_scene, phasors):
    drives = phasors(5, 3)
    scene = driven_scene((None, 410.0, 290.0))
    signals = make_signals(scene, TIME_STEP, STEPS)
    assert signals.terms == 4
    assert highest_frequency(scene) == 410
    np.testing.assert_allclose(pressure(signals, drives), direct(drives, tones(290, 410, 290)), atol=1e-10)
    # With every actuator on a frequency of its own, the drive's counts for nothing.
    scene = driven_scene((200.0, 300.0, 300.0), frequency=9000.0)
    assert highest_frequency(scene) == 300
    assert make_signals(scene, TIME_STEP, STEPS).terms == 4
    assert make_signals(driven_scene((410.0, 410.0, 410.0)), TIME_STEP, STEPS).terms == 2


@pytest.mark.parametrize(("ramp", "start"), [(0.0, 0.0503), (0.013, 0.0), (0.05, 0.0503)])
def test_burst_has_the_spectrum_of_its_formula(driven_scene, ramp, start):
    """Continuous transform of a raised-cosine pulse, sin(πfd')/(πf) · cos(πfr)/(1 − (2fr)²) with d' = d − r, and the
    mean over a step multiplies it by sinc(fΔt); the rest are images around multiples of the steps' rate."""
    duration = 0.1
    scene = driven_scene(burst={"start": start, "duration": duration, "ramp": ramp}, frequency=1e-9)
    signals = make_signals(scene, TIME_STEP, STEPS)
    envelope = signals.wave[:, 0].copy()
    envelope[0] *= 2
    if start == 0:
        envelope[0] /= 2  # the mean over the whole of its step, of which half lies before the start
    frequency = np.linspace(0.3, 400, 200)
    spectrum = TIME_STEP * np.exp(-2j * np.pi * np.outer(frequency, TIMES - start - duration / 2)) @ envelope
    flat = duration - ramp
    exact = flat * np.sinc(frequency * flat) * np.cos(np.pi * frequency * ramp) / (1 - (2 * frequency * ramp) ** 2)
    # Images: a jump's spectrum 1/πf at f ≈ 1/Δt times sinc there, f·Δt ≤ 0.04; smooth ramps have none to speak of.
    images = 2 * TIME_STEP * 0.04 if ramp == 0 else 1e-3 * TIME_STEP
    np.testing.assert_allclose(spectrum, exact * np.sinc(frequency * TIME_STEP), atol=images, rtol=0)
    assert np.sum(envelope) * TIME_STEP == pytest.approx(flat, rel=1e-9)


def test_repeated_burst_in_time(driven_scene, phasors):
    """Between ramps the envelope is that of the formula to the order of the step; outside it is zero."""
    drives = phasors(5, 3)
    burst = {"start": 0.0321, "duration": 0.05, "ramp": 0.01, "period": 0.07}
    values = pressure(make_signals(driven_scene(burst=burst), TIME_STEP, STEPS), drives)
    envelope = sum(rise_and_fall(TIMES - 0.0321 - 0.07 * turn, 0.05, 0.01) for turn in range(6))
    curvature = (np.pi / 0.01) ** 2 / 2
    error = np.abs(values - envelope[:, None] * direct(drives, tones(290, 290, 290)))
    assert error.max() <= curvature * TIME_STEP**2 / 4 * np.abs(drives).max()
    np.testing.assert_allclose(values[:, (TIMES > 0.0823) & (TIMES < 0.1019)], 0, atol=1e-10)
    assert np.abs(values[:, TIMES < 0.0319]).max() == 0


@pytest.mark.parametrize(("law", "end"), [("linear", 800.0), ("logarithmic", 800.0), ("logarithmic", 290.0)])
def test_chirp_sweeps_and_stays(driven_scene, law, end):
    """The phase's rate of change is the law's frequency at mid-step, and end_frequency after the sweep."""
    span = 0.25
    scene = driven_scene(chirp={"end_frequency": end, "duration": span, "law": law})
    signals = make_signals(scene, TIME_STEP, STEPS)
    assert signals.terms == 2
    assert highest_frequency(scene) == max(end, 290)
    wave = signals.wave[:, 0] + 1j * signals.wave[:, 1]
    frequency = np.angle(wave[1:] / wave[:-1]) / (2 * np.pi * TIME_STEP)
    part = np.minimum((TIMES[1:] - TIME_STEP / 2) / span, 1)
    wanted = 290 + (end - 290) * part if law == "linear" else 290 * (end / 290) ** part
    # Mid-point rule: exact for the linear law but in the step where the sweep ends.
    np.testing.assert_allclose(frequency, wanted, atol=1e-7 if law == "linear" else 1e-3)


def test_chirp_of_two_starts(driven_scene, phasors):
    """An actuator's frequency is where its sweep begins."""
    drives = phasors(5, 3)
    scene = driven_scene((None, 500.0, None), chirp={"end_frequency": 600.0, "duration": 0.2})
    signals = make_signals(scene, TIME_STEP, STEPS)
    inside = np.minimum(TIMES, 0.2)
    cycles = [f * inside + (600 - f) * inside**2 / 0.4 + 600 * (TIMES - inside) for f in (290, 500, 290)]
    carriers = np.exp(2j * np.pi * np.stack(cycles, axis=1))
    np.testing.assert_allclose(pressure(signals, drives), direct(drives, carriers), atol=1e-9)


@pytest.mark.parametrize(
    ("bias", "drive", "frequencies", "terms"),
    [
        (-2.0, {}, (None, 580.0, None), 7),  # 1; 290, 580 (of both), 1160
        (3.0, {"burst": {"start": 0.05, "duration": 0.1, "ramp": 0.02, "period": 0.13}}, (None, None, None), 6),
        (0.0, {"burst": {"start": 0.05, "duration": 0.1}}, (None, 580.0, None), 5),
        (3.0, {"chirp": {"end_frequency": 700.0, "duration": 0.2}, "burst": {"duration": 0.3}}, (None,) * 3, 6),
        (3.0, {"signal": {"file": "a.csv"}, "burst": {"start": 0.05, "duration": 0.1}}, (None, None, None), 6),
        (0.0, {"signal": {"file": "a.csv"}}, (None, None, None), 3),
    ],
)
def test_electrostatic_terms_are_the_square(driven_scene, random, phasors, tmp_path, bias, drive, frequencies, terms):
    """Against gain·(bias + V)² with V from the same scene without the table."""
    write_signal(tmp_path, random.normal(size=4000))
    drives, gain = phasors(5, 3), 0.7
    scene = driven_scene(frequencies, electrostatic={"bias": bias, "gain": gain}, **drive)
    signals = make_signals(scene, TIME_STEP, STEPS, tmp_path)
    plain = make_signals(driven_scene(frequencies, **drive), TIME_STEP, STEPS, tmp_path)
    assert signals.terms == terms
    assert (signals.linear, scene.linear) == (False, False)
    voltage = pressure(plain, drives)
    if "signal" in drive:
        # Squared, it would fill twice the band, so it is low-passed to half of it first.
        carrier = resample(read_samples(scene.drive.signal, tmp_path), TIME_STEP, STEPS, 0.5)
        envelope = np.abs(pressure(make_signals(driven_scene(burst=drive.get("burst")), TIME_STEP, STEPS), SHIFTED))
        voltage = np.hypot(*envelope)[:, :1] * direct(drives, carrier[:, None])
    assert highest_frequency(scene) == 2 * highest_frequency(driven_scene(frequencies, **drive))
    squared = np.ones(STEPS) if "burst" not in drive else mean_square_over_square_mean(**drive["burst"])
    wanted = gain * (bias**2 + 2 * bias * voltage + squared[:, None] * voltage**2)
    np.testing.assert_allclose(pressure(signals, drives), wanted, atol=1e-9 if "burst" not in drive else 1e-4)


def mean_square_over_square_mean(duration, start=0.0, ramp=0.0, period=np.inf):
    """Return (steps,) ratios for the envelope over each step, from many samples; one unless it changes within."""
    samples = 500
    times = TIMES[:, None] + TIME_STEP * ((np.arange(samples) + 0.5) / samples - 0.5)
    times = np.where(TIMES[:, None] == 0, np.abs(times), times) - start
    times -= period * np.maximum(np.floor(times / period), 0) if period < np.inf else 0
    jumping = ((times >= 0) & (times <= duration)).astype(float)
    envelope = rise_and_fall(times, duration, ramp) if ramp else jumping
    mean = envelope.mean(axis=1)
    return np.divide((envelope**2).mean(axis=1), mean**2, out=np.ones(STEPS), where=mean > 0)


def test_a_tone_in_a_file(driven_scene, phasors, tmp_path):
    """A file that repeats a tone drives as the tone itself, phase lags included."""
    write_signal(tmp_path, np.cos(2 * np.pi * 290 * np.arange(8000) / RATE))
    drives = phasors(5, 3)
    scene = driven_scene(signal={"file": "a.csv", "repeat": True, "gain": -2.0})
    signals = make_signals(scene, TIME_STEP, STEPS, tmp_path)
    assert signals.terms == 2
    assert signals.linear
    assert read_samples(scene.drive.signal, tmp_path).highest_frequency() == pytest.approx(290, abs=1)
    wanted = direct(-2 * drives, tones(290, 290, 290))
    np.testing.assert_allclose(pressure(signals, drives), wanted, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ("[drive.burst]\nduration = 0.1\nperiod = 0.09", "drive.burst.period: 0.09 s"),
        ("[drive.burst]\nstart = 0.1\nduration = 0.1", "drive.burst.start: 0.1 s"),
        ("[drive.burst]\nramp = 0.1", "drive.burst.duration: "),
        ("[drive.signal]\nfile = '../a.wav'", "drive.signal.file: '../a.wav'"),
        (f"{SIGNAL}\nrate = 10", "drive.signal.rate: 'a.wav'"),
        (f"{SIGNAL}\nstart = 0.1", "drive.signal.start: 0.1 s is after the run"),
        (f"{SIGNAL}\n[drive.chirp]\nend_frequency = 9\nduration = 1", "drive.chirp: "),
        (f"{SIGNAL}\n{OWN_FREQUENCY}", "actuators[4].frequency: drive"),
    ],
)
def test_bad_tables_are_refused_by_name(table, named):
    assert refusal(f"{PAPER}\n{table}").startswith(named)


@pytest.mark.parametrize(
    ("frequencies", "drive", "named"),
    [
        ((None,) * 3, {"frequency": 5000.0}, "drive.frequency = 5000: a step of 0.0001 s carries less than 5000"),
        ((None, 6e3, None), {}, "actuators[1].frequency = 6000"),
        ((None,) * 3, {"chirp": {"end_frequency": 9e3, "duration": 1e-20}}, "drive.chirp.end_frequency = 9000"),
        ((None,) * 3, {"frequency": 2500.0, "electrostatic": {"gain": 1.0}}, "drive.frequency = 2500: a step of"),
        ((None,) * 3, {"burst": {"duration": 1e-20}}, "drive.burst.duration = 1e-20: shorter than a step"),
    ],
)
def test_signals_that_steps_cannot_carry_are_refused(driven_scene, frequencies, drive, named):
    assert refused(make_signals, driven_scene(frequencies, **drive), TIME_STEP, STEPS).startswith(named)


def test_a_moving_load_s_frequency_bounds_the_step(driven_scene):
    """An electrostatic drive does not double it."""
    effects = {"moving_load": {"force": 1.0, "start": (0.1, 0.1), "frequency": 900.0}}
    assert highest_frequency(driven_scene(effects=effects, electrostatic={"gain": 1.0})) == 900
    with pytest.raises(SceneError, match=r"^effects\.moving_load\.frequency = 900: a step of .* carries less than 500"):
        make_signals(driven_scene(effects=effects), 1e-3, STEPS)
