"""Solutions beside the modes of a plate: the lowest alone, with fewer functions to show errors, or with responses."""

import math
from collections.abc import Collection

import numpy as np
import scipy

from warp_plate.modal.assemble import Galerkin, make_galerkin, unit_loads
from warp_plate.modal.eigenproblem import factorised, solve_eigenproblem
from warp_plate.modal.modes import MOST_ALONE, ModalPlate, damped_modes, solve_modes
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.modal.spaces.knots import intervals_for, plate_splines
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.plate.section import laminate_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import SceneSource

# Derivatives that are continuous where the load of a force, or the moment of a piezo patch, jumps; and the most
# actuators whose edges are followed, as each adds functions along both sides.
SMOOTH, SMOOTH_OF_PIEZO, MOST_FOLLOWED = 3, 1, 8
# Modes up to REACH times the highest frequency, and FURTHER ones, besides the responses; most functions.
REACH, FURTHER, MOST_FUNCTIONS = 4.0, 12, 12000
# Times that the response to the inertia of the responses before is added, for damping that is known by modes alone.
TIMES = 2
DEPENDENT = 1e-15  # part of the largest energy from which on a response adds nothing to others


def modes_below(scene: SceneSource, highest: float, key: str = "highest frequency") -> ModalPlate:
    """Return the modes of a linear scene up to a natural frequency [Hz], without those above, which cost most;
    SceneError: there is none, which the error says of ``key``, or see :func:`solve_modes`."""
    plate = solve_modes(scene, highest, alone=True, most=MOST_ALONE, key=f"{key} {highest:g}")
    plate = plate.part(np.flatnonzero(plate.frequencies <= highest))
    if not plate.frequencies.size:
        raise SceneError(f"{key} {highest:g}: the plate has no mode up to it; take a higher one")
    return plate


def coarser_modes(plate: ModalPlate, density: float) -> ModalPlate:
    """Return the modes of a plate by fewer functions along each side, by a factor ``density`` below 1.

    Where the highest modes of many functions are left out, it has fewer modes too: else its responses would lack the
    same part, and not show how large it is.
    """
    scene, modes = plate.scene, len(plate.frequencies)
    coarser = solve_modes(scene, plate.highest / scene.grid.modal_density, density=density)
    if 2 * modes >= plate.space.unknowns:
        return coarser
    return coarser.part(np.arange(len(coarser.frequencies))[: math.ceil(density**2 * modes)])


def modes_with_responses(plate: ModalPlate, frequencies: Collection[float], density: float) -> ModalPlate | None:
    """Return the lowest modes of a plate and, in place of higher ones, its responses to the actuators at frequencies
    [Hz], by more functions along each side by a factor ``density``, which follow the edges of actuators; None for a
    plate with an outline or in air, or where the functions would be too many.

    At these frequencies its responses lack no mode, so that only the functions limit how right they are.
    """
    scene = plate.scene
    if scene.outline is not None or scene.effects.air is not None:
        return None
    laminate, followed = laminate_of(scene), [actuator.area for actuator in scene.actuators if actuator.area]
    smooth, wave = SMOOTH_OF_PIEZO if scene.piezo else SMOOTH, mean_wave_frequency(laminate)
    intervals = intervals_for(scene.plate.size, None, plate.highest, wave, density * scene.grid.modal_density)
    edges = followed if len(followed) <= MOST_FOLLOWED else []
    places = [[(place, smooth) for area in edges for place in area[2 * axis : 2 * axis + 2]] for axis in (0, 1)]
    x, y = (plate_splines(laminate, scene.edges, axis, intervals[axis], places[axis]) for axis in (0, 1))
    if x.functions * y.functions > MOST_FUNCTIONS:
        return None
    galerkin = make_galerkin(scene, TensorSplines(scene, intervals, (x, y)))
    squares, vectors = np.empty(0), np.empty((galerkin.mass.shape[0], 0))
    if galerkin.losses.by_modes:
        wanted = math.ceil(math.pi / 4 * scene.plate.area * REACH * plate.highest / wave) + FURTHER
        squares, vectors = solve_eigenproblem(galerkin, wanted, (2 * math.pi * wave / max(scene.plate.size) ** 2) ** 2)
    loads = np.pad(unit_loads(galerkin), ((0, len(vectors) - galerkin.space.unknowns), (0, 0)))
    columns = []
    for omega in 2 * math.pi * np.array(sorted(frequencies)):
        solve, column = factorised(_dynamic_stiffness(galerkin, omega)).solve, loads
        for _ in range(TIMES):
            response = solve(column.astype(complex))
            columns += [response.real, response.imag]
            column = galerkin.mass @ response
    responses = np.concatenate(columns, axis=1)
    energies = (responses * (galerkin.mass @ responses)).sum(axis=0)
    responses = responses[:, energies > 0] / np.sqrt(energies[energies > 0])
    for _ in range(2):  # once more, for the rounding of the first
        responses -= vectors @ (vectors.T @ (galerkin.mass @ responses))
        energies, turn = scipy.linalg.eigh(responses.T @ (galerkin.mass @ responses))
        kept = energies > DEPENDENT * energies[-1]
        responses = responses @ (turn[:, kept] / np.sqrt(energies[kept]))
    more, turn = scipy.linalg.eigh(responses.T @ (galerkin.stiffness @ responses))
    return damped_modes(
        galerkin, np.append(squares, more), np.concatenate([vectors, responses @ turn], axis=1), plate.highest
    )


def _dynamic_stiffness(galerkin: Galerkin, omega: float) -> scipy.sparse.csc_array:
    """Return the matrix K − ω²M + iωC [N/m] with the damping of the material; that of modes is roughly the last's."""
    lost = galerkin.losses
    ratio, loss = (0.0 if of is None else float(np.atleast_1d(of)[-1]) for of in (lost.ratios, lost.loss_factors))
    bending = 1j * (lost.hysteretic + omega * lost.retardation)
    matrix = (1 + 1j * (2 * ratio + loss)) * galerkin.stiffness + bending * galerkin.bending
    return scipy.sparse.csc_array(matrix - omega**2 * galerkin.mass + 1j * omega * galerkin.damping)
