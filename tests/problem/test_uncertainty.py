"""Scenarios, drawn within the tolerances from the seed alone, and losses over them: against scenes run one by one."""

import math
from dataclasses import replace

import numpy as np
import pytest

from support.scenes import areas_of, scene_of
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.cluster.evaluator import Evaluator
from warp_plate.plate.designs import Designs
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.uncertainty import (
    ScenarioLosses,
    apply_measure,
    draw_scenarios,
    scenario_responses,
    simulate_scenarios,
)
from warp_plate.resolve import resolve
from warp_plate.result.model import mean_of_worst
from warp_plate.scene.search import Robust

SEVERAL = [{"kind": "contrast"}, {"kind": "displacement", "weight": 1e6, "rest_limit": 1.0}]
FINGER = {"area": (0.02, 0.05, 0.02, 0.05), "mass": 1e-3, "stiffness": 200.0, "damping": 0.5}
DAMPED = {"damping": {"viscous": 88.0}}
FINGERED = {**DAMPED, "oscillators": [FINGER]}
EFFECTS = {**FINGERED, "material_damping": {"time": 1e-6}, "foundation": {"stiffness": 1e4, "damping": 3.0}}
TOLERANCES = {"young_modulus": 0.1, "thickness": 0.05, "damping": 0.3, "gain": 0.2, "place": 0.004}
VALUES = {
    "young_modulus": lambda scene: scene.plate.young_modulus,
    "thickness": lambda scene: scene.plate.thickness,
    "damping": lambda scene: scene.effects.damping.viscous,
}


def robust(effects=DAMPED, search=None, grid=None, **keys):
    """Return a small scene with ``[search.robust]``; grid: arguments of ``scene_of``, such as the precision."""
    return scene_of(effects=effects, search={"robust": keys, **(search or {})}, **(grid or {}))


def factors(scene, scenarios, value):
    """Return (scenarios,) a number of each scene, relative to the nominal one."""
    return np.array([value(scenario.scene) for scenario in scenarios]) / value(scene)


def test_any_number_has_a_tolerance():
    """Linked keys vary together, and other draws stay as they were."""
    springs = {side: {"translation": 1e6} for side in ("left", "right")}
    links = {"gasket": {"keys": ["edges.left.translation", "edges.right.translation"]}}
    tolerance = {"gasket": 0.3, "effects.damping.viscous": 0.1}
    scene = robust(young_modulus=0.05, tolerance={"effects.damping.viscous": 0.1})
    scene = scene.with_tables(edges=springs, links=links)
    scene = scene.with_tables(search={"robust": {"young_modulus": 0.05, "tolerance": tolerance}})
    drawn = draw_scenarios(scene, 40, 5)
    left = factors(scene, drawn, lambda one: one.edges.left.translation)
    right = factors(scene, drawn, lambda one: one.edges.right.translation)
    np.testing.assert_array_equal(left, right)
    assert 0.7 <= left.min() < 0.75
    assert 1.25 < left.max() <= 1.3
    damping = factors(scene, drawn, VALUES["damping"])
    assert 0.9 <= damping.min() < damping.max() <= 1.1
    alone = draw_scenarios(robust(young_modulus=0.05), 40, 5)
    stiffness = (factors(scene, some, VALUES["young_modulus"]) for some in (drawn, alone))
    np.testing.assert_array_equal(*stiffness)


def test_the_seed_alone_decides():
    """Not the number of scenarios either, nor another tolerance; scenarios are scenes that read back and run."""
    made = robust(EFFECTS, **TOLERANCES, without_oscillators=0.5)
    first, same, other, validation = (draw_scenarios(made, 4, *seed) for seed in ((5,), (5,), (6,), (5, True)))
    few = draw_scenarios(robust(EFFECTS, young_modulus=0.1, gain=0.2), 3, 5)
    for scenario, again, *others in zip(first, same, other, validation, strict=True):
        assert scenario.scene == again.scene
        assert Scene.parse(scenario.scene.to_toml(), "scenario") == scenario.scene
        np.testing.assert_array_equal(scenario.gain, again.gain)
        np.testing.assert_array_equal(scenario.offset, again.offset)
        assert all(scenario.scene.plate != another.scene.plate for another in [*others, *few])
    for scenario, more in zip(few, first, strict=False):
        assert scenario.scene.plate.young_modulus == more.scene.plate.young_modulus
        np.testing.assert_array_equal(scenario.gain, more.gain)
        # Values that are not drawn are unchanged, bit for bit.
        assert [each.area for each in scenario.scene.actuators] == [each.area for each in made.actuators]
    assert PlateSolver(first[0].scene, "cpu").run(np.ones((1, 3), complex)).finite.all()


def test_one_time_step_is_stable_for_all():
    """The scene's own where it is stable; else the one that the stiffest would choose."""

    def steps_of(time_step=None):
        made = robust(EFFECTS, grid={"frequency": 50.0, "time_step": time_step}, **TOLERANCES)
        return {scenario.scene.grid.time_step for scenario in draw_scenarios(made, 4, 4)}

    made = robust(EFFECTS, grid={"frequency": 50.0}, **TOLERANCES)
    limits = [make_scheme(scenario.scene).limit for scenario in draw_scenarios(made, 4, 4)]
    (step,) = steps_of()
    assert 0.8 * min(limits) < step <= 0.9 * min(limits)
    assert steps_of(0.5 * min(limits)) == {0.5 * min(limits)}
    assert steps_of(0.99 * make_scheme(made).limit) == {step}


def test_scenes_without_such_scenarios_are_refused(scene):
    for line, keys, load in (
        (": all scenarios are alike", {}, "overlap"),
        (".damping: 0.1 of no damping", {"damping": 0.1}, "overlap"),
        (".without_oscillators: 0.5", {"without_oscillators": 0.5}, "overlap"),
        (r'.place: 0\.002 m, but grid\.load = "nodes" moves', {"place": 0.002}, "nodes"),
    ):
        with pytest.raises(SceneError, match="^search.robust" + line):
            scene(load=load).with_tables(search={"robust": keys})
    thick = {**scene().plate.model_dump(), "thickness": 0.035}
    for made, count, line in (
        (robust(thickness=0.5).with_tables(plate=thick), 20, r"^search\.robust: plate.thickness: .* is not thin"),
        (scene(), 3, "search.robust: is missing"),
        (robust(gain=0.1), 10**8, "search.robust: 100000000 scenarios .* GiB"),
    ):
        with pytest.raises(SceneError, match=line):
            draw_scenarios(made, count, 0)
    made = robust({"loss_factor": {"eta": 0.02}}, thickness=0.1)
    (drawn,) = draw_scenarios(made, 1, 0, stepped=False)
    short = replace(drawn, scene=drawn.scene.replace("drive.frequency", 1e6))
    with pytest.raises(SceneError, match=r"^search\.robust: drive\.frequency: about .* modes are needed"):
        scenario_responses([short], resolve(made, "cpu"))
    halves = [{"name": "left", "area": (0.0, 0.1, 0.0, 0.2)}, {"name": "right", "area": (0.1, 0.2, 0.0, 0.2)}]
    tables = scene().model_dump(exclude={"target"})
    with pytest.raises(SceneError, match=r"^search\.robust: not with several \[\[targets\]\]"):
        Scene.from_tables({**tables, "targets": halves, "search": {"robust": {"gain": 0.1}}})


def test_draws_are_even_within_the_tolerances():
    """Mean and spread of an even distribution, 1/√3 of the tolerance, to four standard errors. A patch that would leave
    the plate stops at its edge; one factor goes for all damping of the panel."""
    tolerances, count = {**TOLERANCES, "place": 0.08}, 40
    made = robust(EFFECTS, without_oscillators=0.3, **tolerances)
    scenarios = draw_scenarios(made, count, 3)
    gains, offsets = (np.array([getattr(scenario, name) for scenario in scenarios]) for name in ("gain", "offset"))
    drawn = [(factors(made, scenarios, value) - 1) / tolerances[name] for name, value in VALUES.items()]
    for values in (*drawn, *((gains - 1) / 0.2).T, *(offsets / 0.08).reshape(count, -1).T):
        assert np.abs(values).max() <= 1 + 1e-9
        assert abs(values.mean()) < 4 / math.sqrt(3 * count)
        assert abs((values**2).mean() - 1 / 3) < 4 * math.sqrt(4 / 45 / count)
    bare = sum(not scenario.scene.effects.oscillators for scenario in scenarios)
    assert abs(bare - 0.3 * count) < 4 * math.sqrt(0.3 * 0.7 * count)
    old = areas_of(made)
    for scenario in scenarios:
        shift = np.clip(scenario.offset, -old[..., 0], np.array(made.plate.size) - old[..., 1])
        np.testing.assert_allclose(areas_of(scenario.scene), old + shift[..., None], atol=1e-12)
        effects, factor = scenario.scene.effects, scenario.scene.effects.damping.viscous / 88
        assert effects.material_damping.time == pytest.approx(1e-6 * factor)
        assert (effects.foundation.stiffness, effects.foundation.damping) == (1e4, pytest.approx(3 * factor))
        assert effects.oscillators in ((), made.effects.oscillators)


def test_orthotropic_rigidities_follow_modulus_and_thickness():
    rigidities = {"Dx": 0.02, "Dy": 0.01, "D1": 0.004, "Dxy": 0.005}
    (drawn,) = draw_scenarios(robust({"orthotropic": rigidities}, young_modulus=0.1, thickness=0.1), 1, 0)
    factor = (drawn.scene.plate.young_modulus / 1e9) * (drawn.scene.plate.thickness / 5e-4) ** 3
    expected = {key: value * factor for key, value in rigidities.items()}
    assert drawn.scene.effects.orthotropic.model_dump() == pytest.approx(expected)


@pytest.mark.parametrize("several", [False, True])
def test_gram_matrices_give_the_losses_of_plates(device, path, phasors, several):
    """Float64 energies agree up to a few digits lost by polarization. Plates run as separate scenes, bit for bit."""
    tables = {"effects": FINGERED, "search": {"objectives": SEVERAL}, "without_oscillators": 0.5} if several else {}
    scenarios = draw_scenarios(robust(**tables, **TOLERANCES), 2, 2)
    designs = Designs(phasors(7, 3))
    responses, simulated = (
        losses(scenarios, resolve(scenarios[0].scene, device, path=path))
        for losses in (scenario_responses, simulate_scenarios)
    )
    losses = simulated.losses(designs)
    np.testing.assert_allclose(responses.losses(designs), losses, rtol=1e-9)
    sets = len(simulated.scenarios[0].evaluators)
    assert sets == 1 + several
    solvers = [PlateSolver(scenario.scene, device, path) for scenario in scenarios]
    assert responses.setup_cost[1] == 21 * sets * sum(solver.node_steps_per_plate for solver in solvers)
    if not several:
        for column, scenario, solver in zip(losses.T, scenarios, solvers, strict=True):
            energy = solver.run(designs.drives * scenario.gain).energy
            np.testing.assert_array_equal(column, 1 - localization_factor(energy))
        assert np.ptp(losses, axis=1).min() > 1e-4


def test_bits_do_not_depend_on_how_a_batch_is_cut(phasors):
    """Neither on plates beside each other, nor on memory for a few only; a drive beyond all numbers fails alone."""
    made = robust(FINGERED, grid={"precision": "float32"}, **TOLERANCES, without_oscillators=0.5)
    scenarios, drives = draw_scenarios(made, 3, 3), phasors(9, 3)
    drives[4] = 1e200
    designs = Designs(drives)
    responses, simulated = (
        losses(scenarios, resolve(scenarios[0].scene, "cpu")) for losses in (scenario_responses, simulate_scenarios)
    )
    for losses_of in (responses, simulated):
        losses = losses_of.losses(designs)
        parts = np.concatenate([losses_of.losses(designs[cut]) for cut in (slice(0, 2), slice(2, 3), slice(3, 9))])
        np.testing.assert_array_equal(parts, losses)
        assert np.flatnonzero(np.isnan(losses).any(axis=1)).tolist() == [4]
        matrices = None if losses_of.matrices is None else losses_of.matrices[2:4]
        only = ScenarioLosses(losses_of.scenarios[1:2], matrices)
        np.testing.assert_array_equal(only.losses(designs)[:, 0], losses[:, 1])
    small = []
    for plates in simulated.scenarios:
        solver = PlateSolver(plates.scenario.scene, "cpu", chunk=2, per_plate=plates.scenario.per_plate)
        small.append(replace(plates, evaluators=(Evaluator(solver),)))
    np.testing.assert_array_equal(ScenarioLosses(tuple(small)).losses(designs), simulated.losses(designs))
    np.testing.assert_array_equal(replace(responses, block=13).losses(designs), responses.losses(designs))


@pytest.mark.parametrize("searched", [False, True])
def test_actuators_are_off_by_their_offsets(device, path, phasors, searched):
    """A scene written out with its patches where they are moves the same; a patch stops at an edge of the plate."""
    made = robust(search={"position": {}} if searched else {}, **{**TOLERANCES, "place": 0.02})
    scenario = draw_scenarios(made, 1, 4)[0]
    drives, centre = phasors(1, 3), np.array([[[0.02, 0.02], [0.1, 0.14], [0.11, 0.1]]])
    (plates,) = simulate_scenarios([scenario], resolve(scenario.scene, device, path=path)).scenarios
    energy = plates.evaluators[0].run(scenario.designs(Designs(drives, centre=centre if searched else None))).energy
    areas = areas_of(made)
    half = np.diff(areas, axis=2)[..., 0] / 2
    place = np.clip((centre[0] if searched else areas.mean(axis=2)) + scenario.offset, half, 0.2 - half)
    areas = (place[..., None] + half[..., None] * [-1, 1]).clip(0, 0.2).reshape(-1, 4).tolist()
    tables = [actuator.model_dump() | {"area": area} for actuator, area in zip(made.actuators, areas, strict=True)]
    written = scenario.scene.with_tables(actuators=tables)
    expected = PlateSolver(written, device, path).run(drives * scenario.gain).energy
    np.testing.assert_allclose(energy, expected, rtol=1e-9)


@pytest.mark.parametrize("quantile", [0.01, 0.5, 0.93])
def test_measures(random, quantile):
    """A plate that fails in some scenario is worse than any."""
    losses = random.random((4, 12))
    losses[2, 6] = np.nan
    mean, worst, part = (
        apply_measure(losses, Robust(measure=name, quantile=quantile)) for name in ("mean", "worst", "quantile")
    )
    np.testing.assert_allclose(mean, losses.mean(axis=1))
    np.testing.assert_array_equal(worst, np.sort(losses, axis=1)[:, -1])
    np.testing.assert_array_equal(part, np.sort(losses, axis=1)[:, math.ceil(12 * quantile) - 1] + 0 * worst)
    np.testing.assert_array_equal(mean_of_worst(np.stack([np.arange(200.0), np.zeros(200)])), [4.5, 0.0])
