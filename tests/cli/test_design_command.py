"""``warp-plate design``: its JSON, the scene with its map, the picture and the solid, and what it refuses."""

import json
import sys
import zipfile
from types import SimpleNamespace
from unittest.mock import Mock
from xml.etree import ElementTree

import numpy as np
import pytest

from support.commands import error_of, output_of
from warp_plate import Scene, SceneError
from warp_plate.modal.solver import ModalSolver
from warp_plate.viz.plots.designed import save_solid

CHANGES = [
    f"--set={change}"
    for change in (
        "design.thickness={range=[3.5e-4,7.5e-4],length_scale=0.1,mass=1.0}",
        "design.starts=1",
        "design.iterations=3",
        "grid.modal_density=0.5",
    )
]


@pytest.mark.slow
def test_the_designed_scene_is_written_with_its_map(command, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    out = tmp_path / "panel.designed.toml"
    files = "--solid", "--drawing", "--json", "--out", str(out)
    record = json.loads(output_of(command("design", "paper", *CHANGES, *files)))
    assert record["after"]["bound"] > record["before"]["bound"] > 0.6
    assert record["history"][0][-1] == pytest.approx(record["after"]["value"], abs=0.02)
    assert out.with_suffix(".png").stat().st_size > 30_000
    scene = Scene.load(out)
    assert ModalSolver(scene, "cpu").response.bound() == pytest.approx(record["after"]["bound"], abs=1e-6)
    factors = np.loadtxt(out.with_suffix(".thickness.csv"), delimiter=",")
    assert factors * 5e-4 == pytest.approx(np.array(record["thickness"]))
    solid = pyvista.read(out.with_suffix(".stl"))
    assert solid.is_manifold
    assert solid.volume == pytest.approx(200 * 200 * 0.5, rel=3e-3)  # mm³, of the same mass, in flat triangles
    with zipfile.ZipFile(out.with_suffix(".3mf")) as file:
        assert [ElementTree.fromstring(file.read(name)).tag for name in file.namelist()]
        model = ElementTree.fromstring(file.read("3D/model.model"))
    rows = [[[float(value) for value in row.attrib.values()] for row in part] for part in model[0][0][0]]
    points, corners = np.array(rows[0]), np.array(rows[1], dtype=int)
    volume = np.linalg.det(points[corners]).sum() / 6  # positive only if all triangles face outwards
    assert (model.get("unit"), volume) == ("millimeter", pytest.approx(solid.volume, rel=1e-5))

    drawing = pytest.importorskip("ezdxf").readfile(out.with_suffix(".dxf"))
    drawn = {entity.dxf.layer for entity in drawing.modelspace()}
    assert {"outline", "actuators"} < drawn
    assert any(name.startswith("thickness 0.") for name in drawn)

    assert record["check"]["agrees"]
    assert abs(record["check"]["modes"] - record["after"]["bound"]) < 1e-6

    printed = output_of(command("design", "paper", *CHANGES, "--no-pictures", "--out", str(out)))
    assert "best drive in time steps: 0." in printed
    assert f"of any drive {record['before']['bound']:.4f} {record['after']['bound']:.4f}" in " ".join(printed.split())


def test_scenes_without_a_design_and_files_of_others_are_refused(command, tmp_path):
    assert "design: is missing" in error_of(command("design", "paper"))
    flat = ("--set=design.free={'plate.density'=[900.0,1100.0]}", "--solid", "--out", str(tmp_path / "a.toml"))
    assert "--solid: the scene has no map of thickness" in error_of(command("design", "paper", *flat))
    assert not list(tmp_path.iterdir())
    other = tmp_path / "paper.designed.toml"
    other.write_text("title = 'mine'")
    assert "would be overwritten" in error_of(command("design", "paper", *CHANGES, "--out", str(other)))


@pytest.mark.parametrize("ending", [".stl", ".3mf"])
def test_solids_are_written_whole_or_not_at_all(ending, tmp_path, monkeypatch):
    pytest.importorskip("pyvista")
    panel = SimpleNamespace(thickness=np.full((3, 4), 5e-4), scene=Scene.load("paper"))
    (path := tmp_path / f"a{ending}").write_text("old")
    monkeypatch.setattr("os.replace", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(SceneError, match="No space left"):
        save_solid(panel, path)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


def test_drawings_without_their_library_are_refused_before_the_search(command, tmp_path, monkeypatch):
    monkeypatch.setattr("warp_plate.designing.design._climb", None)
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    error = error_of(command("design", "paper", *CHANGES, "--drawing", "--out", str(tmp_path / "a.toml")))
    assert "--drawing: DXF files need ezdxf: pip install 'warp-plate[cad]'" in error


def test_starts_are_kept_until_the_panel_is_written(command, tmp_path, monkeypatch):
    """A full disk costs no search: the same command goes on where its result can be written."""
    line = [
        "design",
        "paper",
        *CHANGES,
        "--set=design.iterations=1",
        "--no-check",
        "--no-pictures",
        "--out",
        str(tmp_path / "a.toml"),
    ]
    with monkeypatch.context() as full:
        full.setattr("warp_plate.cli.output.write_files", Mock(side_effect=SceneError("a.toml: cannot be written")))
        status, answer, error = command(*line)
        assert answer
        assert (status, error) == (2, "warp-plate: a.toml: cannot be written\n")
    with monkeypatch.context() as late:
        late.setattr("warp_plate.design", Mock(side_effect=KeyboardInterrupt))
        assert command(*line) == (130, "", "warp-plate: interrupted; the same command continues\n")
    monkeypatch.setattr("warp_plate.designing.design._climb", None)
    output_of(command(*line))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.thickness.csv", "a.toml"]


def test_a_first_start_that_is_interrupted_is_not_continued(command, tmp_path, monkeypatch):
    monkeypatch.setattr("warp_plate.designing.design._climb", Mock(side_effect=KeyboardInterrupt))
    line = ("design", "paper", *CHANGES, "--no-check", "--no-pictures", "--out", tmp_path / "a.toml")
    status, _, error = command(*line)
    assert (status, error) == (130, "warp-plate: interrupted\n")
