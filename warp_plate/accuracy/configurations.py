"""Configurations: the numerics that a scene can be solved with, its physics staying as written."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np

from warp_plate.plate.operator import FEWEST_NODES
from warp_plate.plate.scheme import SAFETY, STEPS_A_PERIOD
from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.stability_limit import find_limit, needs_moment_form
from warp_plate.scene.model import Scene

Order = Literal[2, 4]
Load = Literal["overlap", "nodes", "moments"]
Precision = Literal["float32", "float64"]

# How loads are weighed where the errors are to fall as fast as the order allows.
LOAD_OF: dict[Order, Load] = {2: "overlap", 4: "moments"}
# Nodes of a side of a square plate, from coarse to fine: each grid has about twice the nodes of the one before.
LADDER = (13, 19, 27, 37, 53, 75, 105, 149, 209, 297, 417)
# The grid on which time steps are varied, and these steps as parts of the longest one.
BASE = 27
TIME_STEP_PARTS = (0.5, 0.25)
# A step above the stability limit, to show that it is refused.
TOO_LONG = 1.05
# A step may be shorter than the longest by this part, if then the window starts at the end of a step.
ALIGNMENT = 0.08
MOST_STEPS_TRIED = 1000


@dataclass(frozen=True)
class Configuration:
    """order; load; nodes: (nx, ny), edges included; time_step [s], None: what ``make_scheme`` chooses; precision."""

    order: Order
    load: Load
    nodes: tuple[int, int]
    time_step: float | None
    precision: Precision

    def __str__(self) -> str:
        nx, ny = self.nodes
        return f"{nx} × {ny} nodes, order {self.order}, {self.load}, {self.precision}"


def configuration_of(scene: Scene) -> Configuration:
    """What the scene itself says."""
    grid = scene.grid
    return Configuration(grid.order, grid.load, grid.nodes, grid.time_step, grid.precision)


def scene_with(scene: Scene, configuration: Configuration) -> Scene:
    """The scene on another grid, with centred damping, which is second order in time as all else is.

    Raises:
        SceneError: fewer nodes than the order takes, too many, or an order that the scene cannot have.
    """
    damping = scene.effects.damping
    effects = scene.effects
    if damping is not None:
        effects = effects.model_copy(update={"damping": damping.model_copy(update={"scheme": "centred"})})
    return scene.with_tables(effects=effects.model_dump(), grid=asdict(configuration))


def highest_order(scene: Scene) -> Order:
    """Four where the scene allows it."""
    return 2 if needs_moment_form(scene) else 4


def bending_wave(scene: Scene) -> float:
    """Length [m] of a free bending wave at the drive's highest frequency, 2π√(κ/ω)."""
    return math.sqrt(2 * math.pi * _kappa(scene) / highest_frequency(scene))


def _kappa(scene: Scene) -> float:
    plate = scene.plate
    return plate.thickness * math.sqrt(plate.young_modulus / (12 * plate.density * (1 - plate.poisson_ratio**2)))


def nodes_for(size: tuple[float, float], side: float, order: Order = 2) -> tuple[int, int]:
    """(nx, ny) with as many cells as a square of ``side`` × ``side`` nodes has, near to squares."""
    spacing = math.sqrt(size[0] * size[1]) / (side - 1)
    few = FEWEST_NODES[order]
    return max(few, round(size[0] / spacing) + 1), max(few, round(size[1] / spacing) + 1)


def spacing_of(scene: Scene, nodes: tuple[int, int]) -> float:
    """Root of the area of a cell [m]."""
    width, height = scene.plate.size
    return math.sqrt(width / (nodes[0] - 1) * height / (nodes[1] - 1))


def stability_limit(scene: Scene, order: Order, nodes: tuple[int, int]) -> float:
    """Largest stable time step [s] with centred damping."""
    return find_limit(scene_with(scene, Configuration(order, LOAD_OF[order], nodes, None, "float64")))[0].time_step


def longest_time_step(scene: Scene, order: Order, nodes: tuple[int, int]) -> float:
    """As long as the stability limit, the drive and the window allow, ending with a step; see :func:`fitted`."""
    longest = min(SAFETY * stability_limit(scene, order, nodes), 1 / (STEPS_A_PERIOD * highest_frequency(scene)))
    return fitted(scene, longest)


def fitted(scene: Scene, longest: float) -> float:
    """A time step [s] of at most ``longest`` that divides the run, and if possible the time before the window.

    Where the window starts inside a step, a part of that step is counted or lost: an error of first order.
    """
    window = scene.window
    fewest = math.ceil(window.end / longest * (1 - 1e-12))

    steps = fewest + np.arange(min(int(ALIGNMENT * fewest), MOST_STEPS_TRIED) + 1)
    before = window.start / window.end * steps
    missed = np.round(np.abs(before - np.round(before)), 6)
    return window.end / int(steps[np.argmin(missed)])


def node_steps(scene: Scene, configuration: Configuration) -> float:
    """Nodes that move × steps of a run, without making its arrays."""
    nx, ny = configuration.nodes
    step = configuration.time_step
    if step is None:
        step = longest_time_step(scene, configuration.order, configuration.nodes)
    return (nx - 2) * (ny - 2) * scene.window.end / step


def make_configurations(scene: Scene) -> list[Configuration]:
    """All that the command tries, from cheap to dear: families of grids, time steps, both precisions.

    The scene as written is not among them: its damping scheme may differ too.
    """
    kinds: list[tuple[Order, Load, Precision]] = [
        (2, "nodes", "float32"),
        (2, "overlap", "float32"),
        (4, "moments", "float32"),
        (2, "overlap", "float64"),
        (4, "moments", "float64"),
    ]
    orders: tuple[Order, ...] = (2, 4) if highest_order(scene) == 4 else (2,)
    known = [kind for kind in kinds if kind[0] in orders]
    family = [_usual(scene, order, load, side, precision) for side in LADDER for order, load, precision in known]
    for order in orders:
        base = _usual(scene, order, LOAD_OF[order], BASE, "float32")
        usual = longest_time_step(scene, order, base.nodes)
        steps = [fitted(scene, part * usual) for part in TIME_STEP_PARTS]
        steps.append(TOO_LONG * stability_limit(scene, order, base.nodes))
        family += [replace(base, time_step=step) for step in steps]
    family = list(dict.fromkeys(family))
    return sorted(family, key=lambda one: node_steps(scene, one))


def _usual(scene: Scene, order: Order, load: Load, side: float, precision: Precision) -> Configuration:
    """With the longest time step."""
    nodes = nodes_for(scene.plate.size, side, order)
    return Configuration(order, load, nodes, longest_time_step(scene, order, nodes), precision)
