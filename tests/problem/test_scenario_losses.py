"""Robust searches: plates × scenarios against scenes run one by one, Gram matrices against plates, the measures."""

import importlib
from dataclasses import replace
from pkgutil import iter_modules

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from warp_plate import PlateSolver, kernels
from warp_plate.plate.designs import Designs
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.robust import measured
from warp_plate.problem.scenario_losses import ScenarioLosses, in_scenario, scenario_responses, simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.robust import mean_of_worst
from warp_plate.scene.search import Robust

SEVERAL = [{"kind": "contrast"}, {"kind": "displacement", "weight": 1e6, "rest_limit": 1.0}]
FINGER = {"area": (0.02, 0.05, 0.02, 0.05), "mass": 1e-3, "stiffness": 200.0, "damping": 0.5}
TOLERANCES = {"young_modulus": 0.1, "thickness": 0.05, "damping": 0.3, "gain": 0.2, "place": 0.004}


@pytest.fixture
def robust(scene):
    """Small scenes with [search.robust]; a finger that is there or not where asked for."""

    def make(finger=False, precision="float64", tables=None, **keys):
        effects = {"damping": {"viscous": 88.0}} | ({"oscillators": [FINGER]} if finger else {})
        keys = TOLERANCES | ({"without_oscillators": 0.5} if finger else {}) | keys
        return scene(precision=precision, effects=effects, search={"robust": keys, **(tables or {})})

    return make


def energies(panels, designs):
    """(scenarios, plates, regions)."""
    runs = [panel.evaluators[0].run(in_scenario(designs, panel.scenario)) for panel in panels.scenarios]
    return np.array([run.energy for run in runs])


@pytest.mark.parametrize("finger", [False, True])
def test_plates_of_scenarios_are_those_of_their_scenes(device, path, robust, phasors, finger):
    """To the last bit: a scenario is a scene of its own, under gain times the drive."""
    scenarios = draw_scenarios(robust(finger), 4, 1)
    drives = phasors(5, 3)
    panels = simulate_scenarios(scenarios, device, path)
    found, losses = energies(panels, Designs(drives)), panels.losses(Designs(drives))
    for index, one in enumerate(scenarios):
        alone = PlateSolver(one.scene, device, path).run(drives * one.gain).energy
        np.testing.assert_array_equal(found[index], alone)
        np.testing.assert_array_equal(losses[:, index], 1 - localization_factor(alone))
    assert np.ptp(losses, axis=1).min() > 1e-4


@pytest.mark.parametrize("finger", [False, True])
@pytest.mark.parametrize("objectives", [[{}], SEVERAL], ids=["localization", "several"])
def test_gram_matrices_give_the_losses_of_plates(device, path, robust, phasors, finger, objectives):
    """In float64; polarisation costs a few digits of sixteen."""
    made = robust(finger, tables={"objectives": objectives})
    scenarios = draw_scenarios(made, 3, 2)
    designs = Designs(phasors(7, 3))
    gram, direct = scenario_responses(scenarios, device, path), simulate_scenarios(scenarios, device, path)
    np.testing.assert_allclose(gram.losses(designs), direct.losses(designs), rtol=1e-9)
    runs = 21 * len(direct.scenarios[0].evaluators)
    assert len(direct.scenarios[0].evaluators) == len(objectives)
    assert gram.node_steps == sum(runs * PlateSolver(one.scene, device, path).node_steps_per_plate for one in scenarios)


def test_bits_do_not_depend_on_how_a_batch_is_cut(robust, phasors, monkeypatch):
    """Neither with plates beside each other, nor in memory for a few only, nor with other scenarios."""
    scenarios = draw_scenarios(robust(True, "float32"), 3, 3)
    designs = Designs(phasors(9, 3))
    gram, direct = scenario_responses(scenarios, "cpu"), simulate_scenarios(scenarios, "cpu")
    for panels in (gram, direct):
        whole = panels.losses(designs)
        parts = np.concatenate([panels.losses(designs[cut]) for cut in (slice(0, 2), slice(2, 3), slice(3, 9))])
        np.testing.assert_array_equal(parts, whole)
        for measure in ("mean", "worst", "quantile"):
            of_parts, of_whole = (measured(losses, Robust(measure=measure)) for losses in (parts[:1], whole))
            assert of_parts[0] == of_whole[0]
        only = ScenarioLosses(panels.scenarios[1:2], None if panels.matrices is None else panels.matrices[2:4])
        np.testing.assert_array_equal(only.losses(designs)[:, 0], whole[:, 1])
    cut = [
        replace(
            panel, evaluators=(PlateSolver(panel.scenario.scene, "cpu", chunk=2, per_plate=panel.scenario.per_plate),)
        )
        for panel in direct.scenarios
    ]
    np.testing.assert_array_equal(ScenarioLosses(tuple(cut)).losses(designs), direct.losses(designs))
    whole = gram.losses(designs)
    monkeypatch.setattr("warp_plate.problem.scenario_losses.BLOCK", 13)
    np.testing.assert_array_equal(gram.losses(designs), whole)


def test_kernels_do_not_grow_with_scenarios(robust):
    """One set with the finger and one without; on CUDA rows that some actuator presses on are compiled in too."""
    scenarios = draw_scenarios(robust(True, place=0.03), 12, 0)
    with_finger = [bool(one.scene.effects.oscillators) for one in scenarios]
    first = {there: with_finger.index(there) for there in (True, False)}
    simulate_scenarios([scenarios[at] for at in first.values()], "cpu")
    compiled = kernels_made()
    solvers = [panel.evaluators[0].solver for panel in simulate_scenarios(scenarios, "cpu").scenarios]
    assert kernels_made() == compiled > 0
    assert {tuple(solver.specialized.loaded_rows) for solver in solvers} == {tuple(solvers[0].specialized.loaded_rows)}
    covered = {tuple(PlateSolver(one.scene, "cpu").specialized.loaded_rows) for one in scenarios}
    assert len(covered) > 1


def kernels_made():
    """Entries in the caches of all factories of kernels."""
    modules = [importlib.import_module(f"warp_plate.kernels.{one.name}") for one in iter_modules(kernels.__path__)]
    factories = {made for module in modules for made in vars(module).values() if hasattr(made, "cache_info")}
    return sum(made.cache_info().currsize for made in factories)


def test_solvers_share_the_memory(robust, monkeypatch):
    """All plates of all scenarios at a time take what one solver would."""
    asked = []
    monkeypatch.setattr("warp_plate.solve.solver.CPU_CHUNK_BYTES", 400_000)
    monkeypatch.setattr("warp_plate.solve.solver.make_state", keep_capacity(asked))
    scenarios = draw_scenarios(robust(), 5, 0)
    drives = np.ones((40, 3), complex)
    PlateSolver(scenarios[0].scene, "cpu").run(drives)
    simulate_scenarios(scenarios, "cpu").losses(Designs(drives))
    alone, *shared = asked
    assert 10 <= alone < 40
    assert len(shared) == 5
    assert sum(shared) <= alone


def keep_capacity(asked):
    from warp_plate.solve.state import make_state

    def make(specialized, capacity, nodes):
        asked.append(capacity)
        return make_state(specialized, capacity, nodes)

    return make


def test_places_of_their_own_are_off_as_well_and_stay_on_the_plate(robust):
    one = draw_scenarios(robust(place=0.05), 1, 5)[0]
    centre = np.array([[[0.05, 0.05], [0.1, 0.15], [0.1, 0.1]], [[0.015, 0.015], [0.175, 0.175], [0.04, 0.1]]])
    moved = in_scenario(Designs(np.ones((2, 3)), centre=centre), one).centre
    half = np.array([[a.area[1] - a.area[0], a.area[3] - a.area[2]] for a in one.scene.actuators]) / 2
    np.testing.assert_allclose(moved, np.clip(centre + one.offset, half, 0.2 - half))
    assert np.any(moved != centre + one.offset)
    assert np.any(moved == centre + one.offset)


@pytest.mark.parametrize("searched", [False, True])
def test_actuators_are_off_by_their_offsets(device, path, robust, phasors, searched):
    """Whether or not places are searched: a scene written out with its patches where they are moves the same."""
    made = robust(tables={"position": {}} if searched else {}, place=0.01)
    one = draw_scenarios(made, 1, 4)[0]
    drives, centre = phasors(1, 3), np.array([[[0.05, 0.05], [0.1, 0.14], [0.11, 0.1]]])
    panels = simulate_scenarios([one], device, path)
    found = energies(panels, Designs(drives, centre=centre if searched else None))[0]
    tables = [actuator.model_dump() for actuator in made.actuators]
    for table, middle, offset in zip(tables, centre[0], one.offset, strict=True):
        area = np.array(table["area"]).reshape(2, 2)
        place = (middle if searched else area.mean(axis=1)) + offset
        table["area"] = (area + (place - area.mean(axis=1))[:, None]).ravel().tolist()
    written = one.scene.with_tables(actuators=tables)
    np.testing.assert_allclose(found, PlateSolver(written, device, path).run(drives * one.gain).energy, rtol=1e-10)


losses_of_plates = arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 12)), elements=st.floats(0, 1))


@given(losses=losses_of_plates, quantile=st.floats(0.01, 0.99))
def test_measures(losses, quantile):
    count = losses.shape[1]
    mean, worst, part = (
        measured(losses, Robust(measure=name, quantile=quantile)) for name in ("mean", "worst", "quantile")
    )
    np.testing.assert_allclose(mean, losses.sum(axis=1) / count)
    np.testing.assert_array_equal(worst, np.sort(losses, axis=1)[:, -1])
    for row, value in zip(losses, part, strict=True):
        assert value in row
        assert np.count_nonzero(row <= value) >= quantile * count - 1e-9
        assert np.count_nonzero(row < value) < quantile * count + 1e-9


def test_the_worst_twentieth():
    values = np.stack([np.arange(200.0), np.zeros(200)])
    np.testing.assert_array_equal(mean_of_worst(values), [4.5, 0.0])
    assert mean_of_worst(np.arange(19.0)[None]) == 0


@pytest.mark.parametrize("measure", ["mean", "worst", "quantile"])
def test_a_plate_that_fails_in_one_scenario_is_worse_than_any(measure):
    losses = np.full((3, 20), 0.5)
    losses[1, 7] = np.nan
    losses[2, 3] = 1.0
    found = measured(losses, Robust(measure=measure, quantile=0.5))
    assert np.isnan(found).tolist() == [False, True, False]


def test_a_drive_beyond_all_numbers_fails_alone(robust):
    """NaN from the plates of one drive in all scenarios, and nothing in its neighbours."""
    panels = simulate_scenarios(draw_scenarios(robust(), 2, 0), "cpu")
    drives = np.ones((3, 3), complex)
    drives[1] = 1e200
    losses = panels.losses(Designs(drives))
    assert np.isnan(losses).tolist() == [[False, False], [True, True], [False, False]]
    assert np.isnan(measured(losses, Robust())).tolist() == [False, True, False]
