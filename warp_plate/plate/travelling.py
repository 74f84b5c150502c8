"""A load that travels over the plate, as three factors for each step: its pressure, and its shares along x and y.

    pressure at node (j, i) and step n = wave[n] · along_y[n, j] · along_x[n, i]

A patch of a cell or more has the weights of an actuator. A smaller one would jump from node to node by overlap, so each
node takes the mean over the patch of its hat function, which keeps the force and its moment.
"""

import math
from typing import NamedTuple

import numpy as np

from warp_plate.effects.moving_load import MovingLoad
from warp_plate.effects.table import TRAVELLING
from warp_plate.plate.shapes import Axis, lagrange
from warp_plate.plate.waveforms import step_means
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# A side below this part of a cell is a point: the difference is a millionth of the error of the weights.
POINT = 1e-3


class MovingWeights(NamedTuple):
    """Factors of a moving load."""

    wave: np.ndarray  # (steps,) [N/m²], the first one halved as in ``signals``
    along_x: np.ndarray  # (steps, nx) shares
    along_y: np.ndarray  # (steps, ny) shares

    @property
    def largest(self) -> float:
        """Largest magnitude of the wave [N/m²]."""
        return float(np.abs(self.wave).max())


def moving_weights(scene: Scene, time_step: float, steps: int) -> MovingWeights:
    """Return the factors of a scene's moving load at steps that carry its frequency, see ``signals.check_rate``.

    Σ pressure·hx·hy over all nodes is the force, or its part on the plate. SceneError: it never touches the plate.
    """
    load = scene.effects.travelling
    assert load is not None
    times, presence = time_step * np.arange(steps), _presence(load, scene, 2 * time_step * steps)
    present = step_means(lambda time: np.clip(time, *presence), time_step, steps)
    wave = load.force * present * np.cos(2 * math.pi * (load.frequency or 0.0) * times)
    # Steps that reach beyond its beginning or end have it where it is at that moment.
    since = np.clip(times, load.from_time, load.to_time) - load.from_time
    along = [
        _shares(load.start[axis] + load.velocity[axis] * since, load.size, side, nodes, scene.grid.load == "moments")
        for axis, (side, nodes) in enumerate(zip(scene.plate.size, scene.grid.nodes, strict=True))
    ]
    if not (wave.any() and (along[0].any(axis=1) & along[1].any(axis=1) & (wave != 0)).any()):
        raise SceneError(
            f"{TRAVELLING}.start = {list(load.start)}: the load is never on the plate of "
            f"{list(scene.plate.size)} m during the run; change start, velocity, from_time or force"
        )
    wave /= math.prod(scene.spacing)
    wave[0] /= 2
    return MovingWeights(wave, *along)


def _presence(load: MovingLoad, scene: Scene, latest: float) -> tuple[float, float]:
    """Return begin and end [s] of the force, at most ``latest``, equal if it never acts; a point acts on the plate."""
    begin, end = load.from_time, math.inf if load.to_time is None else load.to_time
    for start, speed, side, nodes in zip(load.start, load.velocity, scene.plate.size, scene.grid.nodes, strict=True):
        spacing, slack = side / (nodes - 1), 1e-12 * side
        if load.size / spacing < POINT and speed != 0:
            ways = sorted((edge - start) / speed + load.from_time for edge in (-slack, side + slack))
            begin, end = max(begin, ways[0]), min(end, ways[1])
    return min(begin, latest), min(max(begin, end), latest)


def _shares(middle: np.ndarray, size: float, side: float, nodes: int, cubic: bool) -> np.ndarray:
    """Return (steps, nodes) shares of the nodes along one axis in a patch around ``middle`` [m]."""
    spacing = side / (nodes - 1)
    # Rounding must not take a path along an edge off the plate.
    centre = middle / spacing
    inside = np.clip(centre, 0, nodes - 1)
    centre = np.where(np.abs(centre - inside) < 1e-12 * nodes, inside, centre)
    width, axis = size / spacing, lagrange(nodes, 4 if cubic else 2)
    if width < POINT:
        # Within a step of driving on or off, the force acts at the edge.
        near = np.abs(centre - inside) <= np.abs(np.diff(centre)).max(initial=0.0)
        interval = axis.interval(inside)
        return near[:, None] * axis.spread(interval, axis.values(interval, inside))
    low, high = (np.clip(centre + sign * width / 2, 0, nodes - 1) for sign in (-1, 1))
    if cubic or width < 1:
        return (_integrals(axis, high) - _integrals(axis, low)) / width
    node = np.arange(nodes)
    covered = np.minimum(node + 0.5, high[:, None]) - np.maximum(node - 0.5, low[:, None])
    shares: np.ndarray = np.maximum(covered, 0) / width
    return shares


def _integrals(axis: Axis, place: np.ndarray) -> np.ndarray:
    """Return (places, nodes) integrals of an axis' functions from 0 to each place [cells]."""
    interval, every = axis.interval(place), np.arange(axis.nodes - 1)
    whole = np.cumsum(axis.spread(every, axis.integrals(every, axis.breaks[1:])), axis=0)
    before = np.concatenate([np.zeros((1, axis.nodes)), whole])[interval]
    return before + axis.spread(interval, axis.integrals(interval, place))
