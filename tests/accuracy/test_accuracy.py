"""Reference solutions, configurations, measured rows, fits, chosen grids and error bars."""

import math
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from support import series
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.accuracy import configurations, report
from warp_plate.accuracy.choose import choose, error_of_grid, find_grid
from warp_plate.accuracy.configurations import Configuration, cost_of_run, percent, regrid, seconds_text
from warp_plate.accuracy.estimate import estimate, estimate_modal
from warp_plate.accuracy.measure import AccuracyRow, measure, measure_modal
from warp_plate.accuracy.reference_solution import (
    by_richardson,
    find_reference_solution,
    largest_change,
    refine_until,
    solve_response,
)
from warp_plate.modal import modes
from warp_plate.modal.eigenproblem import solve_eigenproblem
from warp_plate.modal.motion import fields
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import localization_factor, node_positions
from warp_plate.resolve import resolve, resolve_for_sweep
from warp_plate.scene.grid import Grid, Window
from warp_plate.scene.vary import make_plan, parse_vary
from warp_plate.solve.response import Response
from warp_plate.studies.localize import localize

OVERLAP = Configuration(2, "overlap", (27, 27), None, "float32")
MOMENTS = Configuration(4, "moments", (21, 21), None, "float32")


@pytest.fixture(scope="module")
def exact(panel):
    """The finest reference solution of the panel by modes."""
    return find_reference_solution(panel, "cpu", 0.0)


@pytest.fixture(scope="module")
def paper_exact():
    """The reference solution of the paper's scene, to 1e-3."""
    return find_reference_solution(Scene.load("paper"), "cpu", 1e-3)


def factors_of(scene, phasors):
    return localization_factor(PlateSolver(scene, "cpu").run(phasors).energy)


def test_formatting():
    values = (0.00853, 0.01, 0.25, 3.2, 4e-7)
    assert [percent(value) for value in values] == ["0.85 %", "1 %", "25 %", "320 %", "4e-05 %"]
    assert [seconds_text(value) for value in (0.0021, 12.3, 2.1e-5)] == ["2.1 ms", "12 s", "21 µs"]


def test_another_configuration_keeps_the_physics(scene):
    written = scene(damping=50.0, scheme="backward", size=(0.3, 0.2))
    made = regrid(written, replace(MOMENTS, time_step=1e-5))
    assert configurations.configuration_of(made) == replace(MOMENTS, time_step=1e-5)
    assert (made.effects.damping.scheme, made.effects.damping.viscous) == ("centred", 50.0)
    kept = ("plate", "edges", "window", "drive", "target", "actuators", "search", "record")
    assert all(getattr(made, name) == getattr(written, name) for name in kept)
    with pytest.raises(SceneError, match=r"^grid\.nodes"):
        regrid(written, replace(MOMENTS, nodes=(27, 8)))


@pytest.mark.parametrize(("size", "side"), [((0.2, 0.2), 13), ((0.3, 0.1), 27), ((0.05, 0.4), 105)])
def test_cells_are_nearly_square(size, side):
    nx, ny = configurations.nodes_for(size, side, 4)
    assert size[0] / (nx - 1) == pytest.approx(size[1] / (ny - 1), rel=0.1)
    assert (nx - 1) * (ny - 1) == pytest.approx((side - 1) ** 2, rel=0.1)
    assert min(configurations.nodes_for((0.05, 0.4), 13, 4)) == 9


@pytest.mark.parametrize("window", [(0.05, 0.1), (0.0, 0.02), (0.02, 0.03)])
def test_aligned_steps_divide_the_run_and_the_time_before_the_window(scene, window):
    step = configurations.aligned(scene(window=window).window, 1.23e-4)
    assert 0.9 * 1.23e-4 < step <= 1.23e-4
    for time in window:
        assert time / step == pytest.approx(round(time / step), abs=1e-6)


def test_configurations_vary_load_precision_grid_and_time_step(panel):
    own = [{**one.model_dump(), "frequency": 100.0 + 50 * index} for index, one in enumerate(panel.actuators)]
    for other in (panel.with_tables(edges={"left": "free"}), panel.with_tables(actuators=own)):
        assert {one.order for one in configurations.make_configurations(other)} == {2}
    made = configurations.make_configurations(panel)
    assert len(set(made)) == len(made)
    assert {(one.order, one.load, one.precision) for one in made} == {
        (2, "nodes", "float32"), (2, "overlap", "float32"), (2, "overlap", "float64"), (4, "moments", "float32"),
        (4, "moments", "float64"),
    }  # fmt: skip
    for order, load in ((2, "overlap"), (4, "moments")):
        limit = make_scheme(regrid(panel, Configuration(order, load, (27, 27), None, "float64"))).limit
        assert configurations.stability_limit(panel, order, (27, 27)) == pytest.approx(limit, rel=1e-12)
        longest = configurations.longest_time_step(panel, order, (27, 27))
        steps = sorted({one.time_step for one in made if (one.order, one.nodes) == (order, (27, 27))})
        assert steps[-1] > limit > steps[-2] == longest
        assert np.divide(steps[:2], longest) == pytest.approx([0.25, 0.5], rel=0.1)


def test_richardson_agrees_with_modes_within_its_uncertainty(panel, exact):
    change = partial(largest_change, np.empty((0, 3)))
    grids = refine_until(by_richardson(panel, "cpu", change), lambda last: 4.5e-2, 1e-3)
    assert grids.kind == "richardson"
    assert 0 < grids.uncertainty < 0.05
    for name, factor in grids.localization_factors.items():
        assert factor == pytest.approx(exact.localization_factors[name], rel=grids.uncertainty)
    assert grids.bound == pytest.approx(exact.bound, rel=grids.uncertainty)


def test_uncertainty_covers_further_refinement(panel, exact):
    rough = find_reference_solution(panel, "cpu", 0.2)
    assert abs(rough.bound / exact.bound - 1) < rough.uncertainty
    assert rough.density < exact.density
    # Waves too short for the modes that are solved for.
    fast = panel.model_copy(update={"drive": panel.drive.model_copy(update={"frequency": 3e4})})
    with pytest.raises(SceneError, match=r"^drive\.frequency"):
        configurations.refuse_many_modes(fast)
    with pytest.raises(SceneError, match=r"^actuators\[0\]\.frequency"):
        configurations.refuse_many_modes(panel.replace("actuators[0].frequency", 3e4))


def test_the_modal_reference_is_the_sine_series():
    """Energies and displacements of a supported plate under patches, from rest; the error of displacements is about the
    root of that of energies."""
    scene, drive = Scene.load("paper-supported"), np.array([1, 0.3 - 0.4j, 0, 0.2j])
    found = find_reference_solution(scene, "cpu", 2e-4)
    energy = found.response.energy(drive[None])[0]
    np.testing.assert_allclose(energy, series.kinetic_energies(scene, drive, terms=32), rtol=1e-4)
    x, y, times = np.linspace(0, 0.2, 9), np.linspace(0, 0.2, 7), np.array([0.0, 0.002, 0.03, 0.1])
    exact = series.displacement(scene, drive, times, x, y, terms=120)
    tolerance = math.sqrt(found.uncertainty) * np.abs(exact).max()
    np.testing.assert_allclose(fields(found.plate, drive[None], times, x, y)[0], exact, atol=tolerance)


def test_an_undamped_resonance_has_no_modal_reference(panel, exact):
    """The modes nearest to the drive would cancel, to negative energies."""
    tables = {"effects": {}, "drive": {"frequency": float(exact.plate.frequencies[0])}}
    tuned = panel.with_tables(**tables)
    found = find_reference_solution(tuned, "cpu", 0.2, 1e-3)
    assert found.kind == "richardson"
    assert 0 < found.localization_factors["single"] < found.bound <= 1
    with pytest.raises(SceneError, match=r"drive\.frequency"):
        solve_response(tuned, 1.0)


def test_a_row_agrees_with_a_run(paper_exact):
    scene = Scene.load("paper")
    row = measure(scene, paper_exact, MOMENTS, "cpu")
    computed = factors_of(regrid(scene, MOMENTS), np.array(list(paper_exact.drives.values())))
    assert (row.status, row.plates) == ("ok", scene.search.particles)
    assert row.localization_factor == pytest.approx(computed[0], rel=1e-6)
    expected = [*paper_exact.localization_factors.values(), paper_exact.bound]
    assert row.error == pytest.approx(np.abs([*computed, row.bound] / np.array(expected) - 1).max(), rel=1e-3)
    assert 0.005 < row.error < 0.03
    assert 0 < row.error_displacement < 0.1
    assert row.seconds_per_plate > 0


def test_rows_of_modes(paper_exact):
    """Errors fall with the density, and a search shares one solution."""
    scene = Scene.load("paper")
    rough, fine = (measure_modal(scene, paper_exact, density) for density in (0.4, 0.6))
    assert 0.01 > rough.error > fine.error > 0
    assert (rough.order, rough.nodes, fine.nodes) == (7, (11, 11), (14, 14))
    assert 0 < fine.error_displacement < 0.05
    assert fine.search_seconds(0) == fine.seconds_once < fine.search_seconds(10) < 2 * fine.seconds_once
    assert fine.seconds_per_plate == pytest.approx(fine.search_seconds(fine.plates) / fine.plates)


def test_failures_are_rows(paper_exact):
    scene = Scene.load("paper")
    assert measure(scene, paper_exact, replace(OVERLAP, time_step=1e-4)).status.startswith("refused: grid.time_step")
    skipped = measure(scene, paper_exact, replace(OVERLAP, nodes=(105, 105)), seconds_left=0.01)
    assert (skipped.status.partition(":")[0], skipped.budgeted) == ("skipped", 0.0)
    written = measure(scene, paper_exact, None, "cpu")
    assert (written.as_written, written.damping, written.load) == (True, "backward", "nodes")
    wild = replace(paper_exact)
    for phasors in wild.drives.values():
        phasors *= 1e160
    unstable = measure(scene, wild, OVERLAP, "cpu")
    assert (unstable.status, unstable.error) == ("unstable", None)


def row_of(side, error, seconds, **changes):
    """Return a measured row of a square plate of one metre."""
    row = AccuracyRow(
        4, "moments", (side, side), 1 / side**2, "float64", None, 1 / (side - 1), False, "ok",
        error=error, error_displacement=error, seconds_per_plate=seconds,
    )  # fmt: skip
    return replace(row, **changes)


def test_laws_are_fitted():
    rows = [row_of(side, 30 / (side - 1) ** 4, 1e-9 * (side - 1) ** 3.7) for side in (9, 17, 33, 65)]
    rows += [row_of(17, 0.2, 1.0, time_step=1e-9), row_of(129, 1.0, 9.0, as_written=True)]
    rows += [row_of(129, None, None, status="refused: so")]
    law = report.fit_laws(rows, 1e-13)[0]
    assert (law.order, law.order_displacement) == (pytest.approx(4), pytest.approx(4))
    assert law.cost_exponent == pytest.approx(3.7)
    assert report.fit_laws(rows, 1e-2)[0].order is None


def test_front_and_recommendations():
    rows = [row_of(9, 0.2, 1.0), row_of(13, 0.05, 2.0), row_of(13, 0.06, 3.0), row_of(17, 0.008, 4.0)]
    rows.append(row_of(33, None, None, status="skipped: so"))
    assert report.pareto_front(rows) == [0, 1, 3]
    assert report.pareto_front([*rows, row_of(18, 0.00795, 5.0)]) == [0, 1, 3]
    # A coarse grid that is right by chance is not recommended, because a finer one is not right.
    assert report.recommend([*rows, row_of(10, 0.001, 1.5)], 0.003, 100)[1].row == 3
    assert [(one.tolerance, one.row, one.seconds) for one in report.recommend(rows, 0.003, 100)] == [
        (0.1, 1, 200.0), (0.03, 3, 400.0), (0.01, None, None), (0.003, None, None), (0.001, None, None),
    ]  # fmt: skip


def test_accuracies_out_of_reach_are_refused(panel):
    long = panel.model_copy(update={"window": Window(start=0.0, end=1e6)})
    with pytest.raises(SceneError, match=r"^accuracy = 0\.1: out of reach"):
        choose(long, 0.1, "cpu")
    with pytest.raises(SceneError, match=r"^accuracy = 0\.0001: the solution.*ask for \S+ or more$"):
        choose(panel, 1e-4, "cpu")


@pytest.mark.slow
def test_a_refusal_names_the_least_error_of_grids_and_modes(panel):
    """Modes have 2e-4; a grid needs a reference that is better than the accuracy by a factor of two."""
    with pytest.raises(SceneError) as refusal:
        choose(panel, 1e-5, "cpu", engine="any")
    known, possible = map(float, re.findall(r"known to (\S+) only; ask for (\S+) or more", str(refusal.value))[0])
    assert possible <= 1.1 * known
    assert choose(panel, possible, "cpu", engine="any").by_modes


def test_the_least_error_is_chosen_where_no_accuracy_is_required(panel):
    choice = choose(panel, 1e-5, "cpu", engine="modes", required=False)
    assert choice.by_modes
    assert 1e-5 < choice.error < 1e-3


def test_a_grid_by_waves_is_chosen_where_no_error_is_known(panel):
    long = panel.model_copy(update={"window": Window(start=0.0, end=1e6)})
    choice = choose(long, 0.1, "cpu", required=False)
    assert choice.error == math.inf
    assert min(choice.scene.grid.nodes) > 12


def test_a_small_patch_beside_an_edge_loads_the_grid_that_is_chosen(scene):
    """Its patch lies in the half cell of nodes that are held, and the scene was refused."""
    made = scene(size=(0.11, 0.26), actuators=[(0.1085, 0.109, 0.0067, 0.0073)], window=(0.0, 0.01), frequency=20.0)
    tables = made.with_tables(effects={"stretching": {}}).model_dump(exclude={"grid"})
    run = PlateSolver(Scene.from_tables(tables), "cpu").run(np.ones((1, 1), dtype=complex))
    assert (run.energy > 0).all()


@pytest.mark.slow
def test_only_a_written_accuracy_is_refused(scene):
    """A tiny patch starts abruptly, and the window opens at once.

    1.5 times as many functions take the error from 1.2 to 0.8, so that 2.2 times as many are not tried.
    """
    made = scene(size=(0.3, 0.1), actuators=[(0.05, 0.0505, 0.05, 0.0505)], window=(0.0, 2e-4), frequency=20.0)
    tiny = Scene.from_tables(made.model_dump(exclude={"grid"}))
    resolved = resolve(tiny, "cpu", purpose="simulate")
    assert resolved.by_modes
    assert resolved.accuracy["expected"] > resolved.accuracy["asked"] == 0.01
    assert resolved.scene.grid.modal_density == 1.5
    with pytest.raises(SceneError, match=r"^accuracy = 0\.01: "):
        resolve(tiny.with_accuracy(0.01), "cpu", purpose="simulate")


def test_coarse_grids_of_the_moment_form_are_tried(panel):
    grid = choose(panel.with_tables(edges={"left": "free"}), 0.2, "cpu").scene.grid
    assert max(grid.nodes) < 25


@pytest.mark.parametrize("lucky", [9, 14])
def test_grids_are_confirmed_by_finer_ones(panel, lucky):
    """A grid that is right by chance, while finer ones are wrong, is not taken."""

    def error_on(grid):
        side = grid.nodes[0]
        return 0.001 if side == lucky else 0.3 * (12 / (side - 1)) ** 4

    grid, error = find_grid(panel.with_values({"drive.frequency": 200.0}), 0.01, error_on)
    least = 1 + 12 * (0.3 / 0.01) ** 0.25
    assert error == error_on(grid) <= 0.01
    assert least <= grid.nodes[0] <= 1.1 * least


def test_the_work_of_all_trials_is_bounded(panel):
    """Of three actuators each has 21 plates."""
    work = []

    def error_on(grid):
        work.append(21 * configurations.node_steps(panel, grid))
        return 1.0

    assert find_grid(panel, 0.01, error_on) == (None, 1.0)
    assert 1e8 < sum(work) <= 4e10


def test_a_drive_that_moves_no_plate_has_an_infinite_error(panel, exact):
    coarse = replace(MOMENTS, nodes=(9, 9))
    assert error_of_grid(panel, exact, np.zeros((1, 3)), "cpu", coarse) == math.inf
    assert error_of_grid(panel, exact, np.ones((1, 3)), "cpu", coarse) < 1


@pytest.mark.parametrize("configuration", [OVERLAP, replace(OVERLAP, load="nodes"), MOMENTS], ids=str)
def test_error_bars_cover_the_exact_value(panel, exact, configuration):
    made = regrid(panel, configuration)
    phasors = np.array([*exact.drives.values(), np.ones(3)])
    run = PlateSolver(made, "cpu").run(phasors, [0.02, 0.03])
    factors = localization_factor(run.energy)
    found = estimate(made, phasors, factors, "cpu", run.times, run.displacement)
    errors = np.abs(factors[:2] / list(exact.localization_factors.values()) - 1)
    assert (errors <= found.errors[:2]).all()
    assert (found.errors[:2] <= errors + 2 * found.uncertainty).all()
    assert found.error == found.errors.max()
    assert f"{factors[0]:.3f}"[:5] in found.line(0)
    np.testing.assert_array_equal(estimate(made, phasors, factors, "cpu").errors, found.errors)
    x = np.linspace(0, 0.2, configuration.nodes[0])
    expected = fields(exact.plate, exact.drives["best"][None], run.times, x, x)[0]
    moved = np.linalg.norm(run.displacement[1] - expected) / np.linalg.norm(expected)
    assert found.displacement_errors[1] == pytest.approx(moved, rel=0.05)
    # The priced configuration follows from a convergence law.
    price = found.price
    computed = factors_of(regrid(panel, price.configuration), phasors[:2])
    assert np.abs(computed / list(exact.localization_factors.values()) - 1).max() < 1.5 * price.tolerance
    step = make_scheme(made).time_step
    assert price.cost == pytest.approx(
        cost_of_run(panel, price.configuration) / cost_of_run(panel, replace(configuration, time_step=step))
    )


def test_accurate_runs_have_no_price_and_plates_at_rest_no_error(panel, exact):
    phasors, factors = np.array(list(exact.drives.values())), np.array(list(exact.localization_factors.values()))
    accurate = estimate(panel, phasors, factors, "cpu")
    assert accurate.error < 1e-3
    assert accurate.price is None
    phasors = np.array([[0, 0, 0], [1, 0, 0]])
    found = estimate(panel, phasors, np.array([math.nan, 0.5]), "cpu")
    assert np.isnan(found.errors[0])
    assert found.error == found.errors[1] > 0
    assert np.isnan(estimate(panel, phasors[:1], np.array([math.nan]), "cpu").error)


def test_modes_are_chosen_where_they_keep_an_error(panel, exact):
    """A path or an evaluator that is named keeps its engine."""
    chosen = resolve(panel.with_accuracy(0.02), "cpu")
    assert (chosen.evaluator, chosen.scene.grid) == ("modal", Grid())
    assert chosen.accuracy["expected"] <= 0.01
    bound = ModalSolver(chosen.scene, "cpu").response.bound()
    assert bound == pytest.approx(exact.bound, rel=chosen.accuracy["expected"] + exact.uncertainty)
    for named in ({"evaluator": "direct"}, {"path": "resident"}):
        stepped = resolve(panel.with_accuracy(0.3), "cpu", **named)
        assert stepped.evaluator == "direct"
        assert stepped.scene.grid.time_step


STIFFENER = {"area": (0.06, 0.13, 0.05, 0.15), "thickness": 5e-4, "young_modulus": 5e9, "density": 1500.0}
MIXED = {
    "plain": {},
    "layer": {"effects": {"damping": {"viscous": 60.0}, "layers": [STIFFENER]}},
    "hysteretic": {"effects": {"loss_factor": {"eta": 0.003}}, "edges": {"left": "supported", "top": "free"}},
    "burst": {"drive": {"frequency": 310.0, "burst": {"start": 0.0, "duration": 0.02, "ramp": 0.004}}},
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "plain" else pytest.mark.slow) for name in MIXED]
)
def test_error_bars_of_modes_cover_what_more_functions_change(panel, name, random):
    scene = panel.with_tables(**MIXED[name])
    phasors = np.vstack([np.ones(3), random.normal(size=(2, 3)) + 1j * random.normal(size=(2, 3))])
    run = ModalSolver(scene, "cpu").run(phasors, [0.02, 0.03])
    factors = localization_factor(run.energy)
    found = estimate_modal(scene, phasors, run)
    plate, response = solve_response(scene, 2.0)
    errors = np.abs(factors / response.localization_factors(phasors) - 1)
    assert (errors <= found.errors).all()
    assert found.error < 0.02
    expected = fields(plate, phasors, run.times, *node_positions(scene))
    moved = np.linalg.norm((run.displacement - expected).reshape(3, -1), axis=1)
    assert (moved <= found.displacement_errors * np.linalg.norm(expected.reshape(3, -1), axis=1)).all()


def test_changes_of_other_drives_count_in_a_bar():
    """That of a single drive may be small by chance."""
    before, after = (Response(np.array([np.eye(4), np.diag([0.5, other, 0.5, other])])) for other in (0.3, 0.33))
    assert largest_change(np.array([[1, 0]]), after, [before]) == pytest.approx(1 - 0.8 / 0.83)


@pytest.mark.parametrize(("accuracy", "evaluator"), [(0.02, None), (None, "modal"), (None, "direct")])
def test_a_search_and_its_error_bar_solve_for_modes_twice(panel, monkeypatch, accuracy, evaluator):
    """The modes of the search and those of more functions; for time steps two for the reference."""
    calls = []
    monkeypatch.setattr(modes, "solve_eigenproblem", lambda *given: calls.append(given) or solve_eigenproblem(*given))
    scene = panel.with_tables(search={"iterations": 1, "particles": 4})
    scene = scene if accuracy is None else scene.with_accuracy(accuracy)
    result = localize(scene, device="cpu", evaluator=evaluator)
    assert len(calls) == 2
    assert result.accuracy["estimate"]["error"] > 0


def test_a_sweep_chooses_once_where_waves_are_shortest(panel):
    """The range's other end keeps the accuracy too; a grid that is varied is left to the points."""
    scene = panel.with_accuracy(0.2)
    plan = make_plan([parse_vary(scene, "drive.frequency=150,100,200")])
    gridded = resolve_for_sweep(scene, plan, "cpu", "direct")
    highest, lowest = (scene.with_values({"drive.frequency": value}) for value in (200.0, 100.0))
    assert gridded.grid.nodes == choose(highest, 0.2, "cpu").scene.grid.nodes
    phasors = np.eye(3, dtype=complex)
    found = factors_of(gridded.with_values({"drive.frequency": 100.0}), phasors)
    assert found == pytest.approx(solve_response(lowest, 1.0)[1].localization_factors(phasors), rel=0.2)
    assert resolve_for_sweep(scene, make_plan([parse_vary(scene, "grid.accuracy=0.1,0.2")]), "cpu", "direct") is scene
