"""Natural frequencies and damping ratios from decays of random panels with noise, without a force."""

import re

import numpy as np
import pytest
import scipy
from scipy.io import wavfile

from support.measured import drawn_panel
from warp_plate import SceneError, fit
from warp_plate.fitting.taps import read_tap, tap_modes
from warp_plate.modal.modes import solve_modes


def tapped(seed, decibels=30.0, duration=2.0):
    """Return frequencies, damping ratios and amplitudes of a random panel, its record of a tap, and the rate."""
    random = np.random.default_rng(seed)
    scene = drawn_panel(random, most_modes=20)
    highest = scene.drive.frequency
    plate = solve_modes(scene, highest, density=0.5)
    count = int((plate.frequencies <= highest).sum())
    frequencies = plate.frequencies[:count]
    damping = plate.damping_ratios[:count] * np.exp(random.normal(0, 0.3, count))
    hit, sensor = random.uniform(0.1, 0.9, (2, 2)) * scene.plate.size
    amplitudes = np.prod(plate.at_points(np.array([hit, sensor]))[:count], axis=1)
    rate = max(4000, int(5 * highest))
    times, omega = np.arange(int(duration * rate)) / rate, 2 * np.pi * frequencies
    waves = np.exp(-np.outer(damping * omega, times)) * np.sin(np.outer(omega * np.sqrt(1 - damping**2), times))
    record = np.concatenate([np.zeros(rate // 10), amplitudes @ waves])
    noise = np.sqrt(np.mean(record**2)) * 10 ** (-decibels / 20)
    return frequencies, damping, amplitudes, record + noise * random.normal(size=record.size), rate


def decaying(frequencies, damping, amplitudes, noise, random, rate=4000):
    """Return records (channels, samples) of 2 s with modes of amplitudes (channels, modes) and noise (channels,)."""
    omega, damping = 2 * np.pi * np.array(frequencies), np.array(damping)
    times = np.arange(2 * rate) / rate
    waves = np.exp(-np.outer(damping * omega, times)) * np.sin(np.outer(omega * np.sqrt(1 - damping**2), times))
    quiet, noise = np.zeros((len(noise), rate // 10)), np.array(noise)[:, None]
    return np.hstack([quiet, amplitudes @ waves]) + noise * random.normal(size=(len(noise), 2 * rate + rate // 10))


def judged(seed):
    """Return relative errors of the modes that are not said to be pairs, errors of all over their bars, and whether the
    strong modes that stand alone were found."""
    frequencies, damping, amplitudes, record, rate = tapped(seed)
    modes = tap_modes(record[None], rate)
    nearest = np.abs(modes.frequencies[:, None] / frequencies - 1).argmin(axis=1)
    widths = damping * frequencies
    apart = np.abs(frequencies[:, None] - frequencies) / (widths[:, None] + widths)
    alone = np.sort(apart, axis=1)[:, 1] > 1
    truth, found = np.stack([frequencies, damping])[:, nearest], np.stack([modes.frequencies, modes.damping])
    strength = np.abs(amplitudes) / np.sqrt(damping)
    strong = np.flatnonzero(alone & (strength > 0.2 * strength.max()))
    over = (found - truth) / [modes.frequency_bars, modes.damping_bars]
    return (found / truth - 1).T[~modes.pairs], over.T, np.isin(strong, nearest)


@pytest.mark.parametrize("seed", [1, 4])
def test_modes_of_a_tap(seed):
    errors, over, found = judged(seed)
    assert np.abs(errors[:, 0]).max() < 1e-3
    assert np.abs(errors[:, 1]).max() < 0.05
    assert np.abs(over).max() < 1
    assert found.mean() > 0.8


@pytest.mark.parametrize(("seed", "near"), [(56, 498), (153, 129)])
def test_bars_of_modes_that_may_be_two(seed, near):
    """Two modes closer than half of their widths are one pole: it is named, and its bars have the nearest mode."""
    frequencies, damping, _, record, rate = tapped(seed)
    modes = tap_modes(record[None], rate)
    pair = np.abs(modes.frequencies - near).argmin()
    assert modes.pairs[pair]
    nearest = np.abs(frequencies - modes.frequencies[pair]).argmin()
    error = abs(modes.damping[pair] / damping[nearest] - 1)
    assert 0.04 < error < modes.damping_bars[pair] / damping[nearest] < 0.4
    assert abs(modes.frequencies[pair] - frequencies[nearest]) < modes.frequency_bars[pair]


def test_faint_modes_do_not_disturb_others(random):
    """A mode of 0.09 % of the largest sample is not told, but its neighbour is right in spite of it."""
    record = decaying([200, 208, 600], [0.005, 0.005, 0.01], [[0.03, 0.0018, 2.0]], [1e-4], random)
    modes = tap_modes(record, 4000.0)
    np.testing.assert_allclose(modes.frequencies, [200, 600], rtol=3e-5)
    assert (np.abs(modes.frequencies - [200, 600]) < modes.frequency_bars).all()
    assert (np.abs(modes.damping - [0.005, 0.01]) < modes.damping_bars).all()


def test_bars_of_channels_with_unequal_noise(random):
    """Bars are 3.5 standard deviations of a mode that is loud in the channel with the noise."""
    over = []
    for _ in range(12):
        record = decaying([150, 260], [0.01, 0.01], [[1, 1], [0.05, 1]], [0.03, 0.002], random)
        modes = tap_modes(record, 4000.0, (100, 300))
        errors = modes.frequencies[0] - 150, modes.damping[0] - 0.01
        over.append(np.divide(errors, [modes.frequency_bars[0], modes.damping_bars[0]]))
    sizes = 3.5 * np.sqrt(np.mean(np.square(over), axis=0))
    assert (sizes > 0.5).all()
    assert (sizes < 1.5).all()


def test_silent_channels_do_not_matter():
    *_, record, rate = tapped(1)
    both = tap_modes(np.array([record, np.zeros(record.size), np.full(record.size, 0.1)]), rate)
    alone = tap_modes(record[None], rate)
    for name in ("frequencies", "damping", "damping_bars"):
        np.testing.assert_allclose(getattr(both, name), getattr(alone, name), rtol=2e-3)


def test_clipped_beginnings_are_left_out():
    """A record that is clipped at half of its largest sample has the same modes; with its beginning, two are left."""
    frequencies, damping, _, record, rate = tapped(4)
    most = 0.5 * np.abs(record).max()
    found = tap_modes(record[None].clip(-most, most), rate)
    nearest = np.abs(found.frequencies[:, None] / frequencies - 1).argmin(axis=1)
    assert len(found.frequencies) == len(tap_modes(record[None], rate).frequencies)
    np.testing.assert_allclose(found.frequencies, frequencies[nearest], rtol=1e-4)
    np.testing.assert_allclose(found.damping, damping[nearest], rtol=0.02)


def test_what_follows_the_samples_of_the_bands_takes_no_time(monkeypatch):
    """14 s of 25 Hz; filters see as much of a record of five minutes, and find the same."""
    omega, times = 2 * np.pi * 60.0, np.arange(300 * 1000) / 1000
    record = np.exp(-0.01 * omega * times) * np.sin(omega * times) + 1e-4 * np.sin(1e3 * times**2)
    seen, convolve = [], scipy.signal.oaconvolve
    monkeypatch.setattr(scipy.signal, "oaconvolve", lambda a, *b, **keys: seen.append(a) or convolve(a, *b, **keys))
    long, short = (tap_modes(record[None, : 1000 * seconds], 1000.0, (20, 120)) for seconds in (300, 15))
    assert max(rows.shape[1] for rows in seen) < 15_000
    np.testing.assert_allclose(long.damping, short.damping, rtol=1e-6)


def test_equations_of_many_channels_have_no_more_unknowns(monkeypatch, random):
    """Amplitudes of each channel are eliminated; with them, 24 channels had 50 unknowns for two modes."""
    record = decaying([150, 260], [0.01, 0.01], random.normal(size=(24, 2)), [0.01] * 24, random)
    seen, solve = [], np.linalg.lstsq
    monkeypatch.setattr(np.linalg, "lstsq", lambda a, *b, **keys: seen.append(a.shape[1]) or solve(a, *b, **keys))
    np.testing.assert_allclose(tap_modes(record, 4000.0, (100, 300)).frequencies, [150, 260], rtol=1e-4)
    assert max(seen) <= 36  # orders of the model


@pytest.mark.slow
def test_taps_of_panels():
    """Among 100 modes there may be one that is two, a tenth of their widths apart, without a trace in its decay."""
    errors, over, found = (np.concatenate(parts) for parts in zip(*map(judged, range(20)), strict=True))
    assert (np.abs(errors) < [1e-3, 0.05]).all(axis=1).mean() > 0.98
    assert (np.abs(over) < 1).mean() > 0.95
    assert found.mean() > 0.8


def test_fit_to_a_wav_file(tmp_path):
    """Its modes are paired with those of the scene, whatever the length of the silence before it."""
    table = {"free": {"plate.young_modulus": [5e10, 9e10]}, "pairing": "nearest", "starts": 2}
    scene = drawn_panel(np.random.default_rng(8)).with_tables(fit=table)
    plate = solve_modes(scene, 0.0, count=6)
    omega = 2 * np.pi * plate.frequencies[:6] * 1.03
    rate = int(omega[-1])
    times = np.arange(2 * rate) / rate
    decay = np.exp(-np.outer(0.01 * omega, times)) * np.cos(np.outer(omega, times) + 0.3)
    record = np.concatenate([np.zeros(rate // 3), decay.sum(axis=0)]) / 10
    wavfile.write(tmp_path / "tap.wav", rate, np.stack([record, -0.4 * record], axis=1).astype(np.float32))
    found = fit(scene, tmp_path / "tap.wav")
    assert found.scene.plate.young_modulus == pytest.approx(1.03**2 * scene.plate.young_modulus, rel=1e-3)
    np.testing.assert_allclose(found.measured.damping, 0.01, rtol=0.01)


def test_fit_names_modes_that_the_panel_has_closer_than_their_widths(tmp_path):
    """Two modes 0.3 % apart are one pole, 0.12 % off; no record tells this, but the panel does."""
    frequencies, *_, record, rate = tapped(399)
    assert not tap_modes(record[None], rate).pairs[2]
    table = {"free": {"plate.young_modulus": [5e10, 9e10]}, "pairing": "nearest", "starts": 2}
    scene = drawn_panel(np.random.default_rng(399), most_modes=20).with_tables(fit=table)
    wavfile.write(tmp_path / "tap.wav", rate, (record / 20).astype(np.float32))
    found = fit(scene, tmp_path / "tap.wav")
    assert found.scene.plate.young_modulus == pytest.approx(scene.plate.young_modulus, rel=1e-3)
    named = np.flatnonzero(np.isnan(found.measured.damping))
    assert named.tolist() == [2]
    assert found.measured.frequencies[2] == pytest.approx(frequencies[2:4].mean(), rel=1e-3)
    assert "The mode at 113.001 Hz may be two: the panel has one at 11" in " ".join(found.warnings)


@pytest.mark.parametrize(
    ("record", "words"),
    [
        (np.zeros(4000), "holds no sound"),
        (np.zeros(0), "holds no sound"),
        (1e-300 * np.eye(1, 4000)[0], "holds no sound; its samples differ by less than 1e-30"),
        (np.eye(1, 4000, 3990)[0], "holds less than 0.2 s"),
        *((np.where(np.arange(4000) == 9, odd, 0.1), "a sample is no number, or larger than 1e+30")
          for odd in (np.nan, np.inf, -np.inf, 1e300)),
    ],
)  # fmt: skip
def test_records_without_a_decay_are_refused(record, words, tmp_path):
    wavfile.write(tmp_path / "tap.wav", 4000, record)
    with pytest.raises(SceneError, match=re.escape(words)):
        read_tap(tmp_path / "tap.wav")


def test_noise_determines_no_mode(random):
    with pytest.raises(ValueError, match="no mode is determined"):
        tap_modes(random.normal(size=(1, 8000)), 4000.0)
