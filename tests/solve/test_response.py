"""The exact bound: Gram matrices of unit responses, against plates and against brute force."""

import math

import numpy as np
import pytest
import scipy.optimize

from warp_plate import PlateSolver
from warp_plate.plate.weights import REGIONS, localization_factor
from warp_plate.problem.parametrization import paper_phasors
from warp_plate.solve.response import Response, measure_response, unit_drives

PATCHES = [(0.03, 0.06, 0.04, 0.07), (0.12, 0.17, 0.03, 0.08), (0.05, 0.13, 0.11, 0.16)]


def quadratic(values):
    """A Response of given symmetric matrices, target first: LF = zᵀA z / zᵀB z."""
    matrices = dict(zip(("target", "plate"), values, strict=True))
    return Response(np.array([matrices[name] for name in REGIONS]))


def random_gram(random, count, rank=None):
    """A random positive matrix and one between it and zero, as energies of a plate and of a part of it
    are."""
    factor = random.normal(size=(count, rank or count))
    orthogonal, _ = np.linalg.qr(random.normal(size=(rank or count, rank or count)))
    shares = orthogonal * random.uniform(0, 1, rank or count) @ orthogonal.T
    return factor @ shares @ factor.T, factor @ factor.T


def test_energies_agree_with_plates(device, path, scene, phasors):
    """zᵀA z is the energy that a plate has under that drive; polarisation costs a few digits of sixteen."""
    made = scene(damping=88.5, actuators=PATCHES)
    solver = PlateSolver(made, device, path)
    drives = phasors(30, 3)
    plates = solver.run(drives).energy
    gram = measure_response(solver).energy(drives)
    np.testing.assert_allclose(gram, plates, rtol=1e-11)
    np.testing.assert_allclose(localization_factor(gram), localization_factor(plates), rtol=1e-11)


def test_matrices_are_gram_matrices(scene):
    """Symmetric; the target's share of any drive lies between 0 and 1."""
    response = measure_response(PlateSolver(scene(damping=88.5), "cpu"))
    target, plate = (response.matrices[REGIONS.index(name)] for name in ("target", "plate"))
    for matrix in (target, plate, plate - target):
        np.testing.assert_array_equal(matrix, matrix.T)
        values = np.linalg.eigvalsh(matrix)
        assert values[0] > -1e-12 * values[-1]


def test_bound_is_the_largest_ratio_by_brute_force(scene):
    """Two actuators, ratios of magnitude and both phases on a grid: none passes the bound, and the best one,
    climbing on from there, ends at it. Both phases count, because the transient makes the ratio depend on
    their common part."""
    response = measure_response(PlateSolver(scene(damping=88.5, actuators=PATCHES[:2]), "cpu"))

    def factors(angle, first, second):
        drives = [np.cos(angle) * np.exp(-1j * first), np.sin(angle) * np.exp(-1j * second)]
        return localization_factor(response.energy(np.stack(drives, axis=-1).reshape(-1, 2)))

    grid = np.meshgrid(
        np.linspace(0, math.pi / 2, 60), np.linspace(0, math.pi, 60), np.linspace(0, 2 * math.pi, 60)
    )
    tried = factors(*grid)
    assert tried.max() <= response.bound() * (1 + 1e-12)
    start = [part.reshape(-1)[tried.argmax()] for part in grid]
    climbed = scipy.optimize.minimize(lambda at: -factors(*at)[0], start, options={"gtol": 1e-9})
    assert -climbed.fun == pytest.approx(response.bound(), abs=1e-8)
    assert tried.max() - tried.min() > 0.1


def test_no_random_drive_passes_the_bound(device, path, scene, phasors):
    """As plates, at the solver's own rounding."""
    made = scene(damping=88.5)
    solver = PlateSolver(made, device, path)
    factors = localization_factor(solver.run(phasors(500, 3)).energy)
    assert factors.max() <= measure_response(solver).bound() + 1e-12


def test_best_drive_reaches_the_bound(device, path, scene):
    """Run as a plate; its largest magnitude is one."""
    solver = PlateSolver(scene(damping=88.5), device, path)
    response = measure_response(solver)
    drive = response.best_drive()
    assert np.abs(drive).max() == pytest.approx(1, rel=1e-12)
    assert localization_factor(solver.run(drive[None]).energy)[0] == pytest.approx(response.bound(), abs=1e-9)


@pytest.mark.parametrize("twins", [1, 2, 5])
def test_actuators_in_one_place_change_nothing(twins, scene):
    """Their matrix is singular; the bound is the one without the twins."""
    alone = measure_response(PlateSolver(scene(damping=88.5, actuators=PATCHES), "cpu"))
    with_twins = measure_response(
        PlateSolver(scene(damping=88.5, actuators=PATCHES + PATCHES[:1] * twins), "cpu")
    )
    assert with_twins.bound() == pytest.approx(alone.bound(), abs=1e-6)


def test_actuators_of_unlike_size_count_alike(scene):
    """A patch that moves the plate a million times less is still one more actuator: its size is only a
    factor."""
    tiny = (0.0084, 0.00844, 0.1, 0.1005)  # touches the cell of the first inner node by a sliver
    corner = (0.0084, 0.025, 0.1, 0.1005)  # the whole of the same cells' width
    made = [scene(damping=88.5, actuators=[*PATCHES, area]) for area in (tiny, corner)]
    slivers, whole = (measure_response(PlateSolver(each, "cpu")) for each in made)
    assert slivers.bound() == pytest.approx(whole.bound(), abs=1e-6)


@pytest.mark.parametrize("rank", range(1, 7))
def test_bound_of_random_matrices(rank, random):
    """The largest eigenvalue of A z = λ B z on the drives that B does not cancel, whatever the rank of B.

    The ratio of a drive that B nearly cancels is one of rounding errors, and is left out: what keeps a
    millionth of the energy keeps ten digits of the ratio.
    """
    for _ in range(20):
        target, plate = random_gram(random, 6, rank)
        response = quadratic((target, plate))
        z = random.normal(size=(2000, 6))
        in_target, in_plate = (np.einsum("pa,ab,pb->p", z, matrix, z) for matrix in (target, plate))
        clear = in_plate > 1e-6 * in_plate.max()
        assert (in_target / in_plate)[clear].max() <= response.bound() + 1e-8
        reached = localization_factor(response.energy(response.best_drive()[None]))[0]
        assert reached == pytest.approx(response.bound(), abs=1e-7)
        assert 0 < response.bound() < 1


def test_known_matrices():
    """diag(1, 0, 0, 2) against diag(4, 1, 1, 4): a half, by the last unit alone, −Im of the second
    actuator."""
    response = quadratic((np.diag([1.0, 0, 0, 2]), np.diag([4.0, 1, 1, 4])))
    assert response.bound() == pytest.approx(0.5, rel=1e-14)
    np.testing.assert_allclose(np.abs(response.best_drive()), [0, 1], atol=1e-12)


def test_one_actuator(device, path, scene):
    """Only its phase is free, which moves the transient, not the steady vibration: a bound little above its
    ratio."""
    solver = PlateSolver(scene(damping=88.5, actuators=PATCHES[:1]), device, path)
    phases = np.exp(-1j * np.linspace(0, math.pi, 400))
    factors = localization_factor(solver.run(phases[:, None]).energy)
    bound = measure_response(solver).bound()
    assert factors.max() <= bound + 1e-12
    assert factors.max() == pytest.approx(bound, abs=1e-5)


def test_no_bound_where_nothing_moves():
    response = quadratic((np.zeros((4, 4)), np.zeros((4, 4))))
    assert math.isnan(response.bound())


def test_unit_drives():
    """M(2M + 1) of them, no two alike; the first 2M are 1 and −i on each actuator alone."""
    drives = unit_drives(3)
    assert drives.shape == (21, 3)
    assert len({tuple(drive) for drive in drives}) == 21
    np.testing.assert_array_equal(drives[:6], np.concatenate([np.eye(3), -1j * np.eye(3)]))


def test_positions_are_the_other_actuators_magnitudes_and_phases():
    """Section II.C of the source paper: w₂ ... w_M, φ₂ ... φ_M, with w₁ = 1 and φ₁ = 0."""
    drives = paper_phasors(np.array([[2.0, -3.0, math.pi / 2, math.pi]]))
    np.testing.assert_allclose(drives, [[1, -2j, 3]], atol=1e-15)


def test_loss_of_a_plate_at_rest_is_no_number():
    """0/0, without a warning; a swarm counts it as worst."""
    energy = np.array([[4.0, 1.0], [0.0, 0.0], [np.nan, 1.0]])[
        :, [REGIONS.index("plate"), REGIONS.index("target")]
    ]
    np.testing.assert_array_equal(localization_factor(energy), [0.25, np.nan, np.nan])
