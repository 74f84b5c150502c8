"""Plots of fits: what is on their axes."""

from types import SimpleNamespace

import numpy as np
import pytest

from warp_plate.fitting.fit import modal_assurance
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.viz.plots import frequency_response as plots

Figure = pytest.importorskip("matplotlib.figure").Figure


@pytest.fixture
def axes_of(monkeypatch, tmp_path):
    """Return a function that draws, and returns the axes of the figure."""
    saved, save = [], Figure.savefig

    def saves(figure, *arguments, **options):
        saved.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", saves)

    def draw(function, found, *arguments):
        function(found, tmp_path / "a.png", *arguments)
        return saved[-1].axes

    return draw


def response_fit(random, count=5):
    frequencies = np.linspace(10, 100, 60)
    poles = 30 + 10 * np.arange(count)[:, None]
    exact = 1 / (poles**2 - frequencies**2 + 0.05j * poles**2)
    noisy = exact * (1 + 0.1 * random.normal(size=exact.shape))
    measured = MeasuredResponses("a.csv", frequencies, noisy, random.uniform(0.8, 1, exact.shape))
    row = SimpleNamespace(actuator=None, force_at=(0.1, 0.05), point=(0.02, 0.03), quantity="accelerance")
    scene = SimpleNamespace(title="", measurement=[row] * count, plate=SimpleNamespace(size=(0.2, 0.1)))
    return SimpleNamespace(scene=scene, measured=measured, responses=exact)


def test_responses(axes_of, random):
    found = response_fit(random)
    axes = axes_of(plots.draw_response_fit, found)
    assert len(axes) == 3 * plots.MOST_RESPONSES
    for index in range(plots.MOST_RESPONSES):
        measured, fitted = (line.get_ydata() for line in axes[index].lines)
        np.testing.assert_allclose(measured, np.abs(found.measured.responses[index]))
        np.testing.assert_allclose(fitted, np.abs(found.responses[index]))
        np.testing.assert_array_equal(axes[8 + index].lines[0].get_ydata(), found.measured.coherence[index])
    assert axes[0].get_ylabel() == "accelerance [(m/s²)/N]"
    assert axes[0].get_title() == "(100, 50) → (20, 30) mm"


def test_modes(axes_of, random):
    shapes = random.normal(size=(5, 9)) + 1j * random.normal(size=(5, 9))
    mac = modal_assurance(shapes, 2j * shapes)
    np.testing.assert_allclose(np.diag(mac), 1)
    assert np.all(mac - np.eye(5) < 0.9)
    measured = SimpleNamespace(frequencies=np.linspace(20, 90, 5))
    errors = np.array([0.01, -0.02, 0.0, 0.005, 0.001])
    found = SimpleNamespace(scene=SimpleNamespace(title=""), numbers=np.arange(1, 6), errors=errors, measured=measured)
    bars, matrix, _ = axes_of(plots.draw_mode_fit, found, mac)
    np.testing.assert_allclose([bar.get_height() for bar in bars.patches], 100 * errors)
    np.testing.assert_array_equal(matrix.images[0].get_array(), mac)
    assert len(axes_of(plots.draw_mode_fit, found)) == 1
