"""Pictures of whole results, what is said where nothing can be drawn, and scenes and results in notebooks."""

import base64
import io
import re
import sys
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

import warp_plate
from support.commands import start_program
from support.pictures import pixels
from support.results import result_of
from warp_plate import view, viz
from warp_plate.notebook import result_html, scene_html
from warp_plate.result.case import Case
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.viz import availability
from warp_plate.viz.plots.plan import place_names
from warp_plate.viz.plots.search import plot_history

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

TIMES = (0.0464, 0.0696)
SHARES = {"best": 0.6853, "equal": 0.25, "single": 0.6367}


@pytest.fixture
def paper_run():
    """A result like that of ``localize paper``; amplitudes of the cases differ by factors of ten."""
    x, cases = np.linspace(0, np.pi, 27), {}
    for rank, (name, share) in enumerate(SHARES.items()):
        waves = [np.outer(np.sin((3 + step) * x), np.sin((rank + 2) * x)) for step in range(len(TIMES))]
        energy = {"target": share * 1e-9, "plate": 1e-9}
        cases[name] = Case(np.ones(4, complex), energy, 2e-7 * 10.0**-rank * np.stack(waves), np.zeros((0, 3)))
    cases["best"] = replace(cases["best"], phasors=np.array([1, 0.5j, 0.25, 0]))
    best = np.maximum.accumulate(0.68 - 0.3 * np.exp(-np.arange(80) / 9) * (1 + np.sin(np.arange(80))) / 2)
    history = {"evaluations": np.arange(20, 1601, 20), "best": best, "mean": best - 0.1}
    return result_of(
        Scene.load("paper"), cases, source="paper", device="cpu <0>", times=np.array(TIMES),
        seconds={"compile": 0.0, "solve": 1.5}, node_steps=2_000_000, bound=0.6867, bound_kind="attained within limits",
        history=history,
        accuracy={"estimate": {"line": "localization factor 0.68 ± 0.04"}},
    )  # fmt: skip


@pytest.fixture
def new_trial():
    """Repeat the trial drawing in this test and in the next."""
    availability.working_window.cache_clear()
    yield
    availability.working_window.cache_clear()


def test_all_pictures_that_a_result_holds(paper_run, drawing, tmp_path):
    """Surfaces show every case and time; the history has the width of a column of the paper."""
    written, problem = viz.draw_all(paper_run, tmp_path / "paper")
    assert problem is None
    assert written == [tmp_path / "paper-history.png", tmp_path / "paper-surfaces.png"]
    assert sorted(tmp_path.iterdir()) == written
    history, picture = map(pixels, written)
    assert history.shape[1] == 1600
    assert picture.shape[1] == pytest.approx(1600, abs=50)
    red = picture[..., 0] - picture[..., 2]
    for row in np.split(np.arange(len(picture)), 3):
        for left in (0, 710):
            panel = np.ix_(row, np.arange(left, left + 710))
            # Each row has limits of its own, so that both colours show in spite of amplitudes that differ.
            assert (red[panel] > 100).sum() > 1000
            assert (red[panel] < -100).sum() > 1000
            assert (picture[panel][:70].max(axis=-1) < 100).sum() > 500
            # Nothing is cut off at the sides.
            assert (picture[panel][70:, :5] > 250).all()
    assert (picture[[0, 1, 2, -3, -2, -1]] > 250).all()


def test_a_time_when_all_plates_are_at_rest_is_not_drawn(paper_run, drawing, tmp_path):
    scale = np.array([0.05, 1.0])[:, None, None]
    cases = {name: replace(case, displacement=scale * case.displacement) for name, case in paper_run.cases.items()}
    resting = replace(paper_run, cases=cases, scene=paper_run.scene.replace("record.times", ()))
    viz.draw_surfaces(resting, tmp_path / "one.png")
    assert pixels(tmp_path / "one.png").shape[1] == pytest.approx(910, abs=30)
    cases["best"] = paper_run.cases["best"]
    viz.draw_surfaces(replace(resting, cases=cases), tmp_path / "two.png")
    assert pixels(tmp_path / "two.png").shape[1] == pytest.approx(1600, abs=50)


def test_drives_that_are_alike_are_drawn_once(paper_run, drawing, tmp_path):
    case = paper_run.cases["best"]
    other = replace(case, displacement=(1 + 1e-9) * case.displacement)
    viz.draw_surfaces(replace(paper_run, cases={"equal": case, "best": other}), tmp_path / "one.png")
    one = pixels(tmp_path / "one.png").shape[0]
    further = replace(case, displacement=1.01 * case.displacement)
    viz.draw_surfaces(replace(paper_run, cases={"equal": case, "best": further}), tmp_path / "two.png")
    assert pixels(tmp_path / "two.png").shape[0] == pytest.approx(2 * one, abs=30)


def test_the_best_never_falls_and_infinite_means_are_gaps(paper_run):
    """Beside the bound, the drives that need no search and the published factor, of results that have them."""
    from matplotlib.figure import Figure

    def lines(**changes):
        plot_history(axes := Figure().add_subplot(), replace(paper_run, history=history, **changes))
        return {line.get_label(): line.get_ydata() for line in axes.get_lines()}

    history = {"best": np.array([0.3, 0.5, 0.4]), "mean": np.array([0.1, -np.inf, 0.2])}
    only = {"best": paper_run.cases["best"]}
    drawn, without = lines(), lines(source="panel.toml", bound=None, cases=only)
    np.testing.assert_allclose(drawn["best so far: 0.5000"], [0.3, 0.5, 0.5])
    np.testing.assert_allclose(drawn["mean"], [0.1, np.nan, 0.2])
    named = {"bound": 0.6867, "published": 0.72, "single actuator": 0.6367, "equal drive": 0.25}
    for name, factor in named.items():
        assert drawn[f"{name}: {factor:.4f}"][0] == pytest.approx(factor)
    assert set(without) == {"best so far: 0.5000", "mean"}
    single = replace(paper_run.cases["single"], phasors=np.array([0, 1, 0, 0j]))
    assert "single actuator, upper left: 0.6367" in lines(cases={"single": single})


def test_missing_data_and_folders_are_reported(paper_run, drawing, tmp_path):
    empty = replace(paper_run, history={}, times=np.zeros(0))
    assert viz.draw_all(empty, tmp_path / "empty") == ([], None)
    for draw, match in ((viz.draw_surfaces, "no displacement"), (viz.draw_history, "no history")):
        with pytest.raises(ValueError, match=match):
            draw(empty, tmp_path / "empty.png")
    written, problem = viz.draw_all(paper_run, tmp_path / "no such folder" / "paper")
    assert written == []
    assert problem.count("No such file") == 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the packages are named for Linux")
@pytest.mark.parametrize(
    ("vtk", "reason"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "apt-get install libegl1 libgl1-mesa-dri"),
        ("raise ImportError('libX.so.1: cannot open')", "libX.so.1"),
    ],
)
def test_if_vtk_fails_only_surfaces_are_missing(paper_run, monkeypatch, new_trial, tmp_path, vtk, reason):
    """A broken VTK is put before the real one for the trial drawing in a process of its own."""
    (tmp_path / "vtkmodules").mkdir()
    (tmp_path / "vtkmodules" / "__init__.py").write_text(vtk, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    written, problem = viz.draw_all(paper_run, tmp_path / "paper")
    assert written == [tmp_path / "paper-history.png"]
    assert reason in problem
    assert "\n" not in problem
    with pytest.raises(viz.DrawingUnavailable, match=reason):
        viz.draw_surfaces(paper_run, tmp_path / "paper.png")
    assert reason in result_html(replace(paper_run, history={}))
    assert picture_of(result_html(paper_run)).std() > 0  # the history
    (tmp_path / "vtkmodules" / "__init__.py").write_text("import time; time.sleep(60)", encoding="utf-8")
    assert availability.try_window(None, timeout=0.1) == (False, "no answer in 0.1 s")


def test_missing_packages_are_named(paper_run, monkeypatch, new_trial, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    written, problem = viz.draw_all(paper_run, tmp_path / "paper")
    assert written == []
    assert all(words in problem for words in ("pyvista", "matplotlib", "pip install 'warp-plate[viz]'"))
    assert "drawing needs matplotlib" in scene_html(paper_run.scene)


def test_off_screen_drawing_is_quiet_and_loads_libraries_when_needed(drawing):
    code = """
import sys
import warp_plate.viz, warp_plate.viz.pictures
print({"pyvista", "vtkmodules", "matplotlib", "PIL", "warp", "IPython"} & set(sys.modules))
warp_plate.viz.availability.set_up_renderer()
exec(warp_plate.viz.availability.TRIAL)
"""
    out, err = start_program("-c", code).communicate()
    assert (out.split()[0], out.split()[-1], err) == ("set()", "True", "")


def text_of(html):
    return "\n".join(ElementTree.fromstring(html).itertext())


def picture_of(html):
    """The embedded PNG as integers."""
    (image,) = ElementTree.fromstring(html).iter("img")
    return pixels(io.BytesIO(base64.b64decode(image.get("src").removeprefix("data:image/png;base64,"))))


def test_the_layout_is_drawn(scene):
    """Colours stand where the parts of the scene are: blue layers, orange oscillators, green targets."""
    layer = {"area": (0.12, 0.18, 0.12, 0.18), "thickness": 1e-4, "young_modulus": 1e9, "density": 1.0}
    effects = {"layers": [layer], "oscillators": [{"area": (0.13, 0.17, 0.02, 0.06), "stiffness": 3.0}]}
    made = scene(edges=("clamped", {"translation": 1e3}, "free", "supported"), effects=effects)
    html = scene_html(made.with_tables(title='</pre><script>alert("&")'))
    assert made.to_toml().partition("\n")[2] in text_of(html)
    assert "<script" not in html
    picture = picture_of(html)
    red, green, blue = np.moveaxis(picture, -1, 0)
    drawn = {"green": (green - red > 60), "purple": (blue - green > 15) & (red > green), "orange": (red - blue > 150)}
    assert all(mask.sum() > 30 for mask in drawn.values())
    # y points up: the target is at the lower left, the layer at the upper right.
    middle = {name: np.argwhere(mask[: int(0.8 * len(mask))]).mean(axis=0) for name, mask in drawn.items()}
    assert middle["green"][0] > middle["purple"][0]
    assert middle["green"][1] < middle["purple"][1]


def test_actuators_are_named_where_all_names_fit(scene):
    """Names stand inside the plate, beside their own patches, and cover nothing; too long ones are left out."""
    patches = np.array([[[0.0, 0.02], [0.0, 0.02]], [[0.18, 0.2], [0.18, 0.2]]])
    plate, letter = np.array([[0.0, 0.2], [0.0, 0.2]]), 0.004
    middles = place_names(["lower left", "8"], patches, plate, letter)
    np.testing.assert_allclose(middles, [(0.02, 0.024), (0.19, 0.176)])
    assert not place_names(["a" * 51, "8"], patches, plate, letter).size
    assert not place_names(["abc"] * 5, np.array([[[0.09, 0.11], [0.09, 0.11]]] * 5), plate, letter).size
    # Where its own place is taken, a name stands on another side.
    near = np.array([[[0.08, 0.09], [0.05, 0.06]], [[0.085, 0.095], [0.062, 0.072]]])
    middles = place_names(["first", "next"], near, plate, letter)
    np.testing.assert_allclose(middles, [(0.085, 0.046), (0.09, 0.076)])
    made, dark = scene(), []
    for length in (1, 5):
        rows = [{**each.model_dump(), "name": f"{index}" * length} for index, each in enumerate(made.actuators)]
        dark.append((picture_of(scene_html(made.with_tables(actuators=rows))).max(axis=-1) < 100).sum())
    assert dark[1] > dark[0]


def test_results_show_tables_and_a_picture(drawing, paper_run, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as kernels of notebooks do; \x1b is not XML
    html = result_html(paper_run)
    text = " ".join(text_of(html).split())
    for shown in ("equal drive 25.00 % ", "best drive found 68.53 % ", "upper left 0.5000 4.7124 1.5000 ", " ± 0.04"):
        assert shown in text
    # Red crests, blue troughs, a green target.
    picture = picture_of(html)
    for strong, weak in ((0, 2), (2, 0), (1, 0)):
        assert (picture[..., strong] - picture[..., weak] > 60).sum() > 100
    simulation = replace(
        paper_run, command="simulate", cases={"drive": paper_run.cases["best"]}, history={}, bound=None
    )
    text = text_of(result_html(replace(simulation, interrupted=True, times=np.zeros(0))))
    assert all(words in text for words in ("given drive", "Interrupted", "nothing to draw"))


def test_the_player_holds_all_that_it_shows(paper_run):
    shown = view(paper_run, "best", "equal", frames=8, quantity="velocity", device="cpu", height=500)
    frame = ElementTree.fromstring(shown._repr_html_())
    assert (frame.tag, frame.get("sandbox"), frame.get("height")) == ("iframe", "allow-scripts", "500")
    assert frame.get("srcdoc") == shown.html
    for text in ("best drive found, t = ", "equal drive, t = ", "velocity"):
        assert text in shown.html
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", shown.html)
    assert "equal drive" not in view(paper_run, frames=4, device="cpu").html
    for case, quantity in (("worst", "phase"), ("best", "colour")):
        with pytest.raises(SceneError, match=r"= '(worst|colour)': must be one of"):
            view(paper_run, case, quantity=quantity, device="cpu")


def test_scenes_and_results_have_formatters_in_ipython():
    found = {}
    html = SimpleNamespace(for_type_by_name=lambda module, name, function: found.update({f"{module}.{name}": function}))
    display_formatter = SimpleNamespace(formatters={"text/html": html})
    warp_plate.load_ipython_extension(SimpleNamespace(display_formatter=display_formatter))
    assert found == {"warp_plate.scene.model.Scene": scene_html, "warp_plate.result.model.Result": result_html}


@pytest.mark.slow
def test_importing_the_package_registers_its_formatters(tmp_path, monkeypatch):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    code = 'from warp_plate import Scene\nprint(Scene in get_ipython().display_formatter.formatters["text/html"])'
    assert start_program("-m", "IPython", "-c", code).communicate()[0] == "True\n"
