"""The exact bound: Gram matrices of unit responses, against plates and against brute force."""

import math

import numpy as np
import pytest

from warp_plate import PlateSolver
from warp_plate.plate.weights import REGIONS, localization_factor
from warp_plate.solve.response import Response, measure_response, unit_drives

PATCHES = [(0.03, 0.06, 0.04, 0.07), (0.12, 0.17, 0.03, 0.08), (0.05, 0.13, 0.11, 0.16)]


def quadratic(target, plate):
    """A Response of given symmetric matrices: LF = zᵀ target z / zᵀ plate z."""
    matrices = {"target": target, "plate": plate}
    return Response(np.array([matrices[name] for name in REGIONS]))


def test_energies_and_bound_agree_with_plates(device, path, scene, phasors):
    """zᵀA z is the energy under that drive, to a few digits of sixteen; no plate exceeds the bound, the best drive
    reaches it."""
    solver = PlateSolver(scene(damping=88.5, actuators=PATCHES), device, path)
    response, drives = measure_response(solver), phasors(300, 3)
    plates = solver.run(drives).energy
    energies = response.energy(drives)
    np.testing.assert_allclose(energies, plates, rtol=1e-11)
    # A matrix product would sum in another order for another number of rows.
    for first, count in ((0, 1), (3, 2), (100, 64)):
        np.testing.assert_array_equal(response.energy(drives[first : first + count]), energies[first : first + count])
    assert localization_factor(plates).max() <= response.bound() + 1e-12
    best = response.best_drive()
    assert np.abs(best).max() == pytest.approx(1, rel=1e-12)
    assert localization_factor(solver.run(best[None]).energy)[0] == pytest.approx(response.bound(), abs=1e-9)


def test_unit_drives_in_blocks_give_the_same_bits(scene):
    solver, reports = PlateSolver(scene(actuators=PATCHES), "cpu"), []
    whole = measure_response(solver)
    blocks = measure_response(solver, lambda done, total: reports.append((done, total)), block_numbers=15)
    np.testing.assert_array_equal(blocks.matrices, whole.matrices)
    work = 21 * solver.node_steps_per_plate
    assert reports == sorted(reports)
    assert (reports[-1], {total for _, total in reports}) == ((work, work), {work})


def test_actuators_in_one_place_and_of_unlike_size(scene):
    """Twins make the matrix singular and change no bound; a patch a million times weaker counts as a strong one."""
    tiny = (0.0084, 0.00844, 0.1, 0.1005)  # a sliver of the first inner node's cell
    corner = (0.0084, 0.025, 0.1, 0.1005)  # the whole width of the same cells
    alone, twins, sliver, whole = (
        measure_response(PlateSolver(scene(damping=88.5, actuators=[*PATCHES, *more]), "cpu")).bound()
        for more in ([], PATCHES[:1] * 2, [tiny], [corner])
    )
    assert twins == pytest.approx(alone, abs=1e-6)
    assert sliver == pytest.approx(whole, abs=1e-6)
    assert whole > alone + 1e-3


@pytest.mark.parametrize("rank", [1, 3, 6])
def test_bound_of_random_matrices(rank, random):
    """The largest eigenvalue of A z = λ B z on the drives that B does not cancel, whatever the rank of B."""
    factor = random.normal(size=(6, rank))
    orthogonal, _ = np.linalg.qr(random.normal(size=(rank, rank)))
    shares = orthogonal * random.uniform(0, 1, rank) @ orthogonal.T
    target, plate = factor @ shares @ factor.T, factor @ factor.T
    response, z = quadratic(target, plate), random.normal(size=(2000, 6))
    in_target, in_plate = (np.einsum("pa,ab,pb->p", z, matrix, z) for matrix in (target, plate))
    # The ratio of a drive that B nearly cancels is one of rounding errors.
    clear = in_plate > 1e-6 * in_plate.max()
    assert (in_target / in_plate)[clear].max() <= response.bound() + 1e-8
    reached = localization_factor(response.energy(response.best_drive()[None]))[0]
    assert reached == pytest.approx(response.bound(), abs=1e-7)
    assert 0 < response.bound() < 1


def test_known_matrices():
    """diag(1, 0, 0, 2) against diag(4, 1, 1, 4): a half, by −Im of the second actuator alone; NaN if nothing moves."""
    response = quadratic(np.diag([1.0, 0, 0, 2]), np.diag([4.0, 1, 1, 4]))
    assert response.bound() == pytest.approx(0.5, rel=1e-14)
    np.testing.assert_allclose(response.energy(response.best_drive()[None]), [[4, 2]], rtol=1e-12)
    assert math.isnan(quadratic(np.zeros((4, 4)), np.zeros((4, 4))).bound())
    np.testing.assert_array_equal(localization_factor(np.zeros((1, len(REGIONS)))), [np.nan])
    drives = unit_drives(3)
    assert len({tuple(drive) for drive in drives}) == len(drives) == 21
    np.testing.assert_array_equal(drives[:6], np.concatenate([np.eye(3), -1j * np.eye(3)]))
