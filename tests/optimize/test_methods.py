"""All methods: known minima and exact bounds, limits and periods, budgets, states to the last bit, scales of losses."""

import json
import math
from functools import cache

import h5py
import numpy as np
import pytest
import scipy.linalg

from support.scenes import scene_of
from warp_plate import SceneError
from warp_plate.optimize.optimizer import SearchSpace, minimize
from warp_plate.problem.methods import READ_BY, make_optimizer, unread_keys
from warp_plate.problem.problem import make_problem
from warp_plate.quantities.region_quantities import PLATE, TARGET
from warp_plate.resolve import resolve
from warp_plate.result.layouts import SearchState
from warp_plate.scene.search import Search

TWO_PI = 2 * math.pi
SAMPLING = ("pso", "constriction", "ring", "cma")
ALL = (*SAMPLING, "gradient", "exact")


def make_space(lower, upper, initial, period):
    names = tuple(f"number {index}" for index in range(len(lower)))
    return SearchSpace(names, *(np.array(each, float) for each in (lower, upper, *np.transpose(initial), period)))


@cache
def made_problem(search):
    scene = scene_of((9, 9), damping=88.5, search=json.loads(search))
    return make_problem(resolve(scene, "cpu", evaluator="response", purpose="search"))


def space_and_problem(**search):
    """Return the space and the problem of a search for drives of a small panel with three actuators."""
    made = made_problem(json.dumps(search))
    return made.space, made.quadratic


def ranges(low, high, **search):
    """Return a search for all magnitudes in a range and all phases."""
    return space_and_problem(magnitude={"range": [low, high]}, phase={}, **search)


def bound_of(problem, held=False):
    """Return the largest ratio of all drives, or of those with the first phase 0: without the fourth number, Im Z₁."""
    matrices = np.delete(np.delete(problem.matrices, 3, axis=1), 3, axis=2) if held else problem.matrices
    return scipy.linalg.eigh(matrices[TARGET], matrices[PLATE], eigvals_only=True)[-1]


def draw(space, count, seed=0):
    return space.from_unit(np.random.default_rng(seed).random((count, space.dimension)))


def case(method, **keys):
    """Return (search, space, problem), small ones that the method can run."""
    return Search(method=method, **{"particles": 8, "iterations": 14, **keys}), *ranges(0.0, 2.0)


class Read:
    """A table ``[search]`` that keeps the names of what is read in it."""

    def __init__(self, search):
        self._search, self.names = search, set()

    def __getattr__(self, name):
        self.names.add(name)
        return getattr(self._search, name)


@pytest.mark.parametrize("method", ALL)
def test_keys_that_a_method_does_not_read_are_named(method):
    """And no key but those that the table of methods has; a key with its default need not have been written."""
    search, space, problem = case(method, restarts=2, velocity_limit=1.0, inertia=0.3)
    read = Read(search)
    make_optimizer(read, space, 1, problem)
    assert {key for key in READ_BY if key in read.names} == {key for key in READ_BY if method in READ_BY[key]}
    assert read.names <= {"method", "seed", "objectives", *READ_BY}
    changed = {"particles", "iterations", "restarts", "velocity_limit", "inertia"}
    lines = unread_keys(search)
    assert {line.split(" ")[0] for line in lines} == {f"search.{key}" for key in changed - read.names}
    assert all(f"method = '{method}' does not read it" in line for line in lines)


@pytest.mark.parametrize("tables", [{}, {"method": "gradient"}])
@pytest.mark.parametrize(("method", "tolerance"), [("exact", 1e-10), ("gradient", 1e-10), ("cma", 1e-6), ("pso", 1e-2)])
def test_the_bound_is_reached(method, tolerance, tables):
    """1 − the largest λ of A z = λ B z; for the gradient and CMA-ES to 1e-6, as is promised."""
    space, problem = space_and_problem(**tables)
    optimizer = make_optimizer(Search(method=method, particles=20, iterations=150), space, 3, problem)
    result = minimize(optimizer, problem.losses)
    assert 1 - result.fbest == pytest.approx(bound_of(problem, held=not tables), abs=tolerance)
    np.testing.assert_array_equal(problem.losses(result.xbest[None]), result.fbest)
    assert result.evaluations <= 20 * 150


FREE, REST = {"magnitude": {"range": [0.0, 2.0]}, "phase": {}}, {"kind": "velocity", "rest_limit": 2e-4}


@pytest.mark.parametrize(
    "search",
    [
        {"magnitude": {"range": [0.9, 1.0]}, "phase": {}},
        {"phase": {}, "limits": {"equal_magnitudes": True}},
        {**FREE, "objectives": [{"kind": "contrast"}], "limits": {"power": 1.0}},
        {"magnitude": {"range": [0.9, 1.0]}, "phase": {}, "objectives": [{"kind": "velocity"}]},
        {**FREE, "objectives": [REST]},
        {"objectives": [REST], "limits": {"power": 3.0}},
        {**FREE, "objectives": [{"kind": "displacement", "rest_limit": 1e-7}], "limits": {"magnitude": 1.5}},
    ],
)
def test_attained_bounds_are_attained_within_limits(search):
    """By the exact method and by descents, which stop before a rest_limit unless they begin at the best drive."""
    problem = made_problem(json.dumps(search))
    bound = problem.loss_bound
    assert bound.kind == "attained"
    for method in ("exact", "gradient"):
        optimizer = make_optimizer(Search(method=method, iterations=5), problem.space, 0, problem.quadratic)
        result = minimize(optimizer, problem.losses)
        assert result.fbest == pytest.approx(bound.value, rel=1e-6)
        assert result.fbest >= bound.value
        values = problem.objective_values(result.xbest)
        assert all(values[name] <= limit for name, limit in problem.objectives.limits.items())


def test_slopes_are_differences_of_the_loss():
    """The loss adds a ratio, a root and a logarithm of energies, of drives that a limit cuts."""
    terms = [{"kind": "localization"}, {"kind": "velocity", "weight": 1e3}, {"kind": "contrast", "weight": 0.1}]
    space, problem = ranges(0.5, 2.0, objectives=terms, limits={"magnitude": 1.5})
    positions = draw(space, 5, 1)
    losses, slopes = problem.losses_and_slopes(positions, space)
    np.testing.assert_allclose(losses, problem.losses(positions), rtol=1e-12)
    for column, step in enumerate(1e-5 * np.eye(space.dimension)):
        differences = (problem.losses(positions + step) - problem.losses(positions - step)) / 2e-5
        np.testing.assert_allclose(slopes[:, column], differences, atol=1e-7)


def test_descents_stop_at_limits_that_bind():
    """Every magnitude within 0.8 ... 1, against SciPy's L-BFGS-B from many places."""
    space, problem = ranges(0.8, 1.0)
    ends = list(zip(space.lower, space.upper, strict=True))
    best = min(
        scipy.optimize.minimize(lambda x: problem.losses(x[None])[0], start, method="L-BFGS-B", bounds=ends).fun
        for start in draw(space, 4)
    )
    result = minimize(make_optimizer(Search(method="gradient"), space, 0, problem), problem.losses)
    assert result.fbest == pytest.approx(best, abs=1e-8)
    assert result.fbest > 1 - bound_of(problem) + 1e-3


@pytest.mark.parametrize("method", SAMPLING)
def test_known_minima(method):
    """A sphere; a single number, within its limits and at one; and many valleys, the lowest where the period is cut."""

    def best(space, objective, particles=40):
        optimizer = make_optimizer(Search(method=method, particles=particles, iterations=150), space, 5)
        return minimize(optimizer, objective).xbest

    unlimited = make_space([-np.inf] * 4, [np.inf] * 4, [(-2, 2)] * 4, [np.inf] * 4)
    np.testing.assert_allclose(best(unlimited, lambda x: np.sum((x - 0.5) ** 2, axis=1)), 0.5, atol=1e-3)
    alone = make_space([1.0], [9.0], [(1.0, 9.0)], [np.inf])
    for least in (3.0, 0.0):
        found = best(alone, lambda x, least=least: (x[:, 0] - least) ** 2, 10)
        np.testing.assert_allclose(found, [max(least, 1.0)], atol=1e-3)
    ring = make_space([-np.inf] * 3, [np.inf] * 3, [(0, TWO_PI)] * 3, [TWO_PI] * 3)
    found = best(ring, lambda x: np.sum(1.5 - np.cos(x) - 0.5 * np.cos(3 * x), axis=1))
    np.testing.assert_allclose(np.minimum(found, TWO_PI - found), 0, atol=0.02)


@pytest.mark.parametrize("method", ALL)
def test_stopped_anywhere_goes_on_to_the_same_bits(method, tmp_path):
    """After every iteration, and between ask and tell, through a file; with losses that are not finite. The seed alone
    decides, whatever NumPy's global generator does."""
    search, space, problem = case(method, restarts=2, stall=3, iterations=12)

    def objective(positions):
        losses = problem.losses(positions)
        return losses if method == "exact" else np.where(positions[:, 0] > 1.7, np.nan, losses)

    def reloaded(optimizer):
        with h5py.File(tmp_path / "state.h5", "w") as file:
            SearchState().write(file, "search", optimizer.state())
        with h5py.File(tmp_path / "state.h5") as file:
            return make_optimizer(search, space, 6, problem, SearchState().read(file, "search", {}))

    whole, broken, other = (make_optimizer(search, space, seed, problem) for seed in (6, 6, 7))
    assert method == "exact" or not np.isin(other.ask(), whole.ask()).any()
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    while not whole.stop():
        assert not broken.stop()
        broken = reloaded(broken)
        asked = whole.ask()
        np.testing.assert_array_equal(broken.ask(), asked)
        broken = reloaded(broken)
        np.testing.assert_array_equal(broken.ask(), asked)
        for optimizer in (whole, broken):
            optimizer.tell(asked, objective(asked))
        np.testing.assert_equal(broken.state(), whole.state())
    assert broken.stop() == whole.stop()
    np.testing.assert_equal(broken.history, whole.history)
    assert np.array_equal(broken.result.xbest, whole.result.xbest)
    assert len(whole.state()["history"]) == whole.iterations == len(whole.history["best"])
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


@pytest.mark.parametrize("method", ALL)
def test_budget_history_and_what_may_be_told(method):
    search, space, problem = case(method, restarts=3)
    optimizer, count = make_optimizer(search, space, 0, problem), 0
    assert optimizer.iterations == optimizer.result.evaluations == 0
    assert optimizer.result.xbest is None
    with pytest.raises(ValueError, match="the last ask"):
        optimizer.tell(optimizer.positions, np.zeros(len(optimizer.positions)))
    while not optimizer.stop():
        positions = optimizer.ask()
        losses = problem.losses(positions)
        with pytest.raises(ValueError, match="the last ask"):
            optimizer.tell(positions + 1, losses)
        with pytest.raises(ValueError, match=r"losses of shape \(\d+, 2\)"):
            optimizer.tell(positions, np.zeros((len(positions), 2)))
        optimizer.tell(positions.tolist(), losses)
        with pytest.raises(ValueError, match="told once"):
            optimizer.tell(positions, losses)
        count += len(positions)
        assert optimizer.result.evaluations == optimizer.history["evaluations"][-1] == count
    assert 0 < count <= search.particles * search.iterations
    best = optimizer.history["best"]
    assert np.all(np.diff(best) <= 0)
    assert best[-1] == optimizer.result.fbest == problem.losses(optimizer.result.xbest[None])[0]


@pytest.mark.parametrize("method", ["pso", "ring", "cma", "gradient"])
@pytest.mark.parametrize(("low", "high", "restarts"), [(1.0, 1.001, 0), (0.0, 5.0, 2), (1.0, 3.0, 1)])
def test_limits_and_periods_hold_for_any_loss(random, method, low, high, restarts):
    space, problem = ranges(low, high)
    optimizer = make_optimizer(Search(method=method, particles=6, iterations=12, restarts=restarts), space, 5, problem)
    while not optimizer.stop():
        positions = optimizer.ask()
        assert np.all((positions[:, :3] >= low) & (positions[:, :3] <= high))
        assert np.all((positions[:, 3:] >= 0) & (positions[:, 3:] <= TWO_PI))
        losses = random.normal(size=len(positions))
        losses[random.random(len(positions)) < 0.3] = np.nan
        optimizer.tell(positions, losses)


@pytest.mark.parametrize("method", ALL)
def test_a_state_of_another_search_is_refused(method):
    search, space, problem = case(method)
    optimizer = make_optimizer(search, space, 0, problem)
    for _ in range(1 if method == "exact" else 3):
        optimizer.tell(optimizer.ask(), problem.losses(optimizer.positions))
    state = optimizer.state()
    key = {"cma": "losses", "exact": "history"}.get(method, "random")
    wrong = [{}, {**state, "format": "another"}, {**state, "positions": [[0.0]]}]
    wrong += [{name: value for name, value in state.items() if name != key}]
    wrong += [{**state, "losses": state["losses"][::-1]}] if method == "cma" else []
    wrong += [{**state, "velocities": state["velocities"][1:]}] if method == "pso" else []
    for changed in wrong:
        with pytest.raises(ValueError, match=r"^search state: ") as refusal:
            make_optimizer(search, space, 0, problem, changed)
        assert "\n" not in str(refusal.value)


def test_a_power_limit_is_met_by_scaling():
    space, problem = ranges(0.0, 5.0, limits={"power": 1.0})
    result = minimize(make_optimizer(Search(method="exact"), space, 0, problem), problem.losses)
    assert 1 - result.fbest == pytest.approx(bound_of(problem), abs=1e-10)
    assert result.xbest[:3].max() == pytest.approx(5.0)


def test_what_a_method_cannot_search_names_another():
    space, _ = ranges(0.9, 1.0)
    for method, problem, words in (
        ("exact", ranges(0.9, 1.0, objectives=[{}, {"kind": "velocity"}])[1], "reach the bound; write 'gradient'"),
        ("exact", None, "quadratic forms.*write 'cma'"),
        ("gradient", None, "slopes of energies.*write 'cma'"),
    ):
        with pytest.raises(SceneError, match=rf"^search\.method = '{method}': .*{words}"):
            make_optimizer(Search(method=method), space, 0, problem)


def search_for_displacements(weight, rest_limit, keys):
    """Return all positions and losses of a search for displacements of about 5e-8 m, and why it stopped."""
    objective = {"kind": "displacement", "weight": weight, "rest_limit": rest_limit}
    space, problem = ranges(0.0, 0.1, objectives=[objective])
    settings = {"particles": 8, "iterations": 150, "objectives": [objective], **keys}
    optimizer = make_optimizer(Search(**settings), space, 1, problem)
    asked, losses = [], []
    while not optimizer.stop():
        asked.append(optimizer.ask())
        losses.append(problem.losses(asked[-1]))
        losses[-1][0] = np.nan if len(asked) % 5 == 0 else losses[-1][0]
        optimizer.tell(asked[-1], losses[-1])
    return np.concatenate(asked), np.concatenate(losses), optimizer.stop()


@pytest.mark.parametrize(
    ("rest_limit", "keys"),
    [
        (2e-8, {"method": "pso", "stall": 5, "restarts": 2}),
        (None, {"method": "ring", "stall": 5}),
        (2e-8, {"method": "cma", "restarts": 1, "iterations": 200}),
        (None, {"method": "cma", "stall": 5}),
        (None, {"method": "gradient", "particles": 4, "stall": 3, "restarts": 1}),
    ],
)
def test_a_weight_changes_no_position(rest_limit, keys):
    """A power of two leaves every digit of a loss: the same positions, however small losses are."""
    positions, losses, reasons = search_for_displacements(1.0, rest_limit, keys)
    assert -1e-6 < np.nanmin(losses) < 0
    assert not {"iterations", "evaluations"} & reasons.keys() or "restarts" in keys  # it converges
    others, weighted, last = search_for_displacements(2.0**30, rest_limit, keys)
    np.testing.assert_array_equal(others, positions)
    within = losses < 0  # beyond a rest_limit losses are parts of that limit, without a weight
    np.testing.assert_array_equal(weighted[within], 2.0**30 * losses[within])
    assert last.keys() == reasons.keys()
