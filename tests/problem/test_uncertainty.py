"""Scenarios: drawn within the tolerances, from the seed alone, each a scene that runs."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.scene.dump import dump_scene

FINGER = {"area": (0.02, 0.05, 0.02, 0.05), "mass": 1e-3, "stiffness": 200.0, "damping": 0.5}
EFFECTS = {
    "damping": {"viscous": 88.0},
    "material_damping": {"time": 1e-6},
    "foundation": {"stiffness": 1e4, "damping": 3.0},
    "oscillators": [FINGER],
}
TOLERANCES = {"young_modulus": 0.1, "thickness": 0.05, "damping": 0.5, "gain": 0.2, "place": 0.004}
VALUES = {
    "young_modulus": lambda scene: scene.plate.young_modulus,
    "thickness": lambda scene: scene.plate.thickness,
    "damping": lambda scene: scene.effects.damping.viscous,
}


@pytest.fixture
def robust(scene):
    """Make small scenes with ``[search.robust]``."""

    def make(effects=EFFECTS, nodes=(13, 13), time_step=None, frequency=290.0, **keys):
        return scene(nodes, effects=effects, time_step=time_step, frequency=frequency, search={"robust": keys})

    return make


def factors(scene, scenarios, value):
    """Return (scenarios,) a number of each scene, relative to the nominal one."""
    return np.array([value(scenario.scene) for scenario in scenarios]) / value(scene)


@given(
    tolerances=st.fixed_dictionaries(
        {name: st.floats(0.001, 0.3) for name in (*VALUES, "gain")} | {"place": st.floats(1e-6, 0.2)}
    ),
    seed=st.integers(0, 2**63 - 1),
    validation=st.booleans(),
)
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_draws_lie_within_the_tolerances(robust, tolerances, seed, validation):
    """And patches that would leave the plate stop at its edge."""
    made = robust(**tolerances)
    scenarios = draw_scenarios(made, 6, seed, validation)
    assert len(scenarios) == 6
    for name, value in VALUES.items():
        drawn = factors(made, scenarios, value)
        assert np.all(np.abs(drawn - 1) <= tolerances[name] * (1 + 1e-9))
        assert len(set(drawn)) == 6
    size = np.array(made.plate.size)
    for scenario in scenarios:
        assert np.all(np.abs(scenario.gain - 1) <= tolerances["gain"])
        assert np.all(np.abs(scenario.offset) <= tolerances["place"])
        for actuator, nominal, offset in zip(scenario.scene.actuators, made.actuators, scenario.offset, strict=True):
            area, old = (np.array(each.area).reshape(2, 2) for each in (actuator, nominal))
            np.testing.assert_allclose(np.diff(area), np.diff(old), rtol=1e-9)
            low, high = -old[:, 0], size - old[:, 1]
            np.testing.assert_allclose(area[:, 0] - old[:, 0], np.clip(offset, low, high), atol=1e-12)


def test_draws_are_even(robust):
    """The mean and the spread of an even distribution: 1/√3 of the tolerance, to four standard errors of 120 draws."""
    made = robust(effects={"damping": {"viscous": 88.0}}, young_modulus=0.1, gain=0.2)
    scenarios = draw_scenarios(made, 120, 3)
    stiffness = (factors(made, scenarios, VALUES["young_modulus"]) - 1) / 0.1
    gains = (np.array([scenario.gain for scenario in scenarios]) - 1) / 0.2
    for drawn in (stiffness, *gains.T):
        assert abs(drawn.mean()) < 4 / math.sqrt(3 * 120)
        assert abs((drawn**2).mean() - 1 / 3) < 4 * math.sqrt(4 / 45 / 120)


def test_the_seed_alone_decides(robust):
    """Not the number of scenarios either, nor another tolerance; scenarios are scenes that read back and run."""
    made = robust(**TOLERANCES, without_oscillators=0.5)
    first, same, other, validation = (draw_scenarios(made, 4, *seed) for seed in ((5,), (5,), (6,), (5, True)))
    few = draw_scenarios(robust(young_modulus=0.1, gain=0.2), 3, 5)
    for scenario, again, *others in zip(first, same, other, validation, strict=True):
        assert scenario.scene == again.scene
        assert Scene.parse(dump_scene(scenario.scene), "scenario") == scenario.scene
        np.testing.assert_array_equal(scenario.gain, again.gain)
        np.testing.assert_array_equal(scenario.offset, again.offset)
        assert all(scenario.scene.plate != another.scene.plate for another in [*others, *few])
    for scenario, more in zip(few, first, strict=False):
        assert scenario.scene.plate.young_modulus == more.scene.plate.young_modulus
        np.testing.assert_array_equal(scenario.gain, more.gain)
        # What is not drawn stays to the last bit.
        assert [each.area for each in scenario.scene.actuators] == [each.area for each in made.actuators]
    assert PlateSolver(first[0].scene, "cpu").run(np.ones((1, 3), complex)).finite.all()


def test_one_time_step_is_stable_for_all(robust):
    """The scene's own where it is stable; else the one that the stiffest would choose."""

    def steps_of(time_step=None):
        made = robust(frequency=50.0, time_step=time_step, **TOLERANCES)
        return {scenario.scene.grid.time_step for scenario in draw_scenarios(made, 8, 4)}

    made = robust(frequency=50.0, **TOLERANCES)
    limits = [make_scheme(scenario.scene).limit for scenario in draw_scenarios(made, 8, 4)]
    (step,) = steps_of()
    assert 0.8 * min(limits) < step <= 0.9 * min(limits)
    assert steps_of(0.5 * min(limits)) == {0.5 * min(limits)}
    assert steps_of(0.99 * make_scheme(made).limit) == {step}


BAD = {
    "search.robust: all scenarios are alike": {},
    "search.robust.damping: 0.1 of no damping": {"damping": 0.1},
    "search.robust.without_oscillators: 0.5": {"without_oscillators": 0.5},
    "search.robust.gain = 1.0": {"gain": 1.0},
    "search.robust.measure = 'best'": {"gain": 0.1, "measure": "best"},
    "search.robust.quantile = 1.0": {"gain": 0.1, "quantile": 1.0},
}


@pytest.mark.parametrize("line", BAD)
def test_bad_tables_are_refused_in_one_line(line, scene):
    with pytest.raises(SceneError, match="^" + line.replace(".", r"\.")) as caught:
        scene().with_tables(search={"robust": BAD[line]})
    assert "\n" not in str(caught.value)


def test_scenes_without_such_scenarios_are_refused(scene):
    with pytest.raises(SceneError, match=r'^search\.robust\.place: grid\.load = "nodes" .* not by 0\.002 m'):
        scene(load="nodes").with_tables(search={"robust": {"place": 0.002}})
    thick = {**scene().plate.model_dump(), "thickness": 0.035}
    with pytest.raises(SceneError, match=r"thickness: .* is not thin"):
        draw_scenarios(scene(search={"robust": {"thickness": 0.5}}).with_tables(plate=thick), 20, 0)
    with pytest.raises(SceneError, match=r"search\.robust: is missing"):
        draw_scenarios(scene(), 3, 0)
    with pytest.raises(SceneError, match=r"search\.robust: 100000000 scenarios .* GiB"):
        draw_scenarios(scene(search={"robust": {"gain": 0.1}}), 10**8, 0)
    halves = [{"name": "left", "area": (0.0, 0.1, 0.0, 0.2)}, {"name": "right", "area": (0.1, 0.2, 0.0, 0.2)}]
    tables = {key: value for key, value in scene().model_dump().items() if key != "target"}
    with pytest.raises(SceneError, match=r"^search\.robust: not with several \[\[targets\]\]"):
        Scene.from_tables({**tables, "targets": halves, "search": {"robust": {"gain": 0.1}}})


def test_factors_of_damping_and_rigidities(robust):
    """All damping of the panel has one factor; orthotropic rigidities follow modulus and thickness."""
    made = robust(damping=0.5, without_oscillators=0.3)
    scenarios = draw_scenarios(made, 60, 2)
    for scenario in scenarios:
        effects, factor = scenario.scene.effects, scenario.scene.effects.damping.viscous / 88
        assert effects.material_damping.time == pytest.approx(1e-6 * factor)
        assert effects.foundation.damping == pytest.approx(3 * factor)
        assert effects.foundation.stiffness == 1e4
        assert effects.oscillators in ((), made.effects.oscillators)
    bare = sum(not scenario.scene.effects.oscillators for scenario in scenarios)
    assert 4 <= bare <= 34  # 18 expected, four standard deviations of 3.5 to each side
    rigidities = {"Dx": 0.02, "Dy": 0.01, "D1": 0.004, "Dxy": 0.005}
    for scenario in draw_scenarios(robust(effects={"orthotropic": rigidities}, young_modulus=0.1, thickness=0.1), 2, 0):
        factor = (scenario.scene.plate.young_modulus / 1e9) * (scenario.scene.plate.thickness / 5e-4) ** 3
        for key, value in rigidities.items():
            assert getattr(scenario.scene.effects.orthotropic, key) == pytest.approx(value * factor)
