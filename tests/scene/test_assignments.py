"""``--set KEY=VALUE``: values put into the tables of a scene file."""

import pytest

from support.scenes import refused
from warp_plate import Scene


@pytest.mark.parametrize(
    ("assignment", "reached", "value"),
    [
        ("drive.frequency=300", lambda scene: scene.drive.frequency, 300.0),
        ("plate.size[1] = 0.21", lambda scene: scene.plate.size, (0.2, 0.21)),
        ("actuators.upper left.phase=1.5", lambda scene: scene.actuators[1].phase, 1.5),
        ("actuators[3].name=corner=top", lambda scene: scene.actuators[3].name, "corner=top"),
        ("actuators[0].force=0.1", lambda scene: (scene.actuators[0].force, scene.actuators[1].force), (0.1, None)),
        ("edges.left=free", lambda scene: scene.edges.left, "free"),
        ("edges.left={translation = 1e6}", lambda scene: scene.edges.left.translation, 1e6),
        (
            "target.disc=[0.1, 0.1, 0.03]",
            lambda scene: (scene.target.disc, scene.target.area),
            ((0.1, 0.1, 0.03), None),
        ),
        ("grid.accuracy=0.02", lambda scene: scene.grid.accuracy, 0.02),
        ("effects.loss_factor.eta=0.03", lambda scene: scene.effects.loss_factor.eta, 0.03),
    ],
)
def test_any_key_of_a_scene_is_set(assignment, reached, value):
    paper = Scene.load("paper")
    assert reached(Scene.load("paper", [assignment])) == value
    assert Scene.load("paper", []) == paper


def test_assignments_follow_each_other():
    scene = Scene.load("paper", ["grid.accuracy=0.02", "grid.nodes=[31, 41]", "grid.nodes[0]=33"])
    assert (scene.grid.nodes, scene.grid.accuracy) == ((33, 41), None)


def test_keys_of_a_fit_are_set():
    """They are keys themselves, with indices and names, in a table that may be there or not."""
    key = "measurement[0].gain"
    row = '[{actuator = "lower left", point = [0.1, 0.1]}]'
    scene = Scene.load("paper", [f"measurement={row}", f"fit.free.{key}=[0.5, 2]", "fit.free.plate.density=[1, 2]"])
    assert dict(scene.fit.free) == {key: (0.5, 2.0), "plate.density": (1.0, 2.0)}
    quoted = Scene.load("paper", [f"measurement={row}", f'fit.free."{key}"=[0.5, 2]'])
    assert dict(quoted.fit.free) == {key: (0.5, 2.0)}
    named = Scene.load("paper", ["fit.free.actuators.lower left.area[0]=[0.0, 0.01]"])
    assert list(named.fit.free) == ["actuators.lower left.area[0]"]
    assert "fit.free is no table" in refused(Scene.load, "paper", ["fit.free=3", f"fit.free.{key}=[1, 2]"])


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("drive.frequency", "must be KEY=VALUE"),
        ("=3", "must be KEY=VALUE"),
        ("actuators.none.phase=1", "a list of lower left, upper left, lower right, upper right before 'none'"),
        ("drive..frequency=3", "must have a key such as drive.frequency"),
        ("drive.frequency=30O", 'paper: drive.frequency = "30O": must be a number'),
        ("drive.frequency='300'", 'paper: drive.frequency = "300": must be a number'),
        ("drive.frequency=true", "paper: drive.frequency = true: must be a number"),
        ("grid.nodes=['27', 27]", 'paper: grid.nodes = ["27", 27]: must be a list of whole numbers'),
        ("drive.frequenzy=300", "drive.frequenzy: unknown key"),
        ("actuators[7].phase=1", "a list of 4"),
        ("plate.thickness.x=1", "no table"),
        ("plate[0]=1", "no list"),
    ],
)
def test_wrong_assignments_are_refused_by_name(assignment, said):
    assert said in refused(Scene.load, "paper", [assignment])
