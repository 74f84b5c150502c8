"""Localization factors of plates that are not linear in their drives, by modes of finite elements and a general solver.

    q̈ + C q̇ + Λ q + N(q) G q = f(t),     N = stiffness/(2 area) · qᵀ G q,     q the amplitudes of the lowest modes

solved with an explicit Runge-Kutta method of eighth order (DOP853), to which the energies are further unknowns.
"""

import itertools
import math

import numpy as np
import scipy

from error_bars.elements import slopes
from error_bars.judge import solve

# Degree of the elements; the most modes and the fewest, up to these multiples of the drive's frequency; relative change
# that ends the refinement.
DEGREE, MOST, FEWEST, HIGHEST, SURE = 9, (90, 150, 250), (40, 80, 160), (25.0, 40.0, 70.0), 1e-3
# Relative tolerance of the steps; places along a moving load's path; points of Gauss's rule within it.
TOLERANCE, PLACES, POINTS = 1e-8, 4000, 24


def true_nonlinear_factor(scene, phasors):
    """Return the localization factor of phasors (actuators,), and what the last refinement changed, as a part of it."""
    found = solve(scene, DEGREE, MOST[-1])
    frequencies = np.sqrt(np.maximum(found.squares, 0)) / (2 * math.pi)
    factors, change = [], math.inf
    for most, fewest, highest in zip(MOST, FEWEST, HIGHEST, strict=True):
        followed = np.count_nonzero(frequencies < highest * scene.drive.frequency)
        factors.append(_factor(scene, found, np.argsort(frequencies)[: np.clip(followed, fewest, most)], phasors))
        if len(factors) > 1:
            change = abs(factors[-2] / factors[-1] - 1)
        if change < SURE:
            break
    return factors[-1], change


def _factor(scene, found, kept, phasors):
    vectors, squares, window = found.vectors[:, kept], found.squares[kept], scene.window
    count, loads = kept.size, vectors.T @ found.loads
    damping, regions = vectors.T @ found.damping @ vectors, found.regions(vectors)
    gradient, stiffness = np.zeros((count, count)), 0.0
    if scene.effects.stretching is not None:
        stiffness, ratio = _membrane(scene)
        plate = found.of_plate(vectors).reshape(-1, count)
        gradient = plate.T @ (slopes(*found.sides, ratio) @ plate)
    moving = _moving_forces(scene, found, vectors)

    def slope(time, state):
        place, velocity = state[:count], state[count : 2 * count]
        pulled = gradient @ place
        tension = stiffness / (2 * math.prod(scene.plate.size)) * (place @ pulled)
        force = loads @ _pressures(scene, phasors, time) + moving(time)
        acceleration = force - squares * place - damping @ velocity - tension * pulled
        inside = time >= window.start
        energies = [inside * (velocity @ region @ velocity) for region in regions]
        return np.concatenate([velocity, acceleration, energies])

    # Tolerances from the size of a mode driven at its resonance for a period.
    times, omega = np.linspace(0, window.end, 200), 2 * math.pi * scene.drive.frequency
    largest = max(np.abs(loads @ _pressures(scene, phasors, time) + moving(time)).max() for time in times)
    sizes = largest / omega**2 * np.repeat([1, omega, omega**2 * window.end], [count, count, 2])
    sizes[-2:] *= largest / omega**2
    state = np.zeros(2 * count + 2)
    breaks = [0, window.start, window.end]
    if scene.effects.moving_load is not None:
        breaks += [scene.effects.moving_load.from_time, scene.effects.moving_load.to_time or 0]
    if scene.drive.burst is not None:
        breaks += [scene.drive.burst.start, scene.drive.burst.start + scene.drive.burst.duration]
    breaks = np.unique([time for time in breaks if time <= window.end])
    for begin, end in itertools.pairwise(breaks):
        shift = 1e-12 * window.end  # the beginning belongs to the piece that it begins
        solved = scipy.integrate.solve_ivp(
            slope, (begin + shift, end - shift), state, "DOP853", rtol=TOLERANCE, atol=TOLERANCE * sizes,
            max_step=0.25 / scene.drive.frequency,
        )  # fmt: skip
        state = solved.y[:, -1]
    return state[-1] / state[-2]


def _membrane(scene):
    """Return the stiffness of the plate's middle plane along x [N/m], and that along y as a part of it."""
    plate, flat = scene.plate, scene.effects.orthotropic
    along, across = (flat.Dx, flat.Dy) if flat else (plate.rigidity, plate.rigidity)
    return 12 * along / plate.thickness**2, math.sqrt(across / along)


def _pressures(scene, phasors, time):
    """Return the pressures (actuators,)."""
    frequencies = np.array([actuator.frequency or scene.drive.frequency for actuator in scene.actuators])
    voltage = np.abs(phasors) * np.cos(2 * math.pi * frequencies * time + np.angle(phasors))
    burst, square = scene.drive.burst, scene.drive.electrostatic
    if burst is not None:
        since = min(time - burst.start, burst.start + burst.duration - time)
        rise = 1 if not burst.ramp else (1 - math.cos(math.pi * min(max(since / burst.ramp, 0), 1))) / 2
        voltage = voltage * rise * (since >= 0)
    return voltage if square is None else square.gain * (square.bias + voltage) ** 2


def _moving_forces(scene, found, vectors):
    """Return a function of time: the forces on the modes by the moving load."""
    load = scene.effects.moving_load
    if load is None:
        return lambda time: 0.0
    plate, begin = found.of_plate(vectors), load.from_time
    end = scene.window.end if load.to_time is None else load.to_time
    times = np.linspace(begin, end, PLACES)
    means = []
    for axis, side in enumerate(found.sides):
        middle = load.start[axis] + load.velocity[axis] * (times - begin)
        length = scene.plate.size[axis]
        if load.size == 0:
            means.append(side.values_at(middle)[0] * ((middle >= 0) & (middle <= length)))
            continue
        s, weights = np.polynomial.legendre.leggauss(POINTS)
        low, high = (np.clip(middle + sign * load.size / 2, 0, length) for sign in (-1, 1))
        points = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * s
        values = side.values_at(points.ravel())[0].reshape(-1, PLACES, POINTS)
        means.append(values @ weights / 2 * (high - low) / load.size)
    forces = load.force * np.einsum("jt,jkm,kt->tm", means[1], plate, means[0], optimize=True)
    table = scipy.interpolate.CubicSpline(times, forces)

    def force(time):
        wave = math.cos(2 * math.pi * load.frequency * time) if load.frequency else 1.0
        return wave * table(time) if begin <= time <= end else 0.0

    return force
