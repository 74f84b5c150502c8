"""Scenes built, changed and written in Python."""

import pytest

from warp_plate import Actuator, Drive, Grid, Plate, Scene, SceneError, Target, check, simulate

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
        (lambda: glass_panel().replace("drive.frequenzy", 300), r"drive\.frequency"),
        (lambda: glass_panel().replace("drive.frequency", "fast"), r"^drive\.frequency = \"fast\": must be a number$"),
        (lambda: glass_panel().replace("search.particles", 20.5), r"^search\.particles = 20\.5: must be a whole"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(make, line):
    with pytest.raises(SceneError, match=line):
        make()


def test_replace_changes_one_key():
    changed = glass_panel().replace("drive.frequency", 310)
    assert changed.drive.frequency == 310
    assert changed == glass_panel(drive=Drive(frequency=310))
    assert glass_panel().replace("actuators.a2.phase", 1.5).actuators[2].phase == 1.5


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
    for error in (KeyError, SceneError):
        with pytest.raises(error, match=r"^case = 'driv': must be one of drive$"):
            result.cases["driv"]
    with pytest.raises(KeyError, match=r"^region = 'rest': must be one of plate, target$"):
        result.cases["drive"].energy["rest"]
