"""HTML of scenes and results, and the player, in notebooks."""

import base64
import io
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import result_of, start_program

from warp_plate import view
from warp_plate.result import Case, save_result
from warp_plate.scene import Scene, SceneError
from warp_plate.viz import notebook
from warp_plate.viz.notebook import result_html, scene_html

NEEDS_VTK = "PyVista is not installed: pip install 'warp-plate[viz]'"


@pytest.fixture
def result():
    """A result like that of a search, on a small grid."""
    x = np.linspace(0, np.pi, 27)
    field = np.stack([1e-7 * np.outer(np.sin(n * x), np.sin(2 * x)) for n in (1, 2)]).astype(np.float32)
    phasors = {"best": [1, 0.5j, 0.25, 0], "equal": [1, 1, 1, 1]}
    cases = {
        name: Case(np.array(drive, complex), {"plate": 4.0, "target": 1.0 + len(name) % 2}, field, np.zeros((0, 0)))
        for name, drive in phasors.items()
    }
    return result_of(
        Scene.load("paper"), cases, device="cpu <0>", times=np.array([0.01, 0.02]), seconds={"solve": 1.5},
        node_steps=2_000_000, bound=0.6867, bound_kind="attained within limits",
        history={"evaluations": np.arange(5), "best": np.linspace(0.3, 0.6, 5), "mean": np.linspace(0.2, 0.5, 5)},
        accuracy={"estimate": {"line": "localization factor 0.68 ± 0.04"}},
    )  # fmt: skip


def rows_of(html):
    """Texts of all rows of all tables."""
    return [["".join(cell.itertext()) for cell in line] for line in ElementTree.fromstring(html).iter("tr")]


def picture_of(html):
    """The embedded PNG as integers."""
    from PIL import Image

    (image,) = ElementTree.fromstring(html).iter("img")
    head, data = image.get("src").split(",")
    assert head == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"), dtype=int)


def test_scenes_show_their_settings(monkeypatch):
    monkeypatch.setattr(notebook, "missing_plots", lambda: "install it")
    made = Scene.load("touch-panel").model_dump(exclude_none=True)
    scene = Scene.model_validate({**made, "grid": {"accuracy": 0.01}})
    wild = scene.actuators[0].model_copy(update={"name": "<script>alert('&')</script>", "area": (0.03, 0.06, 0, 0.07)})
    scene = scene.model_copy(update={"actuators": (wild,), "title": 'a < b & "c" > d'})
    html = scene_html(scene)
    rows = dict(row[:2] for row in rows_of(html))
    assert "<script" not in html
    assert "install it" in html
    assert ElementTree.fromstring(html).find("strong").text == scene.title
    assert rows[wild.name] == "0.03 … 0.06, 0 … 0.07"
    assert rows["drive"] == f"{scene.drive.frequency:g} Hz"
    assert rows["grid"] == "for a relative error of 1 %"
    assert rows["effects"].split(", ") == [name.replace("_", " ") for name, value in scene.effects if value]


def test_the_layout_is_drawn(scene):
    """Colours stand where the parts of the scene are: blue layers, orange oscillators, green targets."""
    pytest.importorskip("matplotlib", reason=NEEDS_VTK)
    areas = {"layers": (0.12, 0.18, 0.12, 0.18), "oscillators": (0.13, 0.17, 0.02, 0.06)}
    made = scene(
        edges=("clamped", {"translation": 1e3}, "free", "supported"),
        effects={
            "layers": [{"area": areas["layers"], "thickness": 1e-4, "young_modulus": 1e9, "density": 1.0}],
            "oscillators": [{"area": areas["oscillators"], "stiffness": 3.0}],
        },
    )
    assert ["edges", "clamped: left; supported: top; on springs: bottom; free: right"] in rows_of(scene_html(made))
    picture = picture_of(scene_html(made))
    red, green, blue = np.moveaxis(picture, -1, 0)
    drawn = {"green": (green - red > 60), "purple": (blue - green > 15) & (red > green), "orange": (red - blue > 150)}
    for mask in drawn.values():
        assert mask.sum() > 30
    # y points up: the target is at the lower left, the layer at the upper right.
    middle = {name: np.argwhere(mask[: int(0.8 * len(mask))]).mean(axis=0) for name, mask in drawn.items()}
    assert middle["green"][0] > middle["purple"][0]
    assert middle["green"][1] < middle["purple"][1]


def test_results_show_tables_and_a_picture(drawing, result):
    html = result_html(result)
    rows = rows_of(html)
    assert rows[1:3] == [["equal drive", "50.00 %"], ["best drive found", "25.00 %"]]
    assert rows[3][1] == "68.67 %"
    assert ["upper left", "0.5000", "4.7124", "1.5000"] in rows
    text = "\n".join(ElementTree.fromstring(html).itertext())
    assert "localization factor 0.68 ± 0.04" in text
    assert "2e+06 node-steps in 1.50 s on cpu <0>." in text
    picture = picture_of(html)
    # Red crests, blue troughs, a green target.
    for strong, weak in ((0, 2), (2, 0), (1, 0)):
        assert (picture[..., strong] - picture[..., weak] > 60).sum() > 100


def test_without_drawing_libraries_tables_remain(result, monkeypatch):
    monkeypatch.setattr(notebook, "missing_renderer", lambda: "install a renderer")
    assert picture_of(result_html(result)).std() > 0  # the history
    monkeypatch.setattr(notebook, "missing_plots", lambda: "install Matplotlib")
    html = result_html(result)
    assert ["equal drive", "50.00 %"] in rows_of(html)
    assert "install Matplotlib" in html
    simulation = replace(result, cases={"drive": result.cases["best"]}, history={}, bound=None, interrupted=True)
    html = result_html(simulation)
    assert "install a renderer" in html
    assert "Interrupted" in html
    assert [row[0] for row in rows_of(html)][:2] == ["drive", "given drive"]
    assert "nothing to draw" in result_html(replace(simulation, times=np.zeros(0)))


def test_the_player_holds_all_that_it_shows(result):
    pytest.importorskip("pyvista", reason=NEEDS_VTK)
    shown = view(result, "best", "equal", frames=8, quantity="velocity", device="cpu", height=500)
    frame = ElementTree.fromstring(shown._repr_html_())
    assert (frame.tag, frame.get("sandbox"), frame.get("height")) == ("iframe", "allow-scripts", "500")
    assert frame.get("srcdoc") == shown.html
    for text in ("best drive found, t = ", "equal drive, t = ", "velocity"):
        assert text in shown.html
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", shown.html)
    assert "equal drive" not in view(result, frames=4, device="cpu").html
    for case, quantity in (("worst", "phase"), ("best", "colour")):
        with pytest.raises(SceneError, match=r"= '(worst|colour)': must be one of"):
            view(result, case, quantity=quantity, device="cpu")


def test_scenes_and_results_show_themselves_in_ipython(result, tmp_path, monkeypatch):
    """Importing the package registers its formatters, and so does the extension."""
    pytest.importorskip("IPython", reason="IPython is missing: pip install ipython")
    path = save_result(result, tmp_path / "run.h5")
    code = f"""
from warp_plate import Scene, load_result
html = get_ipython().display_formatter.formatters["text/html"]
for value in (Scene.load("paper"), load_result({str(path)!r})):
    print(html.lookup(value)(value))
html.pop(Scene)
before = Scene in html
get_ipython().run_line_magic("load_ext", "warp_plate")
print(before, Scene in html)
"""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    scene, shown, last = start_program("-m", "IPython", "-c", code).communicate()[0].splitlines()
    assert ["drive", "290 Hz"] in rows_of(scene)
    assert ["best drive found", "25.00 %"] in rows_of(shown)
    assert last == "False True"
