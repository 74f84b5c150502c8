"""Localization factors of linear plates by a program that shares no code with the engines it judges.

Modes of finite elements (:mod:`elements`). Steady responses solve for the amplitudes of all modes; motion from rest is
propagated by one matrix exponential a step, exact for the tone, and its energy is summed over the steps of the window.
Modes above those that are kept follow the tone without inertia of their own: what they add to the steady response.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from error_bars.elements import Side, Sparse, bending_of, density_at, lowest_modes, matrices, shift_of
from warp_plate import Scene

# Modes that are solved for once more.
LOWEST = 20
# Modes from rest, and steps in a period of the highest one and in a period of the drive.
MODES, STEPS_A_MODE, STEPS_A_PERIOD = 260, 10, 200
# Gauss's points along the radius of a disc, and points around it.
RADIUS, AROUND = 40, 128


# Lines between elements, as parts of a side; the outer ones follow singular corners and edges.
INNER, INNER_OF_LAYERS = (0.05, 0.35, 0.65, 0.95), (0.05, 0.5, 0.95)


def true_factors(scene, phasors, degree=11):
    """Return the localization factors (n,) of phasors (n, actuators) under the tone of the scene's drive."""
    found = solve(scene, degree, MODES)
    squares, vectors, loads, damping = found.squares, found.vectors, found.loads, found.modal_damping
    omega = 2 * math.pi * scene.drive.frequency
    shapes = np.hstack([vectors, _residual(found, omega**2)])
    forces, regions = vectors.T @ loads @ phasors.T, found.regions(shapes)
    if scene.effects.loss_factor is not None:
        lossy = scene.effects.loss_factor.eta * found.bending
        dynamic = np.diag(squares - omega**2) + 1j * lossy
        amplitude = np.linalg.solve(dynamic + 1j * omega * damping, forces)
        amplitude = np.vstack([amplitude, phasors.T])
        energies = [np.einsum("ip,ij,jp->p", amplitude.conj(), region, amplitude).real for region in regions]
    else:
        energies = _from_rest(scene, squares, damping, forces, phasors.T, regions)
    return energies[1] / energies[0]


@dataclass
class Modes:
    """The lowest modes of a plate, and what they are modes of."""

    scene: Scene
    sides: list  # functions along x and y
    stiffness: Sparse
    mass: Sparse
    damping: Sparse
    bending: np.ndarray  # (modes, modes) bending energies of the modes
    loads: np.ndarray  # (unknowns, actuators) unit pressures
    squares: np.ndarray  # ω² [1/s²]
    vectors: np.ndarray  # (unknowns, modes)

    @property
    def modal_damping(self):
        """Viscous damping of the modes."""
        material = self.scene.effects.material_damping
        return self.vectors.T @ (self.damping @ self.vectors) + (material.time if material else 0) * self.bending

    def of_plate(self, shapes):
        """Return shapes (functions along y, functions along x, shapes) without the oscillators' masses."""
        counts = [side.kept.size for side in self.sides]
        return shapes[: counts[0] * counts[1]].reshape(counts[1], counts[0], -1)

    def regions(self, shapes):
        """Return the mass matrices of plate and target over shapes."""
        whole, plate = shapes.T @ (self.mass @ shapes), self.of_plate(shapes)
        first = plate.shape[0] * plate.shape[1]
        for index, oscillator in enumerate(item for item in self.scene.effects.oscillators if item.mass):
            moved = shapes[first + index]
            whole = whole - oscillator.mass * np.outer(moved, moved)
        return [whole, _target(self.scene, self.sides, plate)]


def solve(scene, degree, count):
    """Return the lowest modes."""
    inner = INNER_OF_LAYERS if scene.effects.layers else INNER
    sides = [Side(scene, axis, degree, inner) for axis in (0, 1)]
    bending, support, mass, damping = matrices(scene, *sides)
    stiffness = bending + support
    squares, vectors = lowest_modes(stiffness, mass, count, shift_of(scene))
    loads = np.zeros((mass.shape[0], len(scene.actuators)))
    for column, actuator in zip(loads.T, scene.actuators, strict=True):
        along_x, along_y = (side.integral(*actuator.area[2 * axis : 2 * axis + 2]) for axis, side in enumerate(sides))
        column[: along_x.size * along_y.size] = np.outer(along_y, along_x).ravel()
    found = Modes(scene, sides, stiffness, mass, damping, bending, loads, squares, vectors)
    # The lowest modes once more, without the rounding of the matrices.
    low = vectors[:, :LOWEST]
    bent = bending_of(scene, *sides, found.of_plate(low))
    squares[:LOWEST], turned = scipy.linalg.eigh(bent + low.T @ support @ low)
    vectors[:, :LOWEST] = low @ turned
    found.bending = vectors.T @ (bending @ vectors)
    found.bending[:LOWEST, :LOWEST] = turned.T @ bent @ turned
    return found


def _residual(found, square):
    """Return what modes that are left out add to the undamped steady displacement (unknowns, loads)."""
    stiffness = found.stiffness - square * found.mass
    units = scipy.sparse.diags_array(1 / np.sqrt((found.stiffness + shift_of(found.scene) * found.mass).diagonal()))
    whole = units @ scipy.sparse.linalg.splu(scipy.sparse.csc_array(units @ stiffness @ units)).solve(
        units @ found.loads
    )
    return whole - found.vectors @ ((found.vectors.T @ found.loads) / (found.squares - square)[:, None])


def _target(scene, sides, shapes):
    """Return the mass matrix of the target over the modes, from their values at points of a rule."""
    target = scene.target
    if target.area is not None:
        x, y = (side.rule(*target.area[2 * axis : 2 * axis + 2]) for axis, side in enumerate(sides))
        across = np.einsum("jkm,kx->jxm", shapes, sides[0].values_at(x[0])[0])
        values = np.einsum("jxm,jy->yxm", across, sides[1].values_at(y[0])[0]).reshape(y[0].size * x[0].size, -1)
        weights = (np.outer(y[1], x[1]) * density_at(scene, x[0], y[0])).ravel()
    else:
        x, y, weights = (_disc if target.disc is not None else _polygon)(target)
        weights *= np.array([density_at(scene, np.array([a]), np.array([b]))[0, 0] for a, b in zip(x, y, strict=True)])
        of_x, of_y = sides[0].values_at(x)[0], sides[1].values_at(y)[0]
        parts = np.array_split(np.arange(x.size), 16)
        values = np.vstack([
            np.einsum("kp,pkm->pm", of_x[:, part], np.tensordot(of_y[:, part].T, shapes, 1)) for part in parts
        ])  # fmt: skip
    return values.T @ (weights[:, None] * values)


def _disc(target):
    """Return points and weights of a rule over a disc."""
    centre_x, centre_y, radius = target.disc
    s, along = np.polynomial.legendre.leggauss(RADIUS)
    r, angle = radius * (1 + s) / 2, 2 * math.pi * np.arange(AROUND) / AROUND
    weights = np.repeat(along * radius / 2 * r, AROUND) * 2 * math.pi / AROUND
    return centre_x + np.outer(r, np.cos(angle)).ravel(), centre_y + np.outer(r, np.sin(angle)).ravel(), weights


def _polygon(target):
    """Return points and weights of a rule over a convex polygon, by triangles from its first corner."""
    s, weights = np.polynomial.legendre.leggauss(RADIUS)
    s, weights = (1 + s) / 2, weights / 2
    far, across = (part.ravel() for part in np.meshgrid(s, s, indexing="ij"))
    corners, found = np.array(target.polygon), []
    for second, third in pairwise(corners[1:]):
        first, (u, v) = corners[0], (second - corners[0], third - corners[0])
        points = first + far[:, None] * ((1 - across)[:, None] * u + across[:, None] * v)
        area = abs(u[0] * v[1] - u[1] * v[0])
        found.append(np.column_stack([points, np.outer(weights, weights).ravel() * far * area]))
    return np.concatenate(found).T


def _from_rest(scene, squares, damping, forces, phasors, regions):
    """Return the energies of motion from rest, in any unit."""
    omega, window, count = 2 * math.pi * scene.drive.frequency, scene.window, len(squares)
    fastest = max(STEPS_A_MODE * math.sqrt(squares.max()), STEPS_A_PERIOD * omega) / (2 * math.pi)
    length = window.end - window.start
    steps = 2 * math.ceil(length * fastest / 2)
    before = math.ceil(window.start * fastest) if window.start else 0
    energies = np.zeros((2, forces.shape[1]))
    for drive in range(forces.shape[1]):
        system = np.zeros((2 * count + 2, 2 * count + 2))
        system[:count, count : 2 * count] = np.eye(count)
        system[count : 2 * count, :count], system[count : 2 * count, count : 2 * count] = -np.diag(squares), -damping
        # The tone as two states, cos ωt and sin ωt.
        system[count : 2 * count, -2], system[count : 2 * count, -1] = forces[:, drive].real, -forces[:, drive].imag
        system[-2, -1], system[-1, -2] = -omega, omega
        state = np.zeros(2 * count + 2)
        state[-2] = 1
        if before:
            state = np.linalg.matrix_power(scipy.linalg.expm(system * (window.start / before)), before) @ state
        step = scipy.linalg.expm(system * (length / steps))
        velocity = np.empty((steps + 1, len(regions[0])))
        for index in range(steps + 1):
            velocity[index, :count] = state[count : 2 * count]
            velocity[index, count:] = (1j * omega * phasors[:, drive] * (state[-2] + 1j * state[-1])).real
            state = step @ state
        weights = np.ones(steps + 1)
        weights[1:-1:2], weights[2:-1:2] = 4, 2  # Simpson's rule
        for row, region in zip(energies, regions, strict=True):
            row[drive] = weights @ ((velocity @ region) * velocity).sum(axis=1)
    return energies
