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


@pytest.mark.parametrize(("finger", "objectives"), [(False, [{}]), (True, SEVERAL)], ids=["localization", "several"])
def test_gram_matrices_give_the_losses_of_plates(device, path, robust, phasors, finger, objectives):
    """In float64; polarization costs a few digits of sixteen. Plates run as scenes of their own, to the last bit."""
    scenarios = draw_scenarios(robust(finger, tables={"objectives": objectives}), 3, 2)
    designs = Designs(phasors(7, 3))
    responses, simulated = scenario_responses(scenarios, device, path), simulate_scenarios(scenarios, device, path)
    losses = simulated.losses(designs)
    np.testing.assert_allclose(responses.losses(designs), losses, rtol=1e-9)
    sets = len(simulated.scenarios[0].evaluators)
    assert sets == len(objectives)
    solvers = [PlateSolver(scenario.scene, device, path) for scenario in scenarios]
    assert responses.setup_cost[1] == 21 * sets * sum(solver.node_steps_per_plate for solver in solvers)
    if objectives == [{}]:
        for column, scenario, solver in zip(losses.T, scenarios, solvers, strict=True):
            energy = solver.run(designs.drives * scenario.gain).energy
            np.testing.assert_array_equal(column, 1 - localization_factor(energy))
        assert np.ptp(losses, axis=1).min() > 1e-4


def test_bits_do_not_depend_on_how_a_batch_is_cut(robust, phasors, monkeypatch):
    """Neither on plates beside each other, nor on memory for a few only; a drive beyond all numbers fails alone."""
    scenarios, drives = draw_scenarios(robust(True, "float32"), 3, 3), phasors(9, 3)
    drives[4] = 1e200
    designs = Designs(drives)
    responses, simulated = scenario_responses(scenarios, "cpu"), simulate_scenarios(scenarios, "cpu")
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


@pytest.mark.parametrize("searched", [False, True])
def test_actuators_are_off_by_their_offsets(device, path, robust, phasors, searched):
    """A scene written out with its patches where they are moves the same; a patch stops at an edge of the plate."""
    made = robust(tables={"position": {}} if searched else {}, place=0.02)
    scenario = draw_scenarios(made, 1, 4)[0]
    drives, centre = phasors(1, 3), np.array([[[0.02, 0.02], [0.1, 0.14], [0.11, 0.1]]])
    (plates,) = simulate_scenarios([scenario], device, path).scenarios
    energy = plates.evaluators[0].run(scenario.designs(Designs(drives, centre=centre if searched else None))).energy
    tables = [actuator.model_dump() for actuator in made.actuators]
    for table, middle, offset in zip(tables, centre[0], scenario.offset, strict=True):
        area = np.array(table["area"]).reshape(2, 2)
        half = np.diff(area, axis=1)[:, 0] / 2
        place = np.clip((middle if searched else area.mean(axis=1)) + offset, half, 0.2 - half)
        table["area"] = (place[:, None] + half[:, None] * [-1, 1]).clip(0, 0.2).ravel().tolist()
    written = scenario.scene.with_tables(actuators=tables)
    expected = PlateSolver(written, device, path).run(drives * scenario.gain).energy
    np.testing.assert_allclose(energy, expected, rtol=1e-9)


losses_of_plates = arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 12)), elements=st.floats(0, 1))


@given(losses=losses_of_plates, quantile=st.floats(0.01, 0.99))
def test_measures(losses, quantile):
    """A plate that fails in some scenario is worse than any."""
    count = losses.shape[1]
    failed = np.vstack([losses, losses[:1]])
    failed[-1, count // 2] = np.nan
    mean, worst, part = (
        apply_measure(failed, Robust(measure=name, quantile=quantile)) for name in ("mean", "worst", "quantile")
    )
    np.testing.assert_array_equal([mean[-1], worst[-1], part[-1]], np.nan)
    np.testing.assert_allclose(mean[:-1], losses.sum(axis=1) / count)
    np.testing.assert_array_equal(worst[:-1], np.sort(losses, axis=1)[:, -1])
    for row, value in zip(losses, part[:-1], strict=True):
        assert value in row
        assert np.count_nonzero(row <= value) >= quantile * count - 1e-9
        assert np.count_nonzero(row < value) < quantile * count + 1e-9
    np.testing.assert_array_equal(mean_of_worst(np.stack([np.arange(200.0), np.zeros(200)])), [4.5, 0.0])
