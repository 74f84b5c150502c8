"""What scenes and results show in a notebook: well-formed HTML with all they should say, and their pictures."""

import base64
import io
import re
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from warp_plate import view, viz
from warp_plate.result import Case, Result, save_result
from warp_plate.scene import Scene, SceneError, preset_names
from warp_plate.viz import notebook as html
from warp_plate.viz.plots.scene_plan import LENGTH, MARGIN

NEEDS_VTK = "PyVista is not installed: pip install 'warp-plate[viz]'"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def result():
    """As a search leaves it, on a small grid."""
    scene = Scene.load("paper")
    x = np.linspace(0, np.pi, 27)
    field = np.stack([1e-7 * np.outer(np.sin(n * x), np.sin(2 * x)) for n in (1, 2)]).astype(np.float32)
    drives = {"best": [1, 0.5j, 0.25, 0], "equal": [1, 1, 1, 1]}
    cases = {
        name: Case(np.array(drive, complex), {"plate": 4.0, "target": 1.0 + len(name) % 2}, field, np.zeros((0, 0)))
        for name, drive in drives.items()
    }
    return Result(
        command="localize",
        source="paper",
        scene=scene,
        device="cpu <0>",
        seed=0,
        effects=("damping",),
        cases=cases,
        times=np.array([0.01, 0.02]),
        trace_times=np.zeros(0),
        seconds={"solve": 1.5},
        node_steps=2_000_000,
        bound=0.6867,
        bound_kind="attained within limits",
        history={"evaluations": np.arange(5), "best": np.linspace(0.3, 0.6, 5), "mean": np.linspace(0.2, 0.5, 5)},
        accuracy={"estimate": {"line": "localization factor 0.68 ± 0.04"}},
    )


def rows_of(shown):
    """The texts of all lines of all tables."""
    return [["".join(cell.itertext()) for cell in line] for line in ElementTree.fromstring(shown).iter("tr")]


def words_of(shown):
    return "\n".join(ElementTree.fromstring(shown).itertext())


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_shows_itself(name):
    scene = Scene.load(name)
    shown = html.scene_html(scene)
    rows = dict(row[:2] for row in rows_of(shown))
    assert ElementTree.fromstring(shown).find("strong").text == scene.title
    assert rows["drive"] == f"{scene.drive.frequency:g} Hz"
    assert {actuator.name for actuator in scene.actuators} <= set(rows)
    effects = rows["effects"].split(", ")
    assert effects == [name.replace("_", " ") for name, value in scene.effects if value]


def test_the_plan_shows_where_things_are(scene):
    made = scene(
        size=(0.3, 0.2),
        edges=("clamped", {"translation": 1e3}, "free", "supported"),
        effects={
            "layers": [{"area": (0.1, 0.2, 0, 0.1), "thickness": 1e-4, "young_modulus": 1e9, "density": 1.0}],
            "oscillators": [{"area": (0.05, 0.06, 0.1, 0.2), "stiffness": 3.0}],
        },
    )
    svg = ElementTree.fromstring(html.scene_html(made)).find(f".//{SVG}svg")
    boxes = {}
    for box in svg.iter(f"{SVG}rect"):
        x, y, width, height = (float(box.get(key)) for key in ("x", "y", "width", "height"))
        scale = LENGTH / 0.3
        left, top = (x - MARGIN) / scale, 0.2 - (y - MARGIN) / scale
        words = box.find(f"{SVG}title").text.split(":")[0]
        boxes[words] = (left, left + width / scale, top - height / scale, top)
    expected = {
        "plate": (0, 0.3, 0, 0.2),
        "layer": (0.1, 0.2, 0, 0.1),
        "target": made.target.area,
        "oscillator": (0.05, 0.06, 0.1, 0.2),
        **{f"actuator {actuator.name}": actuator.area for actuator in made.actuators},
    }
    assert boxes.keys() == expected.keys()
    for words, area in expected.items():
        assert boxes[words] == pytest.approx(area, abs=1e-5), words
    lines = {line.find(f"{SVG}title").text: line for line in svg.iter(f"{SVG}line")}
    assert list(lines) == ["left edge: clamped", "bottom edge: on springs", "right edge: free", "top edge: supported"]
    left, _, _, top = lines.values()
    assert [float(left.get(end)) for end in ("x1", "x2")] == [MARGIN, MARGIN]
    assert [float(top.get(end)) for end in ("y1", "y2")] == [MARGIN, MARGIN]


def test_names_cannot_break_out_of_the_page(scene):
    made = scene()
    wild = made.actuators[0].model_copy(update={"name": "<script>alert('&')</script>"})
    made = made.model_copy(update={"actuators": (wild,), "title": 'a < b & "c" > d'})
    shown = html.scene_html(made)
    assert "<script" not in shown
    assert ElementTree.fromstring(shown).find("strong").text == made.title
    assert [wild.name, "0.03 … 0.06, 0.04 … 0.07", "1", "0"] in rows_of(shown)


def test_a_scene_that_asks_for_an_accuracy_has_no_grid_to_show():
    made = Scene.load("paper").model_dump(exclude_none=True, exclude={"grid"})
    shown = html.scene_html(Scene.model_validate({**made, "grid": {"accuracy": 0.01}}))
    assert ["grid", "for a relative error of 1 %"] in rows_of(shown)


def test_a_result_shows_its_tables_and_its_picture(result):
    if (problem := viz.missing()) is not None:
        pytest.skip(problem)
    from PIL import Image

    shown = html.result_html(result)
    rows = rows_of(shown)
    assert rows[:4] == [
        ["drive", "localization factor"],
        ["equal drive", "50.00 %"],
        ["best drive found", "25.00 %"],
        ["bound of the drives that may be chosen", "68.67 %"],
    ]
    assert ["upper left", "0.5000", "4.7124", "1.5000"] in rows
    words = words_of(shown)
    assert "localization factor 0.68 ± 0.04" in words
    assert "2e+06 node-steps in 1.50 s on cpu <0>." in words
    (image,) = ElementTree.fromstring(shown).iter("img")
    head, data = image.get("src").split(",")
    assert head == "data:image/png;base64"
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"), dtype=int)
    # Red hills, blue dales, a green target: it is not an empty page.
    for strong, weak in ((0, 2), (2, 0), (1, 0)):
        assert (picture[..., strong] - picture[..., weak] > 60).sum() > 100
    assert "best drive found" in image.get("alt")


def test_without_anything_to_draw_with_a_result_shows_tables_and_says_what_to_install(result, monkeypatch):
    monkeypatch.setattr(html, "missing", lambda: "nothing draws here: install it")
    monkeypatch.setattr(html, "missing_plots", lambda: "no curves either")
    shown = html.result_html(result)
    assert not list(ElementTree.fromstring(shown).iter("img"))
    assert ["equal drive", "50.00 %"] in rows_of(shown)
    assert "no curves either" in words_of(shown)
    simulation = replace(result, cases={"drive": result.cases["best"]}, history={}, bound=None, interrupted=True)
    shown = html.result_html(simulation)
    assert "nothing draws here: install it" in words_of(shown)
    assert "Interrupted by Ctrl-C" in words_of(shown)
    assert [row[0] for row in rows_of(shown)][:2] == ["drive", "given drive"]
    shown = html.result_html(replace(simulation, times=np.zeros(0)))
    assert "the result holds nothing to draw" in words_of(shown)


def test_where_the_plate_cannot_be_drawn_the_search_is(result, monkeypatch):
    if (problem := viz.availability.missing_plots()) is not None:
        pytest.skip(problem)
    monkeypatch.setattr(html, "missing", lambda: "nothing draws here")
    drawn, problem = html.picture(result)
    assert (drawn[:4], problem) == (b"\x89PNG", None)


def test_importing_what_shows_itself_imports_no_graphics():
    code = (
        "import sys; from warp_plate.scene import Scene; Scene.load('paper')._repr_html_(); "
        "import warp_plate.viz.notebook;"
        "print(sorted({'pyvista', 'vtkmodules', 'matplotlib', 'PIL', 'IPython', 'warp'} & set(sys.modules)))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_the_viewer_plays_inline(result):
    pytest.importorskip("pyvista", reason=NEEDS_VTK)
    shown = view(result, "best", "equal", frames=8, quantity="velocity", device="cpu", height=500)
    frame = ElementTree.fromstring(shown._repr_html_())
    assert (frame.tag, frame.get("sandbox"), frame.get("height")) == ("iframe", "allow-scripts", "500")
    page = frame.get("srcdoc")
    assert page == shown.html
    assert page.startswith("<!DOCTYPE html>")
    assert "best drive found, t = " in page
    assert "equal drive, t = " in page
    assert "velocity" in page
    # Nothing is fetched.
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", page)


def test_the_viewer_shows_the_best_drive_when_nothing_is_said(result):
    pytest.importorskip("pyvista", reason=NEEDS_VTK)
    page = view(result, frames=4, device="cpu").html
    assert "best drive found" in page
    assert "equal drive" not in page


@pytest.mark.parametrize(
    ("cases", "options", "line"),
    [
        (("worst",), {}, "case = 'worst': must be one of best, equal"),
        ((), {"quantity": "colour"}, "quantity = 'colour': must be one of displacement, velocity"),
        ((), {"span": (0.2, 0.3)}, "must lie inside the run, which goes from 0 to 0.1 s"),
    ],
)
def test_what_the_viewer_cannot_show_is_told_in_one_line(result, cases, options, line):
    pytest.importorskip("pyvista", reason=NEEDS_VTK)
    with pytest.raises(SceneError, match=re.escape(line)):
        view(result, *cases, device="cpu", **options)


def test_a_notebook_shows_all_of_it(result, tmp_path):
    """In a kernel of its own, as a person's notebook runs: a scene, a result, the viewer."""
    nbclient = pytest.importorskip("nbclient", reason="no Jupyter here: pip install nbclient ipykernel")
    pytest.importorskip("ipykernel", reason="no Jupyter here: pip install nbclient ipykernel")
    from nbformat import v4

    path = save_result(result, tmp_path / "run.h5")
    cells = [
        "from warp_plate import Scene, load_result, view\nScene.load('paper')",
        f"result = load_result({str(path)!r})\nresult",
        "view(result, frames=4, device='cpu')",
    ]
    notebook = v4.new_notebook(cells=[v4.new_code_cell(cell) for cell in cells])
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    shown = [cell.outputs[-1].data["text/html"] for cell in notebook.cells]
    assert "<svg" in shown[0]
    assert "<img" in shown[1] or viz.missing() is not None
    assert "<iframe" in shown[2]
