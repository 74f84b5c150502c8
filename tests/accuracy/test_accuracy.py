"""What accuracy costs: the right answers, families, measured rows, fits, choices and error bars."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.accuracy import choose as choosing
from warp_plate.accuracy import configurations as family
from warp_plate.accuracy import fit, measure
from warp_plate.accuracy import formatting as text
from warp_plate.accuracy import grid_search as walk
from warp_plate.accuracy import reference_solution as truth
from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.configurations import Configuration
from warp_plate.accuracy.estimate import estimate
from warp_plate.accuracy.natural_frequencies import biharmonic, natural_frequencies
from warp_plate.accuracy.trial_runs import cost_of_run
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import localization_factor
from warp_plate.reference import series

OVERLAP = Configuration(2, "overlap", (27, 27), None, "float32")
MOMENTS = Configuration(4, "moments", (21, 21), None, "float32")


@pytest.fixture(scope="module")
def right(panel):
    """Its truth."""
    return truth.find_reference_solution(panel, "ritz", "cpu", 1e-5)


@pytest.fixture(scope="module")
def paper_truth():
    """Of the paper's scene, to a few parts in 10⁴."""
    return truth.find_reference_solution(Scene.load("paper"), "ritz", "cpu", 1e-3)


def test_numbers_for_people():
    assert [text.percent(value) for value in (0.00853, 0.01, 0.25, 3.2, 4e-7)] == [
        "0.85 %", "1 %", "25 %", "320 %", "4e-05 %",
    ]  # fmt: skip
    assert [text.seconds_text(value) for value in (0.0021, 12.3, 2.1e-5)] == ["2.1 ms", "12 s", "21 µs"]


def test_another_configuration_leaves_the_physics(scene):
    written = scene(damping=50.0, scheme="backward", size=(0.3, 0.2))
    made = family.scene_with(written, replace(MOMENTS, time_step=1e-5))
    assert family.configuration_of(made) == replace(MOMENTS, time_step=1e-5)
    assert made.effects.damping.scheme == "centred"
    assert made.effects.damping.viscous == 50.0
    kept = ("plate", "edges", "window", "drive", "target", "actuators", "search", "record")
    assert all(getattr(made, name) == getattr(written, name) for name in kept)


def test_a_grid_that_cannot_be_is_refused(panel):
    with pytest.raises(SceneError, match=r"^grid\.nodes[^\n]*$"):
        family.scene_with(panel, replace(MOMENTS, nodes=(7, 9)))
    assert family.highest_order(panel) == 4


@pytest.mark.parametrize("size", [(0.2, 0.2), (0.3, 0.1), (0.05, 0.4)])
@pytest.mark.parametrize("side", [13, 27, 105])
def test_cells_are_near_squares(size, side):
    nx, ny = family.nodes_for(size, side, 4)
    assert min(nx, ny) >= 9
    if min(nx, ny) > 9:
        assert size[0] / (nx - 1) == pytest.approx(size[1] / (ny - 1), rel=0.1)
        assert (nx - 1) * (ny - 1) == pytest.approx((side - 1) ** 2, rel=0.1)


@pytest.mark.parametrize("window", [(0.05, 0.1), (0.0, 0.02), (0.02, 0.03)])
def test_a_step_divides_the_run_and_what_is_before_the_window(scene, window):
    written = scene(window=window)
    step = family.fitted(written, 1.23e-4)
    assert 0.9 * 1.23e-4 < step <= 1.23e-4
    for span in window:
        assert span / step == pytest.approx(round(span / step), abs=1e-6)


def test_the_limit_is_the_schemes(scene):
    """A formula of its own, for the family is ordered before any scheme is made."""
    for order, load in family.LOAD_OF.items():
        made = family.scene_with(scene(size=(0.3, 0.2)), Configuration(order, load, (25, 15), None, "float64"))
        assert family.stability_limit(made, order, (25, 15)) == pytest.approx(make_scheme(made).limit, rel=1e-12)


def test_family_of_a_scene_that_fourth_order_does_not_know(panel):
    """Free edges, and two frequencies: grids of second order alone."""
    own = [{**one.model_dump(), "frequency": 100.0 + 50 * index} for index, one in enumerate(panel.actuators)]
    for made in (panel.with_tables(edges={"left": "free"}), panel.with_tables(actuators=own)):
        assert {one.order for one in family.make_configurations(made)} == {2}


def test_the_family_holds_what_is_to_be_shown(panel):
    made = family.make_configurations(panel)
    assert len(set(made)) == len(made)
    kinds = {(one.order, one.load, one.precision) for one in made}
    assert {(2, "nodes", "float32"), (2, "overlap", "float32"), (2, "overlap", "float64")} <= kinds
    assert {(4, "moments", "float32"), (4, "moments", "float64")} <= kinds
    for order in (2, 4):
        limit = family.stability_limit(panel, order, (27, 27))
        steps = sorted(one.time_step / limit for one in made if (one.order, one.nodes) == (order, (27, 27)))
        assert steps[-1] > 1
        assert steps[0] < 0.3 * steps[-2]
        assert any(0.4 < step / steps[-2] < 0.6 for step in steps)


@pytest.mark.parametrize(("order", "nodes"), [(2, (13, 11)), (4, (15, 13))])
def test_frequencies_of_a_supported_grid_are_exact(scene, order, nodes):
    """Sines are the modes of both orders: the second difference of sin(kx) is known in closed form."""
    written = scene(nodes, edges=("supported",) * 4, size=(0.2, 0.15))
    made = family.scene_with(written, Configuration(order, family.LOAD_OF[order], nodes, None, "float64"))
    scheme = make_scheme(made)

    def second_difference(count, spacing):
        angle = np.pi * np.arange(1, count - 1) / (count - 1)
        if order == 2:
            return (2 - 2 * np.cos(angle)) / spacing**2
        return (2 * np.cos(2 * angle) - 32 * np.cos(angle) + 30) / 12 / spacing**2

    along_x, along_y = (second_difference(*pair) for pair in zip(nodes, scheme.spacing, strict=True))
    right = np.sort((scheme.kappa * np.add.outer(along_x, along_y) / (2 * np.pi)).ravel())[:6]
    np.testing.assert_allclose(natural_frequencies(made, 6), right, rtol=1e-9)


def test_frequencies_of_a_clamped_grid_converge(scene):
    """Leissa's square clamped plate: ωa²/κ = 35.985, 73.394; errors fall as h⁴."""
    errors = []
    for nodes in (13, 25):
        made = family.scene_with(scene(), Configuration(4, "moments", (nodes, nodes), None, "float64"))
        found = natural_frequencies(made, 3) * 2 * np.pi * 0.2**2 / make_scheme(made).kappa
        errors.append(abs(found[[0, 1]] / [35.9852, 73.3938] - 1))
    assert (errors[1] < 1e-3).all()
    assert (errors[0] / errors[1] > 8).all()


def test_the_operator_is_symmetric(scene):
    for configuration in (OVERLAP, MOMENTS):
        made = family.scene_with(scene(size=(0.3, 0.2), edges=("clamped", "supported") * 2), configuration)
        matrix = biharmonic(made)
        assert abs(matrix - matrix.T).max() < 1e-12 * abs(matrix).max()


@pytest.mark.slow
def test_ritz_agrees_with_the_series(panel):
    """Energies of the exact modes of a supported plate, summed in another way."""
    found = truth.find_reference_solution(panel, "ritz", "cpu", 1e-4)
    for name, drive in found.drives.items():
        plate, target = series.kinetic_energies(panel, drive, 32)
        assert found.localization_factors[name] == pytest.approx(target / plate, rel=3e-4 + found.uncertainty)
    assert found.uncertainty < 1e-4
    assert found.bound == pytest.approx(found.localization_factors["best"], rel=1e-9)
    lowest = np.pi / 2 * make_scheme(panel).kappa * 2 / 0.2**2
    assert found.frequencies[0] == pytest.approx(lowest, rel=1e-6)
    x = np.linspace(0, 0.2, 9)
    right = series.displacement(panel, found.drives["best"], [0.02, 0.03], x, x, 32)
    np.testing.assert_allclose(found.displacement([0.02, 0.03], x, x), right, atol=2e-3 * abs(right).max())


def test_richardson_agrees_with_ritz_within_its_error(panel, right, monkeypatch):
    monkeypatch.setattr(truth, "PATH", "streaming")
    ritz = right
    grids = truth.find_reference_solution(panel, "richardson", "cpu", 3e-2, 1e-3)
    assert grids.kind == "richardson"
    assert 0 < grids.uncertainty < 0.05
    for name, factor in grids.localization_factors.items():
        assert factor == pytest.approx(ritz.localization_factors[name], rel=grids.uncertainty)
    assert grids.bound == pytest.approx(ritz.bound, rel=grids.uncertainty)
    np.testing.assert_allclose(grids.frequencies, ritz.frequencies, rtol=1e-3)
    x = np.linspace(0, 0.2, 12)
    shown, wanted = (found.displacement([0.02, 0.03], x, x) for found in (grids, ritz))
    drift = abs(grids.drives["best"] - ritz.drives["best"]).max()
    np.testing.assert_allclose(shown, wanted, atol=(0.03 + drift) * abs(wanted).max())


def test_uncertainty_covers_the_change_to_more_functions(panel, right):
    rough = truth.find_reference_solution(panel, "ritz", "cpu", 1e-2)
    assert rough.uncertainty > right.uncertainty
    assert abs(rough.bound / right.bound - 1) < rough.uncertainty


def test_an_undamped_resonance_has_no_ritz_reference(panel, right, monkeypatch):
    """Its modes would cancel out, to energies below zero."""
    monkeypatch.setattr(truth, "PATH", "streaming")
    own = right.frequencies[0]
    tuned = panel.model_copy(
        update={
            "effects": panel.effects.model_copy(update={"damping": None}),
            "drive": panel.drive.model_copy(update={"frequency": float(own)}),
        }
    )
    found = truth.find_reference_solution(tuned, "auto", "cpu", 3e-2, 1e-3)
    assert found.kind == "richardson"
    assert 0 < found.localization_factors["single"] < found.bound <= 1
    with pytest.raises(ValueError, match=r"drive\.frequency"):
        truth.find_reference_solution(tuned, "ritz", "cpu", 3e-2)


def test_a_row_agrees_with_a_run(paper_truth):
    scene = Scene.load("paper")
    row = measure.measure(measure.Bench(scene, paper_truth, "cpu"), MOMENTS)
    run = PlateSolver(family.scene_with(scene, MOMENTS), "cpu").run(np.array([paper_truth.drives["single"]]))
    assert row.status == "ok"
    assert row.localization_factor == pytest.approx(localization_factor(run.energy)[0], rel=1e-6)
    assert row.error == max(row.error_single, row.error_best, row.error_bound)
    assert 0.005 < row.error < 0.03
    assert row.error_displacement < 0.1
    assert row.error_frequencies < 2e-3
    assert row.seconds_per_plate > 0
    assert row.plates == scene.search.particles


def test_what_fails_stays_a_row(paper_truth, monkeypatch):
    bench = measure.Bench(Scene.load("paper"), paper_truth, "cpu")
    refused = measure.measure(bench, replace(OVERLAP, time_step=1e-4))
    assert refused.status.startswith("refused: grid.time_step")
    skipped = measure.measure(bench, replace(OVERLAP, nodes=(105, 105)), 0.01)
    assert skipped.status.startswith("skipped: would take")
    written = measure.measure(bench, None)
    assert (written.as_written, written.damping, written.load) == (True, "backward", "nodes")

    class Wild(PlateSolver):
        def run(self, drives, times=(), points=(), progress=None):
            return replace(super().run(drives, times), energy=np.full((len(drives), 2), np.nan))

    monkeypatch.setattr(measure, "PlateSolver", Wild)
    unstable = measure.measure(bench, OVERLAP)
    assert (unstable.status, unstable.error) == ("unstable", None)


def test_large_grids_go_without_the_bound(paper_truth):
    bench = measure.Bench(Scene.load("paper"), paper_truth, "cpu", start_seconds=0.0)
    row = measure.measure(bench, OVERLAP, 0.02)
    assert (row.status, row.bound, row.error_bound) == ("ok", None, None)
    assert row.error == max(row.error_single, row.error_best)


def made_row(side, error, seconds, **changes):
    """A measured row of a square plate of one metre."""
    usual = measure.AccuracyRow(
        4, "moments", (side, side), 1 / side**2, "float64", None, 1 / (side - 1), False, "ok",
        error=error, error_displacement=error, error_frequencies=error, seconds_per_plate=seconds,
    )  # fmt: skip
    return replace(usual, **changes)


def test_laws_are_found_again():
    rows = [made_row(side, 30 / (side - 1) ** 4, 1e-9 * (side - 1) ** 3.7) for side in (9, 17, 33, 65)]
    rows += [made_row(17, 0.2, 1.0, time_step=1e-9), made_row(129, 1.0, 9.0, as_written=True)]
    rows += [made_row(129, None, None, status="refused: so")]
    law = fit.fit_laws(rows, 1e-9)[0]
    assert law.order == pytest.approx(4)
    assert law.order_frequencies == pytest.approx(4)
    assert law.cost_exponent == pytest.approx(3.7)
    assert fit.fit_laws(rows, 1e-2)[0].order is None


def test_front_and_recommendations():
    rows = [
        made_row(9, 0.2, 1.0),
        made_row(13, 0.05, 2.0),
        made_row(13, 0.06, 3.0),
        made_row(17, 0.008, 4.0),
        made_row(33, None, None, status="skipped: so"),
    ]
    assert fit.pareto_front(rows) == [0, 1, 3]
    # A coarse grid that is right by chance is not recommended, for a finer one is not; nor is a gain of nothing a gain.
    assert fit.recommend([*rows, made_row(10, 0.001, 1.5)], 0.003, 100)[1].row == 3
    assert fit.pareto_front([*rows, made_row(18, 0.00795, 5.0)]) == [0, 1, 3]
    found = fit.recommend(rows, 0.003, 100)
    assert [(one.tolerance, one.row, one.seconds) for one in found] == [
        (0.1, 1, 200.0), (0.03, 3, 400.0), (0.01, None, None), (0.003, None, None), (0.001, None, None),
    ]  # fmt: skip


@pytest.mark.slow
def test_finer_is_chosen_for_less_error(panel):
    coarse, fine = (choose(panel, accuracy, "cpu") for accuracy in (0.03, 0.003))
    for asked, choice in ((0.03, coarse), (0.003, fine)):
        assert choice.error <= asked
        assert choice.scene.grid.accuracy is None
        assert choice.scene.grid.time_step < make_scheme(choice.scene).limit
        assert f"{text.percent(asked)}: {choice.scene.grid.nodes[0]} × " in choice.reason
        assert f"order {choice.scene.grid.order}, {choice.scene.grid.load}" in choice.reason
    assert np.prod(fine.scene.grid.nodes) > np.prod(coarse.scene.grid.nodes)


@pytest.mark.slow
def test_choosing_is_repeatable(panel):
    first, second = (choose(panel, 0.02, "cpu") for _ in range(2))
    assert first.scene == second.scene
    assert first.error == second.error


def test_what_is_out_of_reach_is_refused(panel, monkeypatch):
    monkeypatch.setattr(walk, "MOST_NODE_STEPS", 1e4)
    with pytest.raises(SceneError, match=r"^accuracy = 0\.003: out of reach[^\n]*$"):
        choose(panel, 0.003, "cpu")


def test_an_unsure_reference_is_refused(panel, monkeypatch):
    monkeypatch.setattr(choosing, "REFERENCE_SECONDS", 0.0)
    with pytest.raises(SceneError, match=r"^accuracy = 1e-09: the reference solution[^\n]*$"):
        choose(panel, 1e-9, "cpu")


def test_what_an_unsure_reference_allows_is_rounded_up(panel, monkeypatch):
    monkeypatch.setattr(choosing, "find_reference_solution", lambda *_: SimpleNamespace(uncertainty=0.0523))
    with pytest.raises(SceneError, match=r"is known to 0\.052 only; ask for 0\.11 or more$"):
        choose(panel, 0.05, "cpu")


def test_chance_does_not_count(panel, monkeypatch):
    """A grid that is right while finer ones are wrong is not taken."""
    found = truth.find_reference_solution(panel, "ritz", "cpu", 1e-2)
    aim = walk.Aim(panel, found, 0.01, "cpu")

    def lucky_at_15(scene, configuration, drives, factors, device):
        nodes = configuration.nodes[0]
        error = 0.001 if nodes == 15 else 0.3 * (12 / (nodes - 1)) ** 4
        return walk.Trial(configuration, error, cost_of_run(scene, configuration))

    monkeypatch.setattr(walk, "try_out", lucky_at_15)
    assert walk.cheapest(aim, 4, "float32", 15).configuration.nodes == (15, 15)
    taken = walk.confirmed(aim, 4, "float32", 15)
    assert taken.error <= 0.01
    law = 1 + 12 * (0.3 / 0.01) ** 0.25
    assert law <= taken.configuration.nodes[0] <= 1.1 * law


@pytest.mark.parametrize("configuration", [OVERLAP, replace(OVERLAP, load="nodes"), MOMENTS], ids=str)
def test_the_error_bar_holds_the_right_answer(panel, right, configuration):
    made = family.scene_with(panel, configuration)
    drives = np.array([*right.drives.values(), np.ones(3)])
    factors = localization_factor(PlateSolver(made, "cpu").run(drives).energy)
    found = estimate(made, drives, factors, 1.0, "cpu")
    wrong = np.abs(factors[:2] / list(right.localization_factors.values()) - 1)
    assert (wrong <= found.errors[:2]).all()
    assert (found.errors[:2] <= wrong + 2 * found.uncertainty).all()
    assert found.error == found.errors.max()
    assert found.price is not None
    assert f"{configuration.nodes[0]} × {configuration.nodes[1]}, order {configuration.order}" in found.line(0)
    assert " ± " in found.line(0)
    again = estimate(made, drives, factors, 1.0, "cpu")
    np.testing.assert_array_equal(again.errors, found.errors)


def test_the_price_is_kept(panel, right):
    """The configuration that is named keeps its tolerance, or nearly so, for it comes from a law."""
    made = family.scene_with(panel, OVERLAP)
    drives = np.array(list(right.drives.values()))
    factors = localization_factor(PlateSolver(made, "cpu").run(drives).energy)
    price = estimate(made, drives, factors, 1.0, "cpu").price
    better = family.scene_with(panel, price.configuration)
    found = localization_factor(PlateSolver(better, "cpu").run(drives).energy)
    assert np.abs(found / list(right.localization_factors.values()) - 1).max() < 1.5 * price.tolerance
    assert price.cost == pytest.approx(
        cost_of_run(panel, price.configuration)
        / cost_of_run(panel, replace(OVERLAP, time_step=make_scheme(made).time_step))
    )


def test_what_is_exact_has_no_price(panel, right):
    drives = np.array(list(right.drives.values()))
    found = estimate(panel, drives, np.array(list(right.localization_factors.values())), 10.0, "cpu")
    assert found.error < 1e-3
    assert found.price is None
    assert "costs" not in found.line()


def test_a_plate_at_rest_has_no_error(panel):
    drives = np.array([[0, 0, 0], [1, 0, 0]])
    found = estimate(panel, drives, np.array([math.nan, 0.5]), 0.1, "cpu")
    assert np.isnan(found.errors[0])
    assert np.isfinite(found.errors[1])
    assert found.error == found.errors[1]
    nothing = estimate(panel, drives[:1], np.array([math.nan]), 0.1, "cpu")
    assert np.isnan(nothing.error)
    assert "no error estimate" in nothing.line()
