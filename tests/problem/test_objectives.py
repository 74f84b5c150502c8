"""Objectives: their values against displacements of every step in plain NumPy, and the losses that are made of them."""

import math

import numpy as np
import pytest
from conftest import PAPER, refusal
from hypothesis import given
from hypothesis import strategies as st

from warp_plate import PlateSolver, SceneError
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import REGIONS, localization_factor, patches, region_weights
from warp_plate.problem.objectives import MOST_CELLS, Objectives, make_objectives
from warp_plate.reference.numpy_plate import run_plate
from warp_plate.scene.search import Objective

KINDS = ("localization", "contrast", "velocity", "displacement", "uniformity")
DRIVES = np.array([[1, 1, 1], [1, 0, 0], [0.4 - 0.2j, -0.7j, 1.3]], dtype=complex)
DISC = {"disc": (0.08, 0.07, 0.055)}


def objectives(*kinds, **limits):
    return [{"kind": kind, **({"rest_limit": limits[kind]} if kind in limits else {})} for kind in kinds]


def judged(scene, *kinds, target=DISC, weights=None, **limits):
    """A small scene with these objectives."""
    asked = objectives(*kinds, **limits)
    for one, weight in zip(asked, weights or [1.0] * len(asked), strict=True):
        one["weight"] = weight
    return scene((17, 15), damping=88.0, target=target, search={"objectives": asked})


@pytest.fixture
def moved(scene):
    """A scene with all objectives, and mean squares (plates, ny, nx) of velocity and displacement over its window."""
    made = judged(scene, *KINDS)
    scheme = make_scheme(made)
    history, velocity = run_plate(scheme, ("clamped",) * 4, 88.0, False, patches(made), DRIVES)
    first, last = scheme.window
    # Of displacements, those at the end of each step.
    return made, velocity, (history[:, first + 1 : last + 1] ** 2).mean(axis=1)


def energies_of(made, mean_squares, judge):
    """(plates, regions) ½ ∫ ρH · (mean square) dA, of the plate, the target and the judge's regions."""
    scheme = make_scheme(made)
    weights = region_weights(made, judge.regions)
    half = 0.5 * scheme.surface_density * math.prod(scheme.spacing)
    return half * np.einsum("ryx,pyx->pr", weights, mean_squares)


def test_values_are_those_of_recorded_displacements(moved):
    """Root mean squares and densities straight from the fields at the nodes, weighed by the target's shares."""
    made, velocity, displacement = moved
    judge = make_objectives(made)
    values = judge.values(energies_of(made, velocity, judge), energies_of(made, displacement, judge))
    plate, target = region_weights(made)
    rest = plate - target
    for kind, field in (("velocity", velocity), ("displacement", displacement)):
        for name, share in ((kind, target), (f"{kind} of the rest", rest)):
            exact = np.sqrt((field * share).sum(axis=(1, 2)) / share.sum())
            np.testing.assert_allclose(values[name], exact, rtol=1e-12)
    inside, outside = ((velocity * share).sum(axis=(1, 2)) / share.sum() for share in (target, rest))
    np.testing.assert_allclose(values["contrast"], 10 * np.log10(inside / outside), rtol=1e-12)
    share = (velocity * target).sum(axis=(1, 2)) / (velocity * plate).sum(axis=(1, 2))
    np.testing.assert_allclose(values["localization"], share, rtol=1e-12)
    assert (values["uniformity"] > 0.05).all()
    assert (values["uniformity"] < 1).all()


def test_a_solver_s_energies_give_the_same_velocities(moved):
    made, velocity, _ = moved
    judge = make_objectives(made)
    run = PlateSolver(made, "cpu", areas=judge.regions).run(DRIVES)
    np.testing.assert_allclose(run.energy, energies_of(made, velocity, judge), rtol=1e-9)


def test_cells_cut_the_target(scene):
    """They sum to the target, node by node, and have two nodes or more a side, at most so many."""
    for target in (DISC, {"area": (0.02, 0.17, 0.05, 0.11)}, {"area": (0.0, 0.2, 0.0, 0.2)}):
        made = judged(scene, "uniformity", target=target)
        judge = make_objectives(made)
        np.testing.assert_allclose(sum(judge.regions.values()), region_weights(made)[1], rtol=0, atol=1e-9)
        assert judge.cells.sum() == pytest.approx(judge.areas[0], rel=1e-9)
        assert 2 <= len(judge.regions) <= MOST_CELLS**2
    assert len(make_objectives(judged(scene, "uniformity", target={"area": (0.0, 0.1, 0.0, 0.06)})).regions) == 4 * 2


def judge_of(*asked):
    """A judge of unit areas and masses and of four cells of a quarter."""
    return Objectives(
        asked, {str(index): np.zeros((1, 1)) for index in range(4)}, np.ones(2), np.ones(2), np.full(4, 0.25)
    )


def test_uniformity_by_hand():
    """All cells alike: 1; half of them at rest: ½; one in four alone: ¼."""
    cells = np.array([[1, 1, 1, 1], [2, 2, 0, 0], [0, 0, 0, 4], [3, 1, 0, 0], [0, 0, 0, 0]], dtype=float)
    energy = np.column_stack([np.full(5, 10), cells.sum(axis=1), cells])
    found = judge_of(Objective(kind="uniformity")).values(energy * 1e-300)["uniformity"]
    np.testing.assert_allclose(found, [1, 0.5, 0.25, 16 / 10 / 4, math.nan], rtol=1e-12)


@given(st.integers(0, 2**32))
def test_uniformity_lies_between_0_and_1_and_knows_no_size(seed):
    random = np.random.default_rng(seed)
    areas = random.uniform(0.01, 1, 7)
    judge = Objectives((Objective(kind="uniformity"),), {}, np.ones(2), np.ones(2), areas)
    energy = random.exponential(1, (5, 9)) ** 3
    found = judge.values(energy)["uniformity"]
    assert ((found > 0) & (found <= 1 + 1e-12)).all()
    np.testing.assert_allclose(judge.values(energy * 1e-40)["uniformity"], found, rtol=1e-12)
    energy[:, 2:] = areas
    np.testing.assert_allclose(judge.values(energy)["uniformity"], 1, rtol=1e-12)


def test_one_localization_is_the_paper_s_loss_to_the_last_bit(scene, random):
    energy = random.uniform(1, 2, (50, 2)) * [3, 1]
    assert (make_objectives(scene()).losses(energy) == 1 - localization_factor(energy)).all()
    two = judge_of(Objective(weight=2.0))
    np.testing.assert_allclose(two.losses(energy), -2 * localization_factor(energy), rtol=1e-15)
    assert make_objectives(scene()).only_localization
    assert not two.only_localization


def test_losses_are_weighed_sums(moved):
    made, velocity, displacement = moved
    weights = dict(zip(KINDS, (0.5, 0.1, 2e3, 3e6, 0.25), strict=True))
    asked = [{"kind": kind, "weight": weight} for kind, weight in weights.items()]
    judge = make_objectives(made.with_tables(search={"objectives": asked}))
    assert judge.needs_displacement
    energies = [energies_of(made, field, judge) for field in (velocity, displacement)]
    values = judge.values(*energies)
    np.testing.assert_allclose(
        judge.losses(*energies), -sum(weights[kind] * values[kind] for kind in KINDS), rtol=1e-14
    )
    with pytest.raises(ValueError, match="displacements are judged"):
        judge.losses(energies[0])


@given(st.integers(0, 2**32))
def test_within_a_limit_is_better_than_beyond_it(seed):
    """And beyond it a loss falls towards it, whatever else is sought."""
    random = np.random.default_rng(seed)
    judge = judge_of(
        Objective(kind="velocity", weight=float(random.exponential(1)), rest_limit=1.0),
        Objective(kind="contrast", weight=float(random.exponential(1))),
        Objective(kind="localization"),
    )
    target, rest = 10 ** random.uniform(-6, 6, 200), np.sort(10 ** random.uniform(-4, 4, 200))
    energy = np.column_stack([target + rest, target])
    losses = judge.losses(energy)
    speed = judge.values(energy)["velocity of the rest"]
    within = speed <= 1
    assert within.any()
    assert losses[within].max() < losses[~within].min()
    beyond = np.flatnonzero(~within)
    order = beyond[np.argsort(speed[beyond])]
    assert (np.diff(losses[order]) >= 0).all()


def test_what_is_at_rest_or_broken():
    """At rest: no share, contrast or uniformity, but a velocity of 0 within any limit; NaN stays none."""
    energy = np.array([[0, 0, 0, 0, 0, 0], [math.nan] * 6, [1, 1, 0.25, 0.25, 0.25, 0.25], [1, 0, 0, 0, 0, 0]])
    for kind in ("localization", "contrast", "uniformity"):
        losses = judge_of(Objective(kind=kind)).losses(energy)
        assert np.isnan(losses[:2]).all()
    assert judge_of(Objective(kind="contrast")).losses(energy[2:]).tolist() == [-120, 120]
    losses = judge_of(Objective(kind="velocity", rest_limit=1.0)).losses(energy)
    assert losses[0] == 0
    assert np.isnan(losses[1])


def test_energies_with_mass_that_varies_give_the_velocity_of_a_rigid_motion(scene):
    """All nodes at the same speed v: E = ½Mv² in every region, so the root of the mean square is v."""
    made = scene(
        (17, 15), edges=("free",) * 4, target=DISC, search={"objectives": objectives("velocity")},
        effects={"variation": {"density": [[1.0, 3.0], [2.0, 0.5]]}},
    )  # fmt: skip
    judge, scheme = make_objectives(made), make_scheme(made)
    mass = math.prod(scheme.spacing) * scheme.bending.mass
    energy = 0.5 * (mass * region_weights(made)).sum(axis=(1, 2))[None] * 0.3**2
    values = judge.values(energy)
    assert values["velocity"] == pytest.approx(0.3, rel=1e-12)
    assert values["velocity of the rest"] == pytest.approx(0.3, rel=1e-12)
    assert judge.masses.sum() == pytest.approx((mass * region_weights(made)[0]).sum(), rel=1e-12)
    assert REGIONS[:2] == ("plate", "target")


def test_objectives_that_a_scene_cannot_have_are_refused(scene):
    whole = {"area": (0.0, 0.2, 0.0, 0.2)}
    with pytest.raises(SceneError, match=r"^search\.objectives\[0\]\.kind = 'contrast': .* no rest"):
        make_objectives(judged(scene, "contrast", target=whole))
    with pytest.raises(SceneError, match=r"^search\.objectives\[1\]\.kind = 'velocity': .* no rest"):
        make_objectives(judged(scene, "localization", "velocity", target=whole, velocity=1e-3))
    with pytest.raises(SceneError, match=r"^target\.disc = .* too few for search\.objectives"):
        make_objectives(judged(scene, "uniformity", target={"disc": (0.1, 0.1, 0.01)}))


@pytest.mark.parametrize(
    ("lines", "named", "right"),
    [
        ("[search]\nobjectives = []", "search.objectives = []", "at least 1"),
        ('[[search.objectives]]\nkind = "loudness"', "search.objectives[0].kind = 'loudness'", "'localization'"),
        ('[[search.objectives]]\nkind = "contrast"\nweight = 0', "search.objectives[0].weight = 0", "greater than 0"),
        ('[[search.objectives]]\nkind = "contrast"\nrest_limit = 1.0', "search.objectives[0].rest_limit", "'velocity'"),
        ('[[search.objectives]]\nkind = "velocity"\nrest_limit = -1', "search.objectives[0].rest_limit = -1", "0"),
        (
            '[[search.objectives]]\nkind = "velocity"\n[[search.objectives]]\nkind = "velocity"',
            "search.objectives[1].kind: 'velocity' is there already",
            "weights",
        ),
    ],
)
def test_wrong_objectives_are_refused_in_one_line(lines, named, right):
    head, _, rest = PAPER.partition("[search]")
    line = refusal(head + lines + "\n\n" + rest[rest.index("[[actuators]]") :])
    assert line.startswith(named)
    assert right in line


def test_a_solver_s_displacement_energies_give_the_same_displacements(moved):
    made, _, displacement = moved
    judge = make_objectives(made)
    run = PlateSolver(made, "cpu", areas=judge.regions, quantity="displacement").run(DRIVES)
    exact = energies_of(made, displacement, judge)
    found, expected = (judge.values(one, one) for one in (run.energy, exact))
    for kind in ("displacement", "displacement of the rest"):
        np.testing.assert_allclose(found[kind], expected[kind], rtol=1e-6)
