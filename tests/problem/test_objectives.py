"""Objectives: their values against displacements of every step in plain NumPy, and the losses made of them."""

import math

import numpy as np
import pytest

from support.numpy_plate import run_plate
from warp_plate import PlateSolver, SceneError
from warp_plate.plate.scheme import discretize, make_scheme
from warp_plate.plate.weights import localization_factor, patches, region_weights
from warp_plate.problem.objectives import MOST_CELLS, Objectives, make_objectives
from warp_plate.quantities.region_quantities import RegionSizes
from warp_plate.scene.search import Objective

KINDS = ("localization", "contrast", "velocity", "displacement", "uniformity")
QUANTITIES = ("velocity", "displacement")
PHASORS = np.array([[1, 1, 1], [1, 0, 0], [0.4 - 0.2j, -0.7j, 1.3]], dtype=complex)
DISC = {"disc": (0.08, 0.07, 0.055)}


def objectives_of(scene):
    return make_objectives(discretize(scene))


def scene_with(scene, *kinds, target=DISC, **others):
    """Return a small scene with these objectives; others: of all of them, such as a rest_limit."""
    terms = [{"kind": kind, **others} for kind in kinds]
    return scene((17, 15), damping=88.0, target=target, search={"objectives": terms})


def unit_objectives(*terms):
    """Return objectives of unit areas and masses and of four cells of a quarter."""
    return Objectives(terms, dict.fromkeys("0123"), RegionSizes(np.ones(2), np.ones(2), np.full(4, 0.25)))


def test_values_are_those_of_recorded_displacements(scene):
    """Root mean squares and densities from the fields at the nodes, weighted by the target's shares; losses of them."""
    weights = dict(zip(KINDS, (0.5, 0.1, 2e3, 3e6, 0.25), strict=True))
    terms = [{"kind": kind, "weight": weight} for kind, weight in weights.items()]
    made = scene((17, 15), damping=88.0, target=DISC, search={"objectives": terms})
    scheme, objectives = make_scheme(made), objectives_of(made)
    history, velocity = run_plate(scheme, ("clamped",) * 4, 88.0, False, patches(made), PHASORS)
    first, last = scheme.window
    # Mean squares (plates, ny, nx) over the window; of displacements, those at the end of each step.
    fields = velocity, (history[:, first + 1 : last + 1] ** 2).mean(axis=1)
    half_mass = 0.5 * scheme.surface_density * math.prod(scheme.spacing)
    shares = region_weights(made, objectives.regions)
    energies = [half_mass * np.einsum("ryx,pyx->pr", shares, field) for field in fields]
    values = objectives.values(*energies)
    plate, target = shares[:2]
    rest = plate - target
    for kind, field in zip(QUANTITIES, fields, strict=True):
        for name, share in ((kind, target), (f"{kind} of the rest", rest)):
            exact = np.sqrt((field * share).sum(axis=(1, 2)) / share.sum())
            np.testing.assert_allclose(values[name], exact, rtol=1e-12)
    inside, outside, whole = ((fields[0] * share).sum(axis=(1, 2)) for share in (target, rest, plate))
    contrast = 10 * np.log10(inside / target.sum() / (outside / rest.sum()))
    np.testing.assert_allclose(values["contrast"], contrast, rtol=1e-12)
    np.testing.assert_allclose(values["localization"], inside / whole, rtol=1e-12)
    assert ((values["uniformity"] > 0.05) & (values["uniformity"] < 1)).all()
    total = sum(weights[kind] * values[kind] for kind in KINDS)
    np.testing.assert_allclose(values["sum"], total, rtol=1e-14)
    np.testing.assert_allclose(objectives.losses(*energies), -total, rtol=1e-14)
    with pytest.raises(ValueError, match="needs energies of displacement"):
        objectives.losses(energies[0])
    for quantity, energy, tolerance in zip(QUANTITIES, energies, (1e-9, 1e-6), strict=True):
        run = PlateSolver(made, "cpu", areas=objectives.regions, quantity=quantity).run(PHASORS)
        np.testing.assert_allclose(run.energy, energy, rtol=tolerance)


def test_localization_alone_is_the_papers_loss_to_the_last_bit(scene, random):
    energy = random.uniform(1, 2, (50, 2)) * [3, 1]
    alone, doubled = objectives_of(scene()), unit_objectives(Objective(weight=2.0))
    assert alone.only_localization
    assert (alone.losses(energy) == 1 - localization_factor(energy)).all()
    assert not doubled.only_localization
    np.testing.assert_allclose(doubled.losses(energy), -2 * localization_factor(energy), rtol=1e-15)


def test_within_a_limit_is_better_than_beyond_it(random):
    """Beyond it the loss falls towards the limit, whatever the other objectives are."""
    objectives = unit_objectives(
        Objective(kind="velocity", weight=float(random.exponential(1)), rest_limit=1.0),
        Objective(kind="contrast", weight=float(random.exponential(1))),
        Objective(kind="localization"),
    )
    target, rest = 10 ** random.uniform(-6, 6, 200), np.sort(10 ** random.uniform(-4, 4, 200))
    energy = np.column_stack([target + rest, target])
    losses = objectives.losses(energy)
    within = objectives.values(energy)["velocity of the rest"] <= 1
    assert losses[within].max() < losses[~within].min()
    assert (np.diff(losses[~within]) >= 0).all()  # of a rest that grows


def test_plates_at_rest_or_without_energies():
    """A plate at rest has no share, contrast or uniformity, but a velocity of 0 within any limit; NaN stays NaN."""
    energy = np.array([[0] * 6, [math.nan] * 6, [1, 1, 0.25, 0.25, 0.25, 0.25], [1, 0, 0, 0, 0, 0]])
    for kind in ("localization", "contrast", "uniformity"):
        assert np.isnan(unit_objectives(Objective(kind=kind)).losses(energy)[:2]).all()
    assert unit_objectives(Objective(kind="contrast")).losses(energy[2:]).tolist() == [-120, 120]
    losses = unit_objectives(Objective(kind="velocity", rest_limit=1.0)).losses(energy)
    assert losses[0] == 0
    assert np.isnan(losses[1])


def test_a_rigid_motion_has_its_velocity_where_mass_varies(scene):
    """All nodes at the same speed v: E = ½Mv² in every region, so the root of the mean square is v."""
    made = scene(
        (17, 15), edges=("free",) * 4, target=DISC, search={"objectives": [{"kind": "velocity"}]},
        effects={"variation": {"density": [[1.0, 3.0], [2.0, 0.5]]}},
    )  # fmt: skip
    objectives, scheme = objectives_of(made), make_scheme(made)
    mass = math.prod(scheme.spacing) * scheme.bending.mass
    values = objectives.values(0.5 * (mass * region_weights(made)).sum(axis=(1, 2))[None] * 0.3**2)
    assert values["velocity"] == pytest.approx(0.3, rel=1e-12)
    assert values["velocity of the rest"] == pytest.approx(0.3, rel=1e-12)
    assert objectives.sizes.masses.sum() == pytest.approx((mass * region_weights(made)[0]).sum(), rel=1e-12)


def test_objectives_that_a_scene_cannot_have_are_refused(scene):
    whole = {"area": (0.0, 0.2, 0.0, 0.2)}
    for kinds, keys, target, line in (
        (["localization", "contrast"], {}, whole, r"search\.objectives\[1\]\.kind = 'contrast': .* no rest"),
        (["velocity"], {"rest_limit": 1e-3}, whole, r"search\.objectives\[0\]\.kind = 'velocity': .* no rest"),
        (["uniformity"], {}, {"disc": (0.1, 0.1, 0.01)}, r"target\.disc = .* too few for search\.objectives"),
    ):
        with pytest.raises(SceneError, match=f"^{line}"):
            objectives_of(scene_with(scene, *kinds, target=target, **keys))


def test_uniformity_of_cells(scene):
    """Cells sum to the target; all of them alike give 1, half of them at rest ½, one in four alone ¼."""
    for target in (DISC, {"area": (0.02, 0.17, 0.05, 0.11)}):
        made = scene_with(scene, "uniformity", target=target)
        objectives = objectives_of(made)
        np.testing.assert_allclose(sum(objectives.regions.values()), region_weights(made)[1], rtol=0, atol=1e-9)
        assert objectives.sizes.cells.sum() == pytest.approx(objectives.sizes.areas[0], rel=1e-9)
        assert 2 <= len(objectives.regions) <= MOST_CELLS**2
    corner = scene_with(scene, "uniformity", target={"area": (0.0, 0.1, 0.0, 0.06)})
    assert len(objectives_of(corner).regions) == 4 * 2
    cells = np.array([[1, 1, 1, 1], [2, 2, 0, 0], [0, 0, 0, 4], [3, 1, 0, 0], [0, 0, 0, 0]], dtype=float)
    energy = np.column_stack([np.full(5, 10), cells.sum(axis=1), cells])
    values = unit_objectives(Objective(kind="uniformity")).values(energy * 1e-300)["uniformity"]
    np.testing.assert_allclose(values, [1, 0.5, 0.25, 16 / 10 / 4, math.nan], rtol=1e-12)
