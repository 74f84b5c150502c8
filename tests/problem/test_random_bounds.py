"""Bounds of random scenes, which no permitted drive and no independent solution of the relaxation passes."""

import math

import numpy as np
import pytest

from support.scenes import THREE_PATCHES, scene_of
from warp_plate.plate.designs import Designs
from warp_plate.problem.problem import make_problem
from warp_plate.resolve import resolve

KINDS = ("localization", "contrast", "velocity", "displacement")


def drawn_problem(random, kind, steady):
    """Return the problem of a random scene with every kind of limit, by its Gram matrices."""
    effects = {"loss_factor": {"eta": 0.02}} if steady else {"damping": {"viscous": float(random.uniform(5, 100))}}
    low, limits = float(random.choice([0.0, 0.4])), {}
    limits |= {"magnitude": 0.9} if random.random() < 0.4 else {}
    limits |= {"power": float(random.uniform(0.6, 2))} if random.random() < 0.5 else {}
    limits |= {"equal_magnitudes": True} if random.random() < 0.3 else {}
    rest = {"rest_limit": {"velocity": 1e-4, "displacement": 6e-8}[kind]} if kind in KINDS[2:] and not low else {}
    search = {"magnitude": {"range": (low, 1.2)}, "phase": {}, "limits": limits, "objectives": [{"kind": kind, **rest}]}
    patches = [tuple(0.2 * np.repeat(random.uniform(0, 0.8, 2), 2) + [0, 0.03, 0, 0.03]) for _ in THREE_PATCHES]
    scene = scene_of((9, 9), modal_density=0.5, effects=effects, frequency=random.uniform(60, 300), search=search,
                     actuators=patches, window=(0.004, 0.02))  # fmt: skip
    return make_problem(resolve(scene, "cpu", evaluator="modal"))


def solve_relaxation(problem):
    """Return the largest ⟨A, X⟩ over X ⪰ 0 within the scene's limits by a conic solver; per ⟨B, X⟩ for a ratio.

    The numbers of a triangle of X, and σ: the square by which the power limit scales the ranges down.
    """
    clarabel, sparse = pytest.importorskip("clarabel"), pytest.importorskip("scipy.sparse")
    (objective,), limits = problem.scene.search.objectives, problem.scene.search.limits
    response = problem.response if objective.kind != "displacement" else problem.plates.displacement_response
    plate, target = response.matrices[:2]
    size, ratio = len(plate), objective.kind in KINDS[:2]
    column, row = np.tril_indices(size)
    unit, weights = np.linalg.eigvalsh(plate)[-1], np.where(row == column, 1.0, math.sqrt(2))

    def entries(matrix, sigma):
        return np.append(matrix[row, column] * weights, sigma)

    squares = [np.diag(np.tile(np.eye(size // 2)[k], 2)) for k in range(size // 2)]
    low, high = problem.scene.search.magnitude.range
    high = high if ratio else min(high, limits.magnitude or high)
    equations = [(entries(square - squares[0], 0.0), 0.0) for square in squares[1:] if limits.equal_magnitudes]
    sigma = entries(np.zeros_like(plate), 1.0)
    bounds = [(entries(square, -(high**2)), 0.0) for square in squares]
    bounds += [(entries(-square, low**2), 0.0) for square in squares] + [(-sigma, 0.0)]
    equations += [(entries(plate / unit, 0.0), 1.0)] if ratio else [(sigma, 1.0)] * (not (limits.power and low))
    if not ratio:
        bounds += [(sigma, 1.0)] + [(entries(np.eye(size), 0.0), limits.power)] * bool(limits.power)
        most = problem.objectives.sizes.masses[1] * (objective.rest_limit or 0.0) ** 2 / 2
        bounds += [(entries((plate - target) / unit, 0.0), most / unit)] * bool(objective.rest_limit)
    cone = [(-one, 0.0) for one in np.eye(len(row) + 1)[:-1]]
    rows, values = zip(*equations, *bounds, *cone, strict=True)
    cones = [clarabel.ZeroConeT(len(equations))] if equations else []
    cones += [clarabel.NonnegativeConeT(len(bounds)), clarabel.PSDTriangleConeT(size)]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.tol_gap_rel, settings.tol_feas = False, 1e-10, 1e-10
    nothing = sparse.csc_matrix((len(row) + 1,) * 2)
    matrix, cost = sparse.csc_matrix(np.array(rows)), -entries(target / unit, 0.0)
    found = clarabel.DefaultSolver(nothing, cost, matrix, np.array(values), cones, settings).solve()
    return -found.obj_val * (1.0 if ratio else unit)


@pytest.mark.parametrize("steady", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_no_permitted_drive_and_no_relaxation_passes_a_bound(random, kind, steady):
    problem = drawn_problem(random, kind, steady)
    bound, objectives = problem.loss_bound, problem.objectives
    positions = problem.space.from_unit(random.random((10_000, problem.space.dimension)))
    drives = problem.parametrization.designs(positions).drives * np.exp(1j * random.uniform(0, 7, (10_000, 1)))
    if objectives.limits:  # scaled down to the limit of the rest, which magnitudes from 0 on allow
        energies = problem.plates.energies(Designs(drives)), problem.plates.displacement_energies(Designs(drives))
        ((name, limit),) = objectives.limits.items()
        drives = drives / np.maximum(objectives.values(*energies)[name] / limit * (1 + 1e-12), 1)[:, None]
    losses = problem.design_losses(Designs(drives))
    near = 1e-6 * max(abs(bound.value), 1e-9)
    assert np.nanmin(losses) >= bound.value - near
    best = Designs(drives[np.argsort(losses)[:3]])
    direct = problem.drive_solver.run(best.drives).energy
    if kind != "displacement":
        np.testing.assert_allclose(objectives.losses(direct), problem.design_losses(best), rtol=1e-6)
    energy = np.full((1, 2), 1.0)
    energy[0, 1] = solve_relaxation(problem)
    relaxed = objectives.values(energy, energy)[kind][0]
    value = 1 - bound.value if objectives.only_localization else -bound.value
    assert value >= relaxed - near
    assert bound.kind == "attained" or value == pytest.approx(relaxed, rel=1e-5)
