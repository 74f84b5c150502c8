"""Scenes built, changed and written in Python."""

import pydoc
import re

import numpy as np
import pytest
from pydantic import BaseModel

from warp_plate import (
    Actuator,
    Drive,
    Grid,
    Plate,
    PlateSolver,
    Scene,
    SceneError,
    Search,
    Target,
    check,
    load_result,
    modes,
    motion,
    save_result,
    simulate,
)
from warp_plate.scene.errors import toml_text
from warp_plate.scene.keys import assign
from warp_plate.scene.load import parse_toml

GLASS = {"thickness": 0.7e-3, "young_modulus": 72e9, "poisson_ratio": 0.22, "density": 2480}


def glass_panel(**tables):
    plate = Plate(size=(0.2, 0.12), **GLASS)
    actuators = [Actuator(name=f"a{k}", area=(0.03 * k + 0.02, 0.03 * k + 0.03, 0.02, 0.04)) for k in range(6)]
    tables = {"drive": Drive(frequency=300), "target": Target(disc=(0.1, 0.06, 0.015)), **tables}
    return Scene(plate=plate, actuators=actuators, **tables)


def test_scene_of_tables_is_that_of_its_text():
    assert Scene.parse(glass_panel().to_toml(), "") == glass_panel()


def test_repr_is_a_short_line():
    assert repr(glass_panel(title="glass")) == str(glass_panel(title="glass"))
    assert repr(glass_panel(title="glass")) == "<Scene 'glass', 200 × 120 × 0.7 mm, 6 actuators, 300 Hz>"


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: Plate(size=(0.2, 0.12), **{**GLASS, "thickness": -1.0}), r"^thickness = -1.0: must be greater"),
        (lambda: Plate(size=(0.2, 0.12), **GLASS, densty=1.0), r"^densty: unknown key; did you mean 'density'\?"),
        (lambda: glass_panel(drive={"frequency": -1}), r"^drive\.frequency = -1: must be greater than 0$"),
        (lambda: glass_panel(target=Target(disc=(0.5, 0.06, 0.015))), r"^target.* plate"),
        (lambda: setattr(glass_panel().drive, "frequency", 3), r'^drive.*scene\.replace\("drive\.frequency", 3\)'),
        (lambda: setattr(glass_panel().actuators[1], "phase", 1), r'scene\.replace\("actuators\[0\]\.phase", 1\)'),
        (lambda: setattr(glass_panel(), "edges", {}), r'^edges: .*scene\.replace\("edges", \.\.\.\)'),
        (lambda: glass_panel().replace("drive.frequenzy", 300), r"^drive\.frequenzy: unknown key; did you mean"),
        (lambda: glass_panel().replace("actuators[7].area", None), r"^actuators\[7\]\.area: the scene has a list of 6"),
        (lambda: glass_panel().replace("edges.left", "held"), r"^edges\.left = \"held\": must be 'clamped'"),
        (lambda: glass_panel().replace("drive.frequency", "fast"), r"^drive\.frequency = \"fast\": must be a number$"),
        (lambda: glass_panel().replace("search.particles", 20.5), r"^search\.particles = 20\.5: must be a whole"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(make, line):
    with pytest.raises(SceneError, match=line):
        make()


@pytest.mark.parametrize(
    ("value", "what"),
    [
        (np.True_, "a number"),
        (np.complex128(300 + 1j), "a number"),
        (np.str_("300"), "a number"),
        (np.ma.masked, "a finite number"),
        (np.array([300.0]), "a number"),
    ],
)
def test_numbers_of_numpy_that_are_none(value, what):
    with pytest.raises(SceneError, match=rf"^drive\.frequency = .*: must be {what}$"):
        glass_panel().replace("drive.frequency", value)


def test_numbers_of_numpy_and_lists_without_an_order():
    swapped = np.array([0.2, 0.12], ">f8")
    assert glass_panel().replace("plate.size", swapped) == glass_panel()
    assert glass_panel().replace("drive.frequency", np.array(300, np.uint16)) == glass_panel()
    for value in ({0.2, 0.12}, np.array([True, True]), np.array(["0.2", "0.12"])):
        with pytest.raises(SceneError, match=r"^plate\.size = .*: must be a list of numbers$"):
            glass_panel().replace("plate.size", value)


def test_replace_changes_one_key():
    changed = glass_panel().replace("drive.frequency", 310)
    assert changed.drive.frequency == 310
    assert changed == glass_panel(drive=Drive(frequency=310))
    assert glass_panel().replace("actuators.a2.phase", 1.5).actuators[2].phase == 1.5


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("effects.variation", {"density": [[1.0, 1.1], [1.0, 1.0]]}),
        ("edges.left", "free"),
        ("edges.left", {"translation": 1e6}),
        ("actuators[0].area", [0.02, 0.04, 0.02, 0.05]),
        ("target.area", (0.1, 0.12, 0.03, 0.05)),
        ("effects.stretching", {}),
    ],
)
def test_replace_takes_whole_tables_as_assignments_do(key, value):
    scene = glass_panel()
    tables = {key: part for key, part in parse_toml(scene.to_toml(), "").items() if key != "grid"}
    assign(tables, [f"{key}={toml_text(value)}"])
    assert scene.replace(key, value) == Scene.from_tables(tables)
    assert scene.replace("effects.damping", {"viscous": 9.0}).replace("effects.damping", None) == scene


def test_assignments_of_unknown_names_suggest_known_ones():
    with pytest.raises(SceneError, match=r"drive\.frequncy: unknown key; did you mean 'frequency'\?"):
        glass_panel().drive.frequncy = 300.0


@pytest.mark.parametrize("table", [Plate, Search, Target, Scene, type(glass_panel().effects)])
def test_help_is_about_the_keys_of_a_table(table):
    text = pydoc.plain(pydoc.render_doc(table))
    assert len(text.splitlines()) < 250
    for line in text.splitlines():
        assert not re.match(r" \|  (model_|copy|json|parse_obj|dict|construct|validate)", line)
    for name in table.model_fields:
        assert f"\n |  {name} : " in text


def test_help_names_units_defaults_and_examples():
    text = pydoc.plain(pydoc.render_doc(Plate))
    assert "thickness : m, required\n |      Thickness H, at most a fifth of the shorter side. For ex" in text
    assert "Plate(*, size, thickness, young_modulus, poisson_ratio, density, outline=None, holes=())" in text
    assert "particles : default 20" in pydoc.plain(pydoc.render_doc(Search))
    assert Scene.model_json_schema()["$defs"]["Plate"]["description"] == "Geometry and material of the plate."


def test_names_of_scenes_are_their_own():
    scene = glass_panel()
    assert {"plate", "replace", "to_toml", "drive_unit"} <= set(dir(scene)) == set(dir(Scene))
    assert {"size", "rigidity"} <= set(dir(scene.plate))
    for shown in (scene, scene.plate, scene.drive):
        assert not [name for name in dir(shown) if name in dir(BaseModel) or name.startswith("_")]


def test_functions_take_scenes_and_files(tmp_path):
    small = glass_panel(grid=Grid(nodes=(11, 9)), window={"start": 0.001, "end": 0.002})
    file = tmp_path / "panel.toml"
    file.write_text(small.to_toml(), encoding="utf-8")
    assert check(small, "cpu") == check(file, "cpu") == check(str(file), "cpu")
    assert Scene.load(small) is small
    result = simulate(file, source="panel", device="cpu", estimate=False)
    assert result.scene == small
    factor = 100 * result.cases["drive"].localization_factor
    assert repr(result) == f"<Result simulate panel: drive {factor:.3g} %>"
    case, lines = result.main_case, str(result).splitlines()
    (row,) = (line.split() for line in lines if line.startswith("drive  ") and "factor" not in line)
    velocity, acceleration = case.motion.velocity[0] * 1e3, case.motion.acceleration[0] / 9.80665
    assert row[2] == f"{case.localization_factor:.4f}"
    assert (row[4], row[10]) == (f"{velocity:.3g}", f"{acceleration:.3g}")
    assert lines[-len(result.warnings) :] == [f"! {line}" for line in result.warnings]
    assert "take more nodes" in result.warnings[0]
    assert load_result(save_result(result, tmp_path / "panel.h5")).warnings == result.warnings
    for error in (KeyError, SceneError):
        with pytest.raises(error, match=r"^case = 'driv': must be one of drive$"):
            result.cases["driv"]
    with pytest.raises(KeyError, match=r"^region = 'rest': must be one of plate, target$"):
        result.cases["drive"].energy["rest"]


def test_results_show_no_pages_of_numbers():
    small = glass_panel(grid=Grid(nodes=(11, 9)), window={"start": 0.001, "end": 0.005})
    result, plate = simulate(small, device="cpu", estimate=False), modes("console", count=3)
    run = PlateSolver(small, "cpu").run([[1.0] * 6, [0.5] * 6])
    factor = result.main_case.localization_factor
    assert repr(result.main_case) == f"<Case 6 actuators, localization factor {factor:.4g}>"
    assert repr(run) == "<Run 2 plates, 0 of them faulty>"
    assert repr(plate) == "<ModalPlate 3 modes, the highest at 382 Hz>"
    assert repr(check(small, "cpu")).startswith("<Check ")
    assert repr(motion(result, frames=4, device="cpu")).startswith("<Motion drive: 4 frames of 11 × 9 nodes, ")
