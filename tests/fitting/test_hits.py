"""Records with hits: which are used, and the responses that they have, without the damping of the window."""

import logging

import numpy as np
import pytest
from scipy.io import wavfile

from warp_plate import Scene, fit
from warp_plate.fitting.hits import find_hits, hit_spectra
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.panel_responses import PanelResponses
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fit import TimeSignals

RATE = 4096
MODES = ((61.0, 0.004, 1.0), (148.0, 0.003, -2.0), (260.0, 0.002, 1.5))  # natural frequency, damping ratio, residue


def accelerance(s):
    """Return the response of the modes at s [1/s]."""
    return sum(a * s**2 / (s**2 + 2 * z * w * s + w**2) for w, z, a in ((2 * np.pi * f, z, a) for f, z, a in MODES))


def record(random, times=(1.0, 5.3, 9.1, 13.7), duration=20.0, doubled=(), noise=0.0, force=None):
    """Return force and acceleration (2, samples) of hits of 2 ms at some times [s]; ``doubled`` ones bounce."""
    samples = round(duration * RATE)
    clock = np.arange(samples) / RATE
    if force is None:
        force = np.zeros(samples)
        for at in [*times, *(times[index] + 0.06 for index in doubled)]:
            part = (clock - at) / 2e-3
            force += np.where((part > 0) & (part < 1), np.sin(np.pi * part), 0.0) * random.uniform(0.8, 1.2)
    omega = 2 * np.pi * np.fft.rfftfreq(4 * samples, 1 / RATE)
    motion = np.fft.irfft(np.fft.rfft(force, 4 * samples) * accelerance(1j * omega))[:samples]
    signals = np.stack([force, motion])
    return signals + noise * random.normal(size=signals.shape) * np.array([[1.0], [motion.std()]])


def estimated(signals, **keys):
    table = TimeSignals(**{"hits": True, "segment": 3.0} | keys)
    frequencies, force, _, crossed, count = hit_spectra(signals[0], signals[1:], RATE, table)
    return frequencies, (crossed / force)[0], count


@pytest.mark.parametrize("tau", [0.4, 0.8])
def test_exponential_window_moves_responses_along_the_real_axis(random, tau):
    """Lightly damped modes do not come to rest within a block; at s = iω + 1/τ their responses are exact."""
    frequencies, response, count = estimated(record(random), exponential=tau)
    assert count == 4
    band = (frequencies > 20) & (frequencies < 300)
    exact = accelerance(2j * np.pi * frequencies + 1 / tau)
    np.testing.assert_allclose(response[band], exact[band], atol=2 * np.exp(-3 / tau) * np.abs(exact[band]).max())


def test_averages_of_hits_reduce_noise(random):
    frequencies, *_ = estimated(signals := record(random, noise=0.02), exponential=0.5)
    exact, band = accelerance(2j * np.pi * frequencies + 2.0), (frequencies > 40) & (frequencies < 300)
    one = estimated(signals[:, : 4 * RATE], exponential=0.5)[1]
    errors = [np.linalg.norm((row - exact)[band]) for row in (estimated(signals, exponential=0.5)[1], one)]
    assert errors[0] < 0.7 * errors[1]


def test_double_hits_overloads_and_the_last_one_are_left_out_and_said(random, caplog):
    signals = record(random, times=(1.0, 5.3, 9.1, 13.7, 19.0), doubled=(1,))
    block = slice(9 * RATE, 12 * RATE)
    signals[1, block] = signals[1, block].clip(max=0.6 * signals[1, block].max())
    with caplog.at_level(logging.WARNING, "warp_plate"):
        *_, count = estimated(signals)
    assert count == 2
    assert "3 of 5 hits are left out: 5.301 s (double hit), 9.101 s (overload of the sensor 1), 19" in caplog.text
    assert "the record ends within its block" in caplog.text
    bad = record(random, times=(1.0,), doubled=(0,), duration=6.0)
    with pytest.raises(ValueError, match="has no hit that can be used: 1"):
        estimated(bad)
    with pytest.raises(ValueError, match=r"has no hit that can be used: 1.001 s \(it lasts longer than its block\)"):
        estimated(bad, segment=1e-3)
    with pytest.raises(ValueError, match="the force is at rest"):
        estimated(np.zeros((2, 4 * RATE)))


def test_coarse_numbers_of_smooth_signals_are_no_overload(random):
    signals = record(random)
    assert estimated(np.round(signals / np.abs(signals).max(axis=1, keepdims=True) * 300))[2] == 4


def test_hits_are_found_within_noise(random):
    found = find_hits(record(random, noise=0.02)[0], 3 * RATE)
    np.testing.assert_allclose([peak / RATE for _, peak, _ in found], np.array([1.0, 5.3, 9.1, 13.7]) + 1e-3, atol=1e-3)


def panel(tau=None):
    """Return a lightly damped panel whose Young's modulus and damping are free."""
    signals = {"hits": True, "segment": 1.0} | ({} if tau is None else {"exponential": tau})
    rows = [{"force_at": [0.06, 0.05], "point": [0.13, 0.11]}]
    free = {"plate.young_modulus": [8e8, 1.2e9], "effects.damping.viscous": [0.2, 40.0]}
    changes = {"measurement": rows, "fit": {"free": free, "starts": 2, "range": [15.0, 160.0], "signals": signals}}
    scene = Scene.load("paper", ["effects.damping.viscous=3.0", "grid={modal_density=0.6}"])
    tables = scene.model_dump(exclude_none=True, exclude_unset=True)
    return Scene.from_tables({**tables, **changes})


def test_fit_finds_the_damping_without_that_of_the_window(tmp_path, random):
    """A panel that rings for seconds, in blocks of one second; the window adds twice its damping."""
    tau = 0.15
    scene, rate, duration = panel(tau), 2048, 8.0
    samples = round(duration * rate)
    lines = np.fft.rfftfreq(2 * samples, 1 / rate)
    used = (lines > 0) & (lines <= 400)
    blank = MeasuredResponses("bench", lines[used], np.ones((1, used.sum()), dtype=complex))
    response = np.zeros(lines.size, dtype=complex)
    response[used] = PanelResponses(scene, blank, coarse=True).values[0]
    clock, force = np.arange(samples) / rate, np.zeros(samples)
    for at in (0.5, 2.9, 5.6):
        part = (clock - at) / 3e-3
        force += np.where((part > 0) & (part < 1), np.sin(np.pi * part), 0.0)
    motion = np.fft.irfft(np.fft.rfft(force, 2 * samples) * response)[:samples]
    size = 1.05 * np.abs(motion).max()
    wavfile.write(tmp_path / "hits.wav", rate, np.stack([force, motion / size], axis=1).astype(np.float32))
    rows = [row.model_copy(update={"gain": 1 / size}) for row in scene.measurement]
    found = fit(scene.model_copy(update={"measurement": tuple(rows)}), tmp_path / "hits.wav")
    young, viscous = found.values
    assert young == pytest.approx(1e9, rel=2e-3)
    assert viscous == pytest.approx(3.0, rel=0.05)


def test_window_without_hits_is_refused():
    with pytest.raises(SceneError, match="exponential: is a window of hits; write hits = true"):
        TimeSignals(exponential=0.1)
