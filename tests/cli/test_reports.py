"""Reports of fits and verifications: one page that holds all, with every name escaped."""

from html.parser import HTMLParser

import numpy as np

from support.commands import error_of, output_of
from warp_plate import Scene, load_result
from warp_plate.modal.modes import solve_modes

TITLE = "<script>alert('x')</script> & \"panel\""


class Page(HTMLParser):
    """The tags of a page with their attributes, and its text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text = [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.text += data


def read(path):
    page = Page(path.read_text(encoding="utf-8"))
    assert not [tag for tag, _ in page.tags if tag in ("script", "link", "iframe", "object")]
    sources = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    assert len(sources) == 1
    assert sources[0].startswith("data:image/png;base64,iVBOR")
    assert not [attributes for _, attributes in page.tags if "href" in attributes or "style" in attributes]
    assert TITLE in page.text
    return page


def test_report_of_a_fit(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    changes = {"title": TITLE, "fit": {"free": {"plate.young_modulus": [8e8, 1.2e9]}, "starts": 1}}
    scene = Scene.from_tables({**Scene.load("paper").model_dump(exclude_unset=True), **changes})
    (tmp_path / "panel.toml").write_text(scene.to_toml())
    frequencies = solve_modes(scene, 0.0, count=3).frequencies[:3] * 1.02
    (tmp_path / "bench.csv").write_text("frequency\n" + "\n".join(map(str, frequencies.tolist())))
    printed = output_of(command("fit", "panel.toml", "--data", "bench.csv", "--no-pictures", "--report", "fit.html"))
    assert "wrote fit.html" in printed
    page = read(tmp_path / "fit.html")
    assert "plate.young_modulus" in page.text
    assert "1.0404e+09" in page.text
    assert "[plate]" in page.text  # the fitted scene
    (tmp_path / "fit.html").write_text("mine")
    again = command("fit", "panel.toml", "--data", "bench.csv", "--no-pictures", "--report", "fit.html")
    assert "fit.html: was written by another command" in error_of(again)
    assert "--report fit.txt: must end in .html" in error_of(command("fit", "panel.toml", "--data", "bench.csv",
                                                                  "--report", "fit.txt"))  # fmt: skip


def test_report_of_a_verification(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    changes = ["grid={nodes=[15,15]}", "window={start=0.005,end=0.02}", "record={}"]
    scene = Scene.load("paper", changes).replace("title", TITLE)
    (tmp_path / "panel.toml").write_text(scene.to_toml())
    output_of(command("simulate", "panel.toml", "--no-pictures", "--path", "modal"))
    result = tmp_path / "panel-simulate.h5"
    random = np.random.default_rng(0)
    points = random.uniform(0.02, 0.18, (30, 2))
    rows = [f"{x},{y},{random.uniform(0.5, 1)},0.01" for x, y in points.tolist()]
    (tmp_path / "scan.csv").write_text("\n".join(["x,y,velocity,uncertainty", *rows]))
    output_of(command("verify", result, "--data", "scan.csv", "--report", "verified.html"))
    page = read(tmp_path / "verified.html")
    assert load_result(result).scene.title == TITLE
    assert "localization factor" in page.text
    assert ("p", {"class": "warning"}) in page.tags or "measured velocities are" in page.text
