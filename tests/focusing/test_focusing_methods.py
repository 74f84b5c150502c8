"""Methods of focusing over any responses: against random waveforms, convex duality and the definition."""

import numpy as np
import pytest
import scipy

from warp_plate.focusing.methods import Convolution, inverse_filter, keep_above, optimum, scale_to_limits

SHAPE = (3, 2, 40)  # actuators, foci, samples
ENERGY, PEAK = 30.0, 0.8
LIMITS = [(ENERGY, None), (None, PEAK), (ENERGY, PEAK), (1e3, PEAK)]


@pytest.fixture
def h(random):
    return random.normal(size=SHAPE) * np.exp(-np.arange(40) / 10)


@pytest.fixture
def gains(h):
    """The gains (foci, actuators, samples) of the motion of each focus at the last sample."""
    return Convolution(h, 40).reverse(np.eye(2)[:, :, None] * np.eye(40)[-1])


def matrix_of(h):
    """Return the matrix of the convolution, (foci · samples, actuators · samples)."""
    return np.block([[scipy.linalg.toeplitz(row, np.zeros(40)) for row in rows] for rows in h.swapaxes(0, 1)])


def test_motion_and_gains_follow_the_definition(h, gains, random):
    """Against the sum that defines the motion, sample by sample."""
    waveforms = random.normal(size=(1, 3, 40))
    moved = [
        [sum(h[a, f, m - n] * waveforms[0, a, n] for a in range(3) for n in range(m + 1)) for m in range(40)]
        for f in range(2)
    ]
    np.testing.assert_allclose(Convolution(h, 40).move(waveforms)[0], moved, atol=1e-12)
    np.testing.assert_allclose(np.einsum("fan,an->f", gains, waveforms[0]), np.array(moved)[:, -1])
    wished = random.normal(size=(1, 2, 40))
    np.testing.assert_allclose(Convolution(h, 40).reverse(wished).ravel(), matrix_of(h).T @ wished.ravel())


@pytest.mark.parametrize(("energy", "peak"), LIMITS)
def test_no_random_waveforms_beat_the_optimum(gains, random, energy, peak):
    """10⁴ of them at the limits: half at random, half near the optimum."""
    gains = gains[0]
    best, bound = optimum(gains, energy, peak)
    reached = float((gains * best).sum())
    assert abs(bound - reached) < 1e-6 * bound
    assert (best**2).sum() <= (energy or np.inf) * (1 + 1e-9)
    assert np.abs(best).max() <= (peak or np.inf) * (1 + 1e-12)
    for near in (0.0, 1.0):
        for _ in range(10):
            tried = near * best + random.normal(size=(500, *best.shape)) * 10.0 ** random.uniform(-6, 1)
            tried = scale_to_limits(np.clip(tried, -(peak or np.inf), peak or np.inf), energy, peak)
            assert (tried * gains).sum(axis=(1, 2)).max() <= bound * (1 + 1e-12)


def test_one_limit_alone_gives_time_reversal_or_its_signs(gains):
    by_energy, by_peak = (
        scale_to_limits(tried, *limits) for tried, limits in zip((gains, np.sign(gains)), LIMITS, strict=False)
    )
    for focus, g in enumerate(gains):
        np.testing.assert_allclose(optimum(g, ENERGY, None)[0], by_energy[focus])
        np.testing.assert_allclose(optimum(g, None, PEAK)[0], by_peak[focus])
    assert (by_energy[0] ** 2).sum() == pytest.approx(ENERGY)
    assert np.abs(by_peak).max() == PEAK


def test_what_moves_nothing_is_silent():
    silent = np.zeros((2, 5))
    assert optimum(silent, 1.0, None) == (pytest.approx(silent), 0.0)
    assert not scale_to_limits(np.zeros((1, 2, 5)), 1.0, 2.0).any()


def test_low_frequencies_are_left_out():
    """Two tones of whole periods are separated, within the spread of the ends of the record."""
    times = np.arange(4800) / 48000
    low, high = np.sin(2 * np.pi * 100 * times), np.sin(2 * np.pi * 3000 * times)
    inside = slice(1000, -1000)
    np.testing.assert_allclose(keep_above(low + high, 48000, 1000.0)[inside], high[inside], atol=0.02)


def test_an_inverse_filter_that_does_not_converge_says_so(h, caplog):
    inverse_filter(Convolution(h, 30), np.ones((1, 2, 40)), 1e4, most_steps=2)
    assert "ended after 2 steps; a smaller focus.condition" in caplog.text


@pytest.mark.parametrize(("foci", "samples", "condition"), [(2, 30, 3.0), (2, 30, 1000.0), (6, 40, 50.0)])
def test_inverse_filter_is_the_regularised_least_squares_solution(random, foci, samples, condition):
    """Against dense matrices; of 30 samples that move the foci for 40, and of three panels of two foci."""
    h = random.normal(size=(3, foci, 40)) * np.exp(-np.arange(40) / 10)
    wished = random.normal(size=(2, foci, 40))
    dense = matrix_of(h).reshape(-1, 3, 40)[..., :samples].reshape(40 * foci, -1)
    largest = np.linalg.svd(np.moveaxis(np.fft.rfft(h, 80), -1, 0), compute_uv=False).max()
    normal = dense.T @ dense + (largest / condition) ** 2 * np.eye(dense.shape[1])
    expected = np.linalg.solve(normal, dense.T @ wished.reshape(2, -1).T).T.reshape(2, 3, samples)
    found = inverse_filter(Convolution(h, samples), wished, condition)
    np.testing.assert_allclose(found, expected, atol=3e-3 * np.abs(expected).max())
