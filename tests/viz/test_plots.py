"""Texts of Matplotlib plots: they fit, do not overlap, and are true."""

import itertools
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from support.pictures import pixels
from support.results import result_of
from support.scenes import scene_of
from warp_plate import Scene
from warp_plate.fitting.fit import modal_assurance
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.result.case import Case
from warp_plate.result.sweep import REFUSED
from warp_plate.scene.vary import make_plan, parse_vary
from warp_plate.studies.frequency_response import frf
from warp_plate.studies.specify import specify
from warp_plate.studies.sweep import SweepRequest, start_sweep
from warp_plate.viz.annotations import GRID
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.plots.plan import draw_crosstalk
from warp_plate.viz.plots.responses import MOST_RESPONSES, draw_frequency_response, draw_mode_fit, draw_response_fit
from warp_plate.viz.plots.search import draw_history, draw_spectrum
from warp_plate.viz.plots.specified import draw_specified
from warp_plate.viz.plots.sweep import LINE_COLOURS, REFUSED_GREY, REFUSED_TICK, cell_edges, draw_sweep

matplotlib = pytest.importorskip("matplotlib")
figures = pytest.importorskip("matplotlib.figure", reason="Matplotlib is not installed: pip install 'warp-plate[viz]'")

TARGETS = ({"name": "left", "area": (0.0, 0.1, 0.0, 0.2)}, {"name": "disc", "disc": (0.15, 0.1, 0.03)})
LONG = ("lower left quarter of the panel", "disc under the index finger")
FREE = {"magnitude": {"range": [0.0, 2.0]}, "phase": {}, "frequency": {"range": [100.0, 400.0]}}

BOUND = "bound of the permitted drives"


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """A function that draws something, and returns the figure and its texts: none cut off, none overlapping."""
    from matplotlib.text import Text

    saved, boxes, save, write = [], {}, figures.Figure.savefig, Text.draw

    def saves(figure, *args, **options):
        saved.append(figure)
        boxes.clear()
        save(figure, *args, **options)

    def writes(text, renderer):
        # Labels of contours stand at any angle, and may touch.
        if text.get_visible() and text.get_text().strip() and text.get_rotation() % 90 == 0:
            box = text.get_window_extent(renderer).transformed(saved[-1].transFigure.inverted())
            boxes[text] = (text.get_text(), box)  # the last one, as layout draws the figure several times
        write(text, renderer)

    def draw(function, data):
        function(data, tmp_path / "plot.png")
        for text, box in boxes.values():
            assert min(*box.min, *(1 - box.max)) > -0.002, f"{text!r} is cut off"
        for (text, box), (other, other_box) in itertools.combinations(boxes.values(), 2):
            assert not box.overlaps(other_box), f"{text!r} overlaps {other!r}"
        return saved[-1], [text for text, _ in boxes.values()]

    monkeypatch.setattr(figures.Figure, "savefig", saves)
    monkeypatch.setattr(Text, "draw", writes)
    return draw


def test_answers_to_specifications_name_targets_and_forces(drawn):
    left, right = (
        {"name": f"{side} button", "area": (x, x + 0.02, 0.055, 0.075)} for side, x in (("left", 0.05), ("right", 0.23))
    )
    levels = [{"target": "left button", "acceleration": 2.0}, {"target": "right button", "displacement": 1e-6}]
    allowed = [{"relative_db": -3.0}, {"area": [0.14, 0.17, 0.05, 0.08], "relative_db": -12.0, "measure": "mean"}]
    tables = {"level": levels, "elsewhere": allowed, "frequency": 380.0, "guard": 0.05}
    scene = Scene.load("console", ["grid.modal_density=0.6"])
    scene = scene.with_tables(targets=[left, right], target={"area": left["area"]}, specification=tables)
    answer = specify(scene)
    figure, texts = drawn(draw_specified, answer)
    assert {"left button", "right button", "A1", "allowed"} <= set(texts)
    assert f"{answer.peaks['A1']:.3g} N, " in " ".join(texts)
    assert "peak acceleration over the least level wanted, 2 m/s² peak [dB]" in texts
    limits = {margin.requirement: margin.margin_db for margin in answer.margins}
    nearest = -3.0 if limits["elsewhere, worst point"] < limits["x 0.14 to 0.17, y 0.05 to 0.08 m, mean"] else -12.0
    assert answer.allowed_db == pytest.approx(nearest)
    lines = [line.get_ydata()[0] for axes in figure.axes for line in axes.lines if line.get_label() == "allowed"]
    assert lines == [answer.allowed_db]


def test_the_largest_responses_are_coloured_and_natural_frequencies_explained(drawn):
    """Of eight inputs at one point the five with the largest peaks; the other curves are grey and not in the legend."""
    made = scene_of(damping=20.0)
    forces = [(0.02 + 0.02 * index, 0.05) for index in range(8)]
    found = frf(made, forces, [(0.07, 0.11)], (50.0, 300.0))
    figure, texts = drawn(draw_frequency_response, found)
    peaks = np.abs(found.responses).max(axis=1)
    largest = set(np.argsort(-peaks)[:5])
    magnitude = figure.axes[0]
    assert "the 5 largest of 8" in texts
    assert "natural frequency" in texts
    shown = {line.get_color() for line in magnitude.lines if line.get_color() != GRID}
    assert (len(magnitude.lines), len(shown)) == (8, 5)
    assert {f"({20 + 20 * index}, 50) mm → (70, 110) mm" in texts for index in largest} == {True}


def test_one_input_has_panels_of_magnitude_and_phase_alone(drawn):
    """Localization and mean square velocity compare inputs. Long titles take two lines."""
    found = frf(
        scene_of(damping=20.0).replace("title", "A long title " * 12),
        [(0.02, 0.05)],
        [(0.07, 0.11), (0.1, 0.1)],
        (50.0, 300.0),
    )
    figure, texts = drawn(draw_frequency_response, found)
    assert [axes.get_ylabel() for axes in figure.axes] == ["mobility [(m/s)/N]", "phase [°]"]
    assert "(20, 50) mm → (70, 110) mm" in texts


def search_result(names=(), **search):
    """A result of a search for targets of these names."""
    made = scene_of(nodes=(11, 11), search=search).model_dump()
    if names:
        made |= {"targets": [one | {"name": name} for one, name in zip(TARGETS, names, strict=True)]}
        del made["target"]
    scene = Scene.model_validate(made)
    energy = {"plate": 1.0, "target": 0.5, **{f"target {name}": 0.4 for name in names}}
    field = np.ones((1, 11, 11)) * np.linspace(-1, 1, 11) * 1e-7
    best = Case(np.ones(3, complex), energy, field, np.zeros((0, 3)), frequency=np.full(3, 250.0))
    cases = {"best": best} | {f"best {name}": best for name in names[1:]}
    factors = {name: np.full(7, value) for name, value in (("equal", 0.2), ("single", 0.4), ("best", 0.5))}
    spectrum = {"frequency": np.linspace(100, 400, 7), **factors, "resonances": np.array([210.0])}
    history = {"evaluations": np.arange(1, 9), "best": np.linspace(0.1, 0.5, 8), "mean": np.linspace(0, 0.3, 8)}
    return result_of(scene, cases, times=np.array([0.01]), history=history, spectrum=spectrum)


def test_crosstalk_names_fit(drawn):
    _, words = drawn(draw_crosstalk, search_result(LONG))
    assert {words.count("40.0 %"), words.count("40.0 %\n+0.0 dB")} == {2}
    assert [text.replace("\n", " ") for text in words].count(LONG[0]) == 2


@pytest.mark.parametrize("draw", [draw_history, draw_spectrum])
def test_plots_of_the_first_of_several_targets_say_so(drawn, draw):
    assert f"search for target {LONG[0]}, the first of 2" in drawn(draw, search_result(LONG, **FREE))[1]
    words = " ".join(drawn(draw, search_result(method="exact"))[1])  # one drive, without a mean
    assert not any(part in words for part in ("search for", "mean"))


def test_small_localization_factors_fill_a_spectrum(drawn):
    result = search_result(**FREE)
    small = {name: 0.1 * result.spectrum[name] for name in ("equal", "single", "best")}
    cases = {"best": replace(result.cases["best"], energy={"plate": 1.0, "target": 0.05})}
    figure, texts = drawn(draw_spectrum, replace(result, cases=cases, spectrum=result.spectrum | small))
    assert {BOUND, "best single actuator", "equal drive", "natural frequency", "best of the search"} <= set(texts)
    axes = figure.axes[0]
    assert axes.get_ylim()[0] == 0
    assert 0.05 < axes.get_ylim()[1] < 0.06


# Fits ---------------------------------------------------------------------------------------------------------


def response_fit(random, count=5):
    frequencies = np.linspace(10, 100, 60)
    poles = 30 + 10 * np.arange(count)[:, None]
    exact = 1 / (poles**2 - frequencies**2 + 0.05j * poles**2)
    noisy = exact * (1 + 0.1 * random.normal(size=exact.shape))
    measured = MeasuredResponses("a.csv", frequencies, noisy, random.uniform(0.8, 1, exact.shape))
    row = SimpleNamespace(actuator=None, force_at=(0.1, 0.05), point=(0.02, 0.03), quantity="accelerance")
    scene = SimpleNamespace(title="", measurement=[row] * count, plate=SimpleNamespace(size=(0.2, 0.1)))
    return SimpleNamespace(scene=scene, measured=measured, responses=exact)


def test_fitted_responses(drawn, random):
    found = response_fit(random)
    axes = drawn(draw_response_fit, found)[0].axes
    assert len(axes) == 3 * MOST_RESPONSES
    for index in range(MOST_RESPONSES):
        measured, fitted = (line.get_ydata() for line in axes[index].lines)
        np.testing.assert_allclose(measured, np.abs(found.measured.responses[index]))
        np.testing.assert_allclose(fitted, np.abs(found.responses[index]))
        np.testing.assert_array_equal(axes[8 + index].lines[0].get_ydata(), found.measured.coherence[index])
    assert axes[0].get_ylabel() == "accelerance [(m/s²)/N]"
    assert axes[0].get_title() == "(100, 50) → (20, 30) mm"


def test_fitted_modes(drawn, random):
    shapes = random.normal(size=(5, 9)) + 1j * random.normal(size=(5, 9))
    mac = modal_assurance(shapes, 2j * shapes)
    np.testing.assert_allclose(np.diag(mac), 1)
    assert np.all(mac - np.eye(5) < 0.9)
    measured = SimpleNamespace(frequencies=np.linspace(20, 90, 5))
    errors = np.array([0.01, -0.02, 0.0, 0.005, 0.001])
    found = SimpleNamespace(scene=SimpleNamespace(title=""), numbers=np.arange(1, 6), errors=errors, measured=measured)
    bars, matrix, _ = drawn(partial(draw_mode_fit, mac=mac), found)[0].axes
    np.testing.assert_allclose([bar.get_height() for bar in bars.patches], 100 * errors)
    np.testing.assert_array_equal(matrix.images[0].get_array(), mac)
    assert len(drawn(draw_mode_fit, found)[0].axes) == 1


# Sweeps -----------------------------------------------------------------------------------------------------

LINE, PAIR = ["drive.frequency=log:200:300:12"], ["drive.frequency=300:200:4", "effects.damping.viscous=log:1:100:3"]
THREE = ["plate.thickness=4e-4:6e-4:2", "target.area[1]=0.05:0.15:2", "plate.density=log:900:1500:3"]


def random_sweep(vary, what="localize", samples=None):
    """A sweep with random values, some points refused and one value infinite."""
    panel = scene_of(damping=88.5, time_step=2e-4)
    plan = make_plan([parse_vary(panel, words) for words in vary], samples)
    begun = start_sweep(SweepRequest(panel, vary=plan, what=what, count=3, frequencies="100:200:3"), "cpu")
    values = {name: np.random.default_rng(1).random(output.shape) for name, output in begun.values.items()}
    status = np.ones(len(plan), dtype="i1")
    status[::5] = REFUSED
    for output in values.values():
        output[::5] = np.nan
    next(iter(values.values())).flat[-1] = np.inf
    return replace(begun, values=values, status=status, reasons=dict.fromkeys(range(0, len(plan), 5), "no"))


def count(picture, colour):
    """The number of pixels of a colour."""
    return (np.abs(picture - list(bytes.fromhex(colour[1:]))) < 3).all(axis=2).sum()


@pytest.mark.parametrize(
    ("what", "vary", "samples"),
    [
        ("check", LINE, None),
        ("localize", ["drive.frequency=290"], None),
        ("modes", [words.rpartition(":")[0] for words in THREE], 20),
        ("modes", PAIR, None),
        ("localize", ["drive.frequency=290", "effects.damping.viscous=0,1,5"], None),
        ("frf", THREE, None),
    ],
)
def test_sweeps_of_all_shapes(drawn, tmp_path, what, vary, samples):
    """Refused points are grey, or ticks."""
    figure, _ = drawn(draw_sweep, random_sweep(vary, what, samples))
    picture = pixels(tmp_path / "plot.png")
    assert min(picture.shape[:2]) > 300
    maps = len(vary) == 2
    assert count(picture, REFUSED_GREY if maps else REFUSED_TICK) > (100 if maps else 2)
    if (what, vary) == ("modes", PAIR):
        draw_sweep(random_sweep(vary, what, samples), tmp_path / "grey.png", colormap="gray")
        assert np.ptp(pixels(tmp_path / "grey.png"), axis=2).max() < 12 < np.ptp(picture, axis=2).max()
    if (what, vary) == ("check", LINE):
        assert [axes.get_ylabel() for axes in figure.axes] == ["time step [s]", "resolution"]
        assert figure.axes[-1].get_xlabel() == "drive frequency [Hz]"


@pytest.mark.parametrize("samples", [None, 5])
def test_coinciding_curves_can_all_be_seen(tmp_path, samples):
    """Every colour of the legend is in the panels, though best and bound coincide."""
    sweep = random_sweep(["plate.thickness=4e-4:6e-4:6"], "localize", samples)
    sweep.values.update({name: np.linspace(0.2, 0.7, len(sweep.plan)) for name in sweep.values})
    sweep.values["single"], sweep.values["equal"] = (1 - sweep.values[name] for name in ("best", "bound"))
    draw_sweep(replace(sweep, status=np.ones_like(sweep.status)), tmp_path / "a.png")
    picture = pixels(tmp_path / "a.png")
    legend = picture[:, -350:]
    assert all(count(picture, colour) > count(legend, colour) + 40 for colour in LINE_COLOURS[:4])


def test_a_map_of_one_value_says_which(drawn):
    sweep = random_sweep(PAIR, "localize", None)
    sweep.values.update({name: np.linspace(0.2, 0.7, len(sweep.plan)) for name in sweep.values})
    sweep.values["equal"] = np.full(len(sweep.plan), 0.25)
    figure, _ = drawn(draw_sweep, replace(sweep, status=np.ones_like(sweep.status)))
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert [text for text in texts if "everywhere" in text] == ["0.25 everywhere"]


def test_cell_edges_lie_halfway_between_values():
    np.testing.assert_allclose(cell_edges(np.array([1.0, 2.0, 4.0]), False), [0.5, 1.5, 3.0, 5.0])
    np.testing.assert_allclose(cell_edges(np.array([1.0, 100.0]), True), [0.1, 10.0, 1000.0])
    low, high = cell_edges(np.array([0.0]), False)
    assert low < 0 < high


def test_threads_draw_in_their_own_styles(tmp_path):
    """Matplotlib's style is that of all threads, and is restored."""
    before, sizes = dict(matplotlib.rcParams), [5.0, 7.0, 9.0, 11.0] * 5

    def draw(index):
        with figure(tmp_path / f"{index}.png", (3, 2), font_size=sizes[index]) as drawn:
            time.sleep(0.01)
            return drawn.subplots().text(0.5, 0.5, "text").get_fontsize()

    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(draw, range(len(sizes)))) == sizes
    assert dict(matplotlib.rcParams) == before
