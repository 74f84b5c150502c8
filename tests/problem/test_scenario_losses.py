"""Losses over scenarios: against scenes run one by one, Gram matrices against plates, and the measures."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from warp_plate import PlateSolver
from warp_plate.cluster.evaluator import Evaluator
from warp_plate.plate.designs import Designs
from warp_plate.plate.weights import localization_factor
from warp_plate.problem import scenario_losses
from warp_plate.problem.scenario_losses import ScenarioLosses, apply_measure, scenario_responses, simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.robust import mean_of_worst
from warp_plate.scene.search import Robust

SEVERAL = [{"kind": "contrast"}, {"kind": "displacement", "weight": 1e6, "rest_limit": 1.0}]
FINGER = {"area": (0.02, 0.05, 0.02, 0.05), "mass": 1e-3, "stiffness": 200.0, "damping": 0.5}
TOLERANCES = {"young_modulus": 0.1, "thickness": 0.05, "damping": 0.3, "gain": 0.2, "place": 0.004}


@pytest.fixture
def robust(scene):
    """Make small scenes with ``[search.robust]``, with or without a finger that may be there."""

    def make(finger=False, precision="float64", tables=None, **keys):
        effects = {"damping": {"viscous": 88.0}} | ({"oscillators": [FINGER]} if finger else {})
        keys = TOLERANCES | ({"without_oscillators": 0.5} if finger else {}) | keys
        return scene(precision=precision, effects=effects, search={"robust": keys, **(tables or {})})

    return make


def energies(losses, designs):
    """Return (scenarios, plates, regions)."""
    runs = [plates.evaluators[0].run(plates.scenario.designs(designs)) for plates in losses.scenarios]
    return np.array([run.energy for run in runs])


@pytest.mark.parametrize("finger", [False, True])
def test_plates_of_scenarios_are_those_of_their_scenes(device, path, robust, phasors, finger):
    """To the last bit: a scenario is a scene of its own, under gain times the drive."""
    scenarios, drives = draw_scenarios(robust(finger), 4, 1), phasors(5, 3)
    simulated = simulate_scenarios(scenarios, device, path)
    energy, losses = energies(simulated, Designs(drives)), simulated.losses(Designs(drives))
    for index, scenario in enumerate(scenarios):
        alone = PlateSolver(scenario.scene, device, path).run(drives * scenario.gain).energy
        np.testing.assert_array_equal(energy[index], alone)
        np.testing.assert_array_equal(losses[:, index], 1 - localization_factor(alone))
    assert np.ptp(losses, axis=1).min() > 1e-4


@pytest.mark.parametrize(("finger", "objectives"), [(False, [{}]), (True, SEVERAL)], ids=["localization", "several"])
def test_gram_matrices_give_the_losses_of_plates(device, path, robust, phasors, finger, objectives):
    """In float64; polarization costs a few digits of sixteen."""
    scenarios = draw_scenarios(robust(finger, tables={"objectives": objectives}), 3, 2)
    designs = Designs(phasors(7, 3))
    responses, simulated = scenario_responses(scenarios, device, path), simulate_scenarios(scenarios, device, path)
    np.testing.assert_allclose(responses.losses(designs), simulated.losses(designs), rtol=1e-9)
    sets = len(simulated.scenarios[0].evaluators)
    assert sets == len(objectives)
    runs = 21 * sets * sum(PlateSolver(each.scene, device, path).node_steps_per_plate for each in scenarios)
    assert responses.setup_cost[1] == runs


def test_bits_do_not_depend_on_how_a_batch_is_cut(robust, phasors, monkeypatch):
    """Neither on plates beside each other, nor on memory for a few only, nor on other scenarios."""
    scenarios = draw_scenarios(robust(True, "float32"), 3, 3)
    designs = Designs(phasors(9, 3))
    responses, simulated = scenario_responses(scenarios, "cpu"), simulate_scenarios(scenarios, "cpu")
    for losses_of in (responses, simulated):
        losses = losses_of.losses(designs)
        parts = np.concatenate([losses_of.losses(designs[cut]) for cut in (slice(0, 2), slice(2, 3), slice(3, 9))])
        np.testing.assert_array_equal(parts, losses)
        for measure in ("mean", "worst", "quantile"):
            first, same = (apply_measure(each, Robust(measure=measure))[0] for each in (parts[:1], losses))
            assert first == same
        matrices = None if losses_of.matrices is None else losses_of.matrices[2:4]
        only = ScenarioLosses(losses_of.scenarios[1:2], matrices)
        np.testing.assert_array_equal(only.losses(designs)[:, 0], losses[:, 1])
    small = []
    for plates in simulated.scenarios:
        solver = PlateSolver(plates.scenario.scene, "cpu", chunk=2, per_plate=plates.scenario.per_plate)
        small.append(replace(plates, evaluators=(Evaluator(solver),)))
    np.testing.assert_array_equal(ScenarioLosses(tuple(small)).losses(designs), simulated.losses(designs))
    losses = responses.losses(designs)
    monkeypatch.setattr(scenario_losses, "BLOCK", 13)
    np.testing.assert_array_equal(responses.losses(designs), losses)


def test_scenarios_share_kernels_wherever_their_actuators_are(robust):
    """On CUDA the rows that some actuator loads are compiled in: all scenarios have those of their wider areas."""
    scenarios = draw_scenarios(robust(place=0.05), 6, 0)
    solvers = [evaluator.solver for evaluator in simulate_scenarios(scenarios, "cpu").evaluators]
    assert len({tuple(solver.specialized.loaded_rows) for solver in solvers}) == 1
    alone = {tuple(PlateSolver(scenario.scene, "cpu").specialized.loaded_rows) for scenario in scenarios}
    assert len(alone) > 1


def test_searched_places_are_off_as_well_and_stay_on_the_plate(robust):
    scenario = draw_scenarios(robust(place=0.05), 1, 5)[0]
    centre = np.array([[[0.05, 0.05], [0.1, 0.15], [0.1, 0.1]], [[0.015, 0.015], [0.175, 0.175], [0.04, 0.1]]])
    moved = scenario.designs(Designs(np.ones((2, 3)), centre=centre)).centre
    half = np.array([[a.area[1] - a.area[0], a.area[3] - a.area[2]] for a in scenario.scene.actuators]) / 2
    np.testing.assert_allclose(moved, np.clip(centre + scenario.offset, half, 0.2 - half))
    assert np.any(moved != centre + scenario.offset)
    assert np.any(moved == centre + scenario.offset)


@pytest.mark.parametrize("searched", [False, True])
def test_actuators_are_off_by_their_offsets(device, path, robust, phasors, searched):
    """A scene written out with its patches where they are moves the same, whether or not places are searched."""
    made = robust(tables={"position": {}} if searched else {}, place=0.01)
    scenario = draw_scenarios(made, 1, 4)[0]
    drives, centre = phasors(1, 3), np.array([[[0.05, 0.05], [0.1, 0.14], [0.11, 0.1]]])
    simulated = simulate_scenarios([scenario], device, path)
    energy = energies(simulated, Designs(drives, centre=centre if searched else None))[0]
    tables = [actuator.model_dump() for actuator in made.actuators]
    for table, middle, offset in zip(tables, centre[0], scenario.offset, strict=True):
        area = np.array(table["area"]).reshape(2, 2)
        place = (middle if searched else area.mean(axis=1)) + offset
        table["area"] = (area + (place - area.mean(axis=1))[:, None]).ravel().tolist()
    written = scenario.scene.with_tables(actuators=tables)
    expected = PlateSolver(written, device, path).run(drives * scenario.gain).energy
    np.testing.assert_allclose(energy, expected, rtol=1e-10)


losses_of_plates = arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 12)), elements=st.floats(0, 1))


@given(losses=losses_of_plates, quantile=st.floats(0.01, 0.99))
def test_measures(losses, quantile):
    count = losses.shape[1]
    mean, worst, part = (
        apply_measure(losses, Robust(measure=name, quantile=quantile)) for name in ("mean", "worst", "quantile")
    )
    np.testing.assert_allclose(mean, losses.sum(axis=1) / count)
    np.testing.assert_array_equal(worst, np.sort(losses, axis=1)[:, -1])
    for row, value in zip(losses, part, strict=True):
        assert value in row
        assert np.count_nonzero(row <= value) >= quantile * count - 1e-9
        assert np.count_nonzero(row < value) < quantile * count + 1e-9


def test_the_mean_of_the_worst_twentieth():
    np.testing.assert_array_equal(mean_of_worst(np.stack([np.arange(200.0), np.zeros(200)])), [4.5, 0.0])
    assert mean_of_worst(np.arange(19.0)[None]) == 0


@pytest.mark.parametrize("measure", ["mean", "worst", "quantile"])
def test_a_plate_that_fails_in_one_scenario_is_worse_than_any(measure):
    losses = np.full((3, 20), 0.5)
    losses[1, 7], losses[2, 3] = np.nan, 1.0
    measured = apply_measure(losses, Robust(measure=measure, quantile=0.5))
    assert np.isnan(measured).tolist() == [False, True, False]


def test_a_drive_beyond_all_numbers_fails_alone(robust):
    """NaN from its plates in all scenarios, and nothing in its neighbours."""
    drives = np.ones((3, 3), complex)
    drives[1] = 1e200
    losses = simulate_scenarios(draw_scenarios(robust(), 2, 0), "cpu").losses(Designs(drives))
    assert np.isnan(losses).tolist() == [[False, False], [True, True], [False, False]]
