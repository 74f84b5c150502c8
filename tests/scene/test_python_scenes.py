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


def test_wrong_value_of_a_table_is_one_line():
    with pytest.raises(SceneError, match=r"^thickness = -1.0: must be greater than 0$"):
        Plate(size=(0.2, 0.12), **{**GLASS, "thickness": -1.0})


def test_wrong_key_of_a_table_suggests_the_right_one():
    with pytest.raises(SceneError, match=r"^densty: unknown key; did you mean 'density'\?"):
        Plate(size=(0.2, 0.12), **GLASS, densty=1.0)


def test_wrong_table_inside_a_scene_is_named_in_full():
    with pytest.raises(SceneError, match=r"^drive\.frequency = -1: must be greater than 0$"):
        glass_panel(drive={"frequency": -1})


def test_tables_that_do_not_fit_together_are_one_line():
    with pytest.raises(SceneError, match=r"^target.* plate"):
        glass_panel(target=Target(disc=(0.5, 0.06, 0.015)))


def test_replace_changes_one_key():
    changed = glass_panel().replace("drive.frequency", 310)
    assert changed.drive.frequency == 310
    assert changed == glass_panel(drive=Drive(frequency=310))
    assert glass_panel().replace("actuators.a2.phase", 1.5).actuators[2].phase == 1.5


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("drive.frequenzy", 300, r"drive\.frequency"),
        ("drive.frequency", "fast", r"^drive\.frequency = \"fast\": must be a number$"),
        ("search.particles", 20.5, r"^search\.particles = 20\.5: must be a whole number$"),
    ],
)
def test_replace_names_what_is_wrong(key, value, why):
    with pytest.raises(SceneError, match=why):
        glass_panel().replace(key, value)


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
