"""Every method in the one shape: known minima and exact bounds, limits and periods, budgets, states to the last bit."""

import json
import math
import sys

import h5py
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_plate import SceneError
from warp_plate.optimize.pso import optimize
from warp_plate.optimize.quadratic import Quadratic
from warp_plate.optimize.space import Space
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.methods import READ_BY, make_optimizer, optimizer_from_state, unread_keys
from warp_plate.problem.parametrization import paper_phasors
from warp_plate.result.hdf5 import SearchState
from warp_plate.scene.search import Search

TURN = 2 * math.pi
SWARMS = ("pso", "constriction", "ring")
SAMPLING = (*SWARMS, "cma")
ALL = (*SAMPLING, "gradient", "exact")


def make_space(lower, upper, first, period):
    dimension = len(lower)
    low, high = np.transpose(first).astype(float)
    names = tuple(f"number {index}" for index in range(dimension))
    return Space(names, np.array(lower, float), np.array(upper, float), low, high, np.array(period, float))


def line(dimension):
    """Numbers without limits, first drawn from −2 ... 2, as in the source paper."""
    infinite = np.full(dimension, np.inf)
    return make_space(-infinite, infinite, [(-2, 2)] * dimension, infinite)


def magnitudes_and_phases(actuators, low=0.0, high=2.0):
    infinite = [np.inf] * actuators
    return make_space(
        [low] * actuators + [-np.inf] * actuators,
        [high] * actuators + infinite,
        [(low, high)] * actuators + [(0, TURN)] * actuators,
        infinite + [TURN] * actuators,
    )


def gram_matrices(actuators=4, seed=4):
    """Energies of plate and target, (2, 2M, 2M), of a steady vibration: a phase common to all changes nothing."""
    random = np.random.default_rng(seed)

    def gram(points):
        shape = (points, actuators)
        response = random.normal(size=shape) + 1j * random.normal(size=shape)
        product = response.conj().T @ response
        return np.block([[product.real, -product.imag], [product.imag, product.real]])

    target = gram(actuators + 2)
    return np.array([target + gram(4 * actuators), target])


def localization(energy):
    return 1 - localization_factor(energy)


def quadratic(space, matrices, losses_of=localization, limit=None):
    """Magnitudes, then phases, of all actuators, or with as many numbers as the source paper all but the first's."""
    actuators = matrices.shape[1] // 2
    whole = space.dimension == 2 * actuators

    def drives(positions):
        if not whole:
            return paper_phasors(positions)
        found = positions[:, :actuators] * np.exp(-1j * positions[:, actuators:])
        return found if limit is None else limit(found)

    def positions(drives):
        if not whole:
            drives = (drives / drives[:, :1])[:, 1:]
        columns = np.concatenate([np.abs(drives), np.mod(-np.angle(drives), TURN)], axis=1)
        return np.clip(columns, space.lower, space.upper)

    return Quadratic(matrices, drives, positions, losses_of, losses_of is localization)


def bound_of(matrices):
    return scipy.linalg.eigh(matrices[1], matrices[0], eigvals_only=True)[-1]


def sphere(positions):
    return np.sum((positions - 0.5) ** 2, axis=1)


def hills_in_a_ring(positions):
    """Rastrigin's hills on numbers that wrap at 2π: the lowest of many valleys is where the period is cut, at 0."""
    return np.sum(1.5 - np.cos(positions) - 0.5 * np.cos(3 * positions), axis=1)


def case(method, **keys):
    """(search, space, problem, objective): a small one that the method can run."""
    space, matrices = magnitudes_and_phases(3), gram_matrices(3)
    problem = quadratic(space, matrices)
    keys = {"particles": 8, "iterations": 14} | keys
    return Search(method=method, **keys), space, problem, problem.losses


def text(searcher):
    return json.dumps(searcher.state(), sort_keys=True, allow_nan=False)


class Read:
    """A table ``[search]`` that keeps the names of what is read in it."""

    def __init__(self, search):
        self._search, self.names = search, set()

    def __getattr__(self, name):
        self.names.add(name)
        return getattr(self._search, name)


@pytest.mark.parametrize("method", ALL)
def test_what_a_method_does_not_read_is_told(method):
    """And no key but those that the table of methods knows; a key as the default has it need not have been written."""
    search, space, problem, _ = case(method, restarts=2, velocity_limit=1.0, inertia=0.3)
    read = Read(search)
    make_optimizer(read, space, 1, problem)
    assert {key for key in READ_BY if key in read.names} == {key for key in READ_BY if method in READ_BY[key]}
    assert read.names <= {"method", "seed", "objectives", *READ_BY}
    changed = {"particles", "iterations", "restarts", "velocity_limit", "inertia"}
    lines = unread_keys(search)
    assert {line.split(" ")[0] for line in lines} == {f"search.{key}" for key in changed - read.names}
    assert all(f"method = '{method}' does not read it" in line for line in lines)


# What is known ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("actuators", [2, 4])
@pytest.mark.parametrize("free", ["all", "all but the first"])
@pytest.mark.parametrize("method", ["exact", "gradient", "cma"])
def test_the_bound_is_reached(method, free, actuators):
    """1 − the largest λ of A z = λ B z; for the gradient and CMA-ES to 1e-6, as is promised."""
    space = magnitudes_and_phases(actuators) if free == "all" else line(2 * actuators - 2)
    matrices = gram_matrices(actuators)
    problem = quadratic(space, matrices)
    searcher = make_optimizer(Search(method=method, particles=20, iterations=150), space, 3, problem)
    result = optimize(searcher, problem.losses)
    assert 1 - result.fbest == pytest.approx(bound_of(matrices), abs=1e-6 if method == "cma" else 1e-10)
    np.testing.assert_array_equal(problem.losses(result.xbest[None]), result.fbest)
    assert result.evaluations <= 20 * 150


def test_the_gradient_s_slopes():
    """Against differences of the whole loss, for one that adds a ratio, a root and a logarithm of energies."""
    space, matrices = magnitudes_and_phases(3), gram_matrices(3)

    def losses_of(energy):
        return np.sqrt(energy[:, 0]) - 2 * np.log10(energy[:, 1]) + energy[:, 1] / energy[:, 0]

    problem = quadratic(space, matrices, losses_of, lambda drives: drives / np.maximum(np.abs(drives), 1.5))
    positions = space.initial_lower + (space.initial_upper - space.initial_lower) * np.random.default_rng(1).random(
        (5, 6)
    )
    _, slopes = problem.losses_and_slopes(positions, np.ones(6), space.lower, space.upper)
    for column in range(6):
        step = 1e-5 * np.eye(6)[column]
        differences = (problem.losses(positions + step) - problem.losses(positions - step)) / 2e-5
        np.testing.assert_allclose(slopes[:, column], differences, atol=1e-7)


def test_the_gradient_stops_at_limits_that_bind():
    """max of |z|ᵀ with every magnitude within 0.5 ... 1: against SciPy's L-BFGS-B from many places."""
    space, matrices = magnitudes_and_phases(3, 0.5, 1.0), gram_matrices(3, seed=11)
    problem = quadratic(space, matrices)
    ends = list(zip(space.lower, space.upper, strict=True))
    starts = space.initial_lower + (space.initial_upper - space.initial_lower) * np.random.default_rng(0).random(
        (12, 6)
    )
    best = min(
        scipy.optimize.minimize(lambda x: problem.losses(x[None])[0], one, method="L-BFGS-B", bounds=ends).fun
        for one in starts
    )
    result = optimize(make_optimizer(Search(method="gradient"), space, 0, problem), problem.losses)
    assert result.fbest == pytest.approx(best, abs=1e-8)
    assert np.isclose(result.xbest[:3], space.lower[:3]).any() or np.isclose(result.xbest[:3], 1.0).any()
    assert result.fbest > 1 - bound_of(matrices) + 1e-3


@pytest.mark.parametrize("method", SAMPLING)
def test_the_minimum_of_a_sphere(method):
    searcher = make_optimizer(Search(method=method, particles=30, iterations=150), line(4), 1)
    np.testing.assert_allclose(optimize(searcher, sphere).xbest, 0.5, atol=1e-3)


@pytest.mark.parametrize("method", SAMPLING)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_one_number_alone_within_limits(method, seed):
    """The least at 3 with limits beside it, and at a wall; pycma itself asks for two numbers or more."""
    space = make_space([1.0], [9.0], [(1.0, 9.0)], [np.inf])
    for least in (3.0, 0.0):
        searcher = make_optimizer(Search(method=method, particles=10, iterations=60), space, seed)
        found = optimize(searcher, lambda positions, least=least: (positions[:, 0] - least) ** 2).xbest
        np.testing.assert_allclose(found, [max(least, 1.0)], atol=1e-3)
    state = searcher.state()
    again = optimizer_from_state(Search(method=method, particles=10, iterations=60), space, seed, state)
    assert again.state() == state


@pytest.mark.parametrize("method", SAMPLING)
def test_the_lowest_valley_lies_where_the_period_is_cut(method):
    space = make_space([-np.inf] * 3, [np.inf] * 3, [(0, TURN)] * 3, [TURN] * 3)
    searcher = make_optimizer(Search(method=method, particles=40, iterations=150), space, 5)
    while not searcher.stop():
        positions = searcher.ask()
        assert np.all((positions >= 0) & (positions <= TURN))
        searcher.tell(positions, hills_in_a_ring(positions))
    found = searcher.result.xbest
    np.testing.assert_allclose(np.minimum(found, TURN - found), 0, atol=0.02)


# The one shape ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ALL)
def test_stopped_anywhere_goes_on_to_the_same_bits(method, tmp_path):
    """After every iteration, and between ask and tell, through JSON and through HDF5 by turns; with broken losses."""
    keys = {"restarts": 2, "stall": 3, "iterations": 12}
    search, space, problem, losses = case(method, **keys)

    def objective(positions):
        found = losses(positions)
        return found if method == "exact" else np.where(positions[:, 0] > 1.7, np.nan, found)

    def again(searcher, turn):
        if turn % 2:
            return optimizer_from_state(search, space, 6, json.loads(text(searcher)), problem)
        with h5py.File(tmp_path / f"{turn}.h5", "w") as file:
            SearchState().write(file, "search", searcher.state(False), {})
        with h5py.File(tmp_path / f"{turn}.h5") as file:
            return optimizer_from_state(search, space, 6, SearchState().read(file, "search", {}), problem)

    whole, broken, turn = make_optimizer(search, space, 6, problem), make_optimizer(search, space, 6, problem), 0
    while not whole.stop():
        assert not broken.stop()
        broken, turn = again(broken, turn), turn + 1
        asked = whole.ask()
        np.testing.assert_array_equal(broken.ask(), asked)
        broken, turn = again(broken, turn), turn + 1
        np.testing.assert_array_equal(broken.ask(), asked)
        for one in (whole, broken):
            one.tell(np.array(asked), objective(np.array(asked)))
        assert text(broken) == text(whole)
        np.testing.assert_equal(broken.history, whole.history)
    assert broken.stop() == whole.stop()
    assert np.array_equal(broken.result.xbest, whole.result.xbest)
    assert len(whole.state(False)["history"]) == whole.iterations == len(whole.history["best"])


@pytest.mark.parametrize("method", SAMPLING)
def test_same_seed_same_search_and_nothing_global(method):
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    found = []
    for seed in (1, 1, 2):
        search, space, problem, losses = case(method)
        searcher = make_optimizer(search, space, seed, problem)
        optimize(searcher, losses)
        found.append(text(searcher))
    assert found[0] == found[1] != found[2]
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


@pytest.mark.parametrize("method", ALL)
def test_budget_history_and_what_is_told(method):
    search, space, problem, losses = case(method, restarts=3)
    searcher, count = make_optimizer(search, space, 0, problem), 0
    assert searcher.iterations == searcher.result.evaluations == 0
    assert searcher.result.xbest is None
    while not searcher.stop():
        positions = np.array(searcher.ask())
        with pytest.raises(ValueError, match="the last ask"):
            searcher.tell(positions + 1, losses(positions))
        with pytest.raises(ValueError, match="of shape"):
            searcher.tell(positions, np.zeros((len(positions), 2)))
        searcher.tell(positions, losses(positions))
        count += len(positions)
        assert searcher.result.evaluations == searcher.history["evaluations"][-1] == count
    assert 0 < count <= search.particles * search.iterations
    best = searcher.history["best"]
    assert np.all(np.diff(best) <= 0)
    assert best[-1] == searcher.result.fbest == losses(searcher.result.xbest[None])[0]
    if method not in ("exact", "gradient"):
        assert count > search.particles * (search.iterations - 8)


@settings(max_examples=25)
@given(
    method=st.sampled_from(("pso", "ring", "cma", "gradient")),
    seed=st.integers(0, 2**62),
    low=st.floats(-3, 3),
    width=st.floats(1e-3, 5),
    restarts=st.integers(0, 2),
)
def test_limits_and_periods_hold_for_any_loss(method, seed, low, width, restarts):
    first, infinite = [(low, low + width), (0, TURN)], np.inf
    space = make_space([low, -infinite], [low + width, infinite], first, [infinite, TURN])
    random = np.random.default_rng(seed)
    problem = quadratic(space, gram_matrices(1))
    problem = Quadratic(
        problem.matrices, problem.drives, problem.positions, lambda energy: np.sin(9 * energy[:, 0]), False
    )
    searcher = make_optimizer(Search(method=method, particles=6, iterations=8, restarts=restarts), space, seed, problem)
    while not searcher.stop():
        positions = searcher.ask()
        assert np.all((positions[:, 0] >= low) & (positions[:, 0] <= low + width))
        assert np.all((positions[:, 1] >= 0) & (positions[:, 1] <= TURN))
        losses = random.normal(size=len(positions))
        losses[random.random(len(positions)) < 0.3] = np.nan
        searcher.tell(positions, losses)


@pytest.mark.parametrize("method", ALL)
def test_a_state_of_something_else_is_refused(method):
    search, space, problem, losses = case(method)
    searcher = make_optimizer(search, space, 0, problem)
    for _ in range(1 if method == "exact" else 3):
        asked = searcher.ask()
        searcher.tell(asked, losses(asked))
    state = searcher.state()
    wrong = [{}, state | {"format": "another"}, state | {"positions": [[0.0]]}]
    wrong += [{key: value for key, value in state.items() if key != "history"}] if method != "cma" else []
    wrong += [state | {"losses": state["losses"][::-1]}] if method == "cma" else []
    wrong = wrong[:2] if method == "gradient" else wrong
    for changed in wrong:
        with pytest.raises(ValueError, match="state") as refusal:
            optimizer_from_state(search, space, 0, changed, problem)
        assert "\n" not in str(refusal.value)


# What does not fit ------------------------------------------------------------------------------------------


def refused(method, space, problem):
    with pytest.raises(SceneError, match=r"^search\.method") as refusal:
        make_optimizer(Search(method=method), space, 0, problem)
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def test_where_there_is_no_exact_solution_another_method_is_named():
    space, matrices = magnitudes_and_phases(3), gram_matrices(3)
    equal = quadratic(space, matrices, limit=lambda drives: drives / np.abs(drives))
    assert "write 'gradient'" in refused("exact", space, equal)
    assert "localization factor alone" in refused("exact", space, quadratic(space, matrices, lambda e: -e[:, 1]))
    narrow = magnitudes_and_phases(3, 0.9, 1.0)
    assert "eigen-solution" in refused("exact", narrow, quadratic(narrow, matrices))
    for method in ("exact", "gradient"):
        assert "quadratic forms" in refused(method, space, None)


def test_a_power_limit_is_met_by_scaling():
    space, matrices = magnitudes_and_phases(3, 0.0, 5.0), gram_matrices(3)

    def within_power(drives):
        return drives / np.maximum(np.sqrt((np.abs(drives) ** 2).sum(axis=1, keepdims=True)), 1)

    problem = quadratic(space, matrices, limit=within_power)
    searcher = make_optimizer(Search(method="exact"), space, 0, problem)
    assert 1 - optimize(searcher, problem.losses).fbest == pytest.approx(bound_of(matrices), abs=1e-12)
    assert searcher.result.xbest[:3].max() == pytest.approx(5.0)


def test_without_pycma_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cma", None)
    assert refused("cma", line(2), None).endswith("pip install 'warp-plate[cma]'")
