"""Scenes whose outline is in an SVG or DXF file: as by keys, embedded in results, and what is refused."""

import tomllib
from functools import cache

import pytest

from support.drawings import AUTOCAD, DRAWINGS, HOLES, OUTLINE
from support.scenes import refused
from support.scenes_of_outlines import outlined
from warp_plate import Scene
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.load import dump_toml

BY_KEYS = outlined(
    OUTLINE, "clamped", HOLES, target={"area": (0.0, 0.05, 0.0, 0.05)}, actuators=[(0.05, 0.06, 0.01, 0.02)],
    modal_density=0.4,
)  # fmt: skip


def written(folder, name, text, holes=(), **keys):
    """Write a drawing and the scene that names it; return the path of the scene."""
    (folder / name).write_text(text)
    tables = tomllib.loads(BY_KEYS.to_toml())
    tables["plate"] |= {"outline": {"file": name, **keys}, "holes": tuple(holes)}
    (folder / "scene.toml").write_text(dump_toml(tables))
    return folder / "scene.toml"


@cache
def frequencies_by_keys():
    return solve_modes(BY_KEYS, highest=0.0, count=4).frequencies[:4]


@pytest.mark.parametrize("program", DRAWINGS)
def test_a_drawing_is_the_same_plate_as_keys(program, tmp_path):
    text, suffix, keys = DRAWINGS[program]
    holes = [BY_KEYS._tables()["plate"]["holes"][1]] if program == "r12" else []  # R12 has no ellipses
    scene = Scene.load(written(tmp_path, f"panel{suffix}", text, holes, **keys))
    assert [hole.edge for hole in scene.plate.holes] == ["free", "free"]
    assert scene.plate.area == pytest.approx(BY_KEYS.plate.area, rel=1e-12)
    assert solve_modes(scene, highest=0.0, count=4).frequencies[:4] == pytest.approx(frequencies_by_keys(), rel=1e-9)


def test_a_scene_holds_what_it_has_read(tmp_path):
    path = written(tmp_path, "panel.dxf", AUTOCAD, holes_edge="clamped")
    scene = Scene.load(path, ["plate.outline.unit=mm"])
    assert [hole.edge for hole in scene.plate.holes] == ["clamped", "clamped"]
    (tmp_path / "panel.dxf").unlink()
    assert Scene.parse(scene.to_toml(), "again") == scene
    assert scene.replace("plate.thickness", 1e-3).plate.outline == scene.plate.outline
    assert "no such file beside the scene file" in refused(Scene.load, path)
    (tmp_path / "panel.dxf").mkdir()
    assert "plate.outline.file = 'panel.dxf': is no file" in refused(Scene.load, path)


@pytest.mark.parametrize(
    ("name", "keys", "message"),
    [
        ("panel.step", {}, "plate.outline.file: 'panel.step' is not the name of a .svg or .dxf file"),
        ("panel.dxf", {"disc": [0.1, 0.1, 0.1]}, "plate.outline.file: disc is given too"),
        ("panel.dxf", {"unit": "inch"}, "plate.outline.file = 'panel.dxf': its $INSUNITS state a unit of 0.001 m, but"),
        ("panel.dxf", {"unit": "cubit"}, "plate.outline.unit"),
        ("panel.dxf", {"layer": "cut"}, "holds no contours in 'cut'"),
    ],
)
def test_what_does_not_fit_is_refused(name, keys, message, tmp_path):
    assert message in refused(Scene.load, written(tmp_path, name, AUTOCAD, **keys))


def test_keys_of_files_need_a_file():
    assert "plate.outline.unit: not for disc; only for file" in refused(
        BY_KEYS.replace, "plate.outline", {"disc": (0.1, 0.1, 0.1), "unit": "mm"}
    )
    assert "'panel.svg' is read with a scene file" in refused(BY_KEYS.replace, "plate.outline", {"file": "panel.svg"})


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ([], "path"),
        ([[0.0, 0.0, 0.1]], "path[0]: 3 numbers; write 2 (straight), 5 (arc) or 7"),
        ([[0.0, 0.0, 0.1, 0.1, 0.0]], "path[0]: an angle of 0"),
        ([[0.1, 0.1, 0.1, 0.1, 3.0]], "path[0]: has no radius"),
        ([[0.1, 0.0, 0.1, 0.1, 3.0], [0.0, 0.1]], "plate.outline: is open between piece 0 and piece 1"),
    ],
)
def test_wrong_paths_are_refused(path, message):
    assert message in refused(BY_KEYS.replace, "plate.outline", {"path": path})
