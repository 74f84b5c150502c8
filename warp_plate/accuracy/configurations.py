"""Configurations: the grid, order, loads, time step and precision that a scene can be solved with."""

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

# Weights of loads with which errors fall as fast as the order allows.
LOAD_OF: dict[Order, Load] = {2: "overlap", 4: "moments"}
# Time of a node-step relative to second order in float32, measured with ``warp-plate accuracy``.
RELATIVE_COST = {(2, "float32"): 1.0, (2, "float64"): 1.4, (4, "float32"): 2.0, (4, "float64"): 2.8}
# Nodes along each side of a square plate; each grid has about twice the nodes of the one before.
SIDES = (13, 19, 27, 37, 53, 75, 105, 149, 209, 297, 417)
# Side of the grid on which the time step is varied, and these time steps as fractions of the longest.
BASE_SIDE, TIME_STEP_FRACTIONS = 27, (0.5, 0.25)
# A time step above the stability limit, to show that it is refused.
TOO_LONG = 1.05
# A time step may be this fraction shorter if the window then starts at the end of a step.
ALIGNMENT, MOST_STEPS_TRIED = 0.08, 1000


@dataclass(frozen=True)
class Configuration:
    """Numerical settings of a run."""

    order: Order  # spatial order
    load: Load  # weights of loads and regions
    nodes: tuple[int, int]  # nodes (nx, ny), edges included
    time_step: float | None  # time step [s]; None for the one that ``make_scheme`` chooses
    precision: Precision  # precision of the time steps

    def __str__(self) -> str:
        nx, ny = self.nodes
        return f"{nx} × {ny} nodes, order {self.order}, {self.load}, {self.precision}"


def configuration_of(scene: Scene) -> Configuration:
    """Return the configuration of the scene as written."""
    grid = scene.grid
    return Configuration(grid.order, grid.load, grid.nodes, grid.time_step, grid.precision)


def scene_with(scene: Scene, configuration: Configuration) -> Scene:
    """Return the scene on another grid, with centred damping, which is of second order in time like everything else.

    Raises:
        SceneError: the grid has too few or too many nodes, or the scene cannot have this order.
    """
    effects = scene.effects
    if effects.damping is not None:
        effects = effects.model_copy(update={"damping": effects.damping.model_copy(update={"scheme": "centred"})})
    return scene.with_tables(effects=effects.model_dump(), grid=asdict(configuration))


def highest_order(scene: Scene) -> Order:
    """Return the highest spatial order that the scene allows."""
    return 2 if needs_moment_form(scene) else 4


def bending_wavelength(scene: Scene) -> float:
    """Return the length [m] of a free bending wave at the drive's highest frequency, 2π√(κ/ω)."""
    plate = scene.plate
    kappa = plate.thickness * math.sqrt(plate.young_modulus / (12 * plate.density * (1 - plate.poisson_ratio**2)))
    return math.sqrt(2 * math.pi * kappa / highest_frequency(scene))


def nodes_for(size: tuple[float, float], side: float, order: Order = 2) -> tuple[int, int]:
    """Return (nx, ny) of nearly square cells, as many as a square of ``side`` × ``side`` nodes has."""
    spacing = math.sqrt(size[0] * size[1]) / (side - 1)
    fewest = FEWEST_NODES[order]
    return max(fewest, round(size[0] / spacing) + 1), max(fewest, round(size[1] / spacing) + 1)


def spacing_of(scene: Scene, nodes: tuple[int, int]) -> float:
    """Return the square root of the area of a cell [m]."""
    width, height = scene.plate.size
    return math.sqrt(width / (nodes[0] - 1) * height / (nodes[1] - 1))


def stability_limit(scene: Scene, order: Order, nodes: tuple[int, int]) -> float:
    """Return the largest stable time step [s] with centred damping."""
    return find_limit(scene_with(scene, Configuration(order, LOAD_OF[order], nodes, None, "float64")))[0].time_step


def longest_time_step(scene: Scene, order: Order, nodes: tuple[int, int]) -> float:
    """Return the longest :func:`aligned` time step [s] that the stability limit and the drive allow."""
    longest = min(SAFETY * stability_limit(scene, order, nodes), 1 / (STEPS_A_PERIOD * highest_frequency(scene)))
    return aligned(scene, longest)


def aligned(scene: Scene, longest: float) -> float:
    """Return a time step [s] of at most ``longest`` that divides the run, and if possible the time before the window.

    If the window starts within a step, a part of that step is counted or lost, which is an error of first order.
    """
    window = scene.window
    fewest = math.ceil(window.end / longest * (1 - 1e-12))
    steps = fewest + np.arange(min(int(ALIGNMENT * fewest), MOST_STEPS_TRIED) + 1)
    before = window.start / window.end * steps
    misalignment = np.round(np.abs(before - np.round(before)), 6)
    return window.end / int(steps[np.argmin(misalignment)])


def node_steps(scene: Scene, configuration: Configuration) -> float:
    """Return the number of moving nodes times the number of steps of a run."""
    nx, ny = configuration.nodes
    step = configuration.time_step
    if step is None:
        step = longest_time_step(scene, configuration.order, configuration.nodes)
    return (nx - 2) * (ny - 2) * scene.window.end / step


def cost_of_run(scene: Scene, configuration: Configuration) -> float:
    """Return the time that a plate takes, in node-steps of second order in float32."""
    return node_steps(scene, configuration) * RELATIVE_COST[configuration.order, configuration.precision]


def make_configurations(scene: Scene) -> list[Configuration]:
    """Return the configurations that ``warp-plate accuracy`` measures, from cheap to expensive."""
    kinds: list[tuple[Order, Load, Precision]] = [
        (2, "nodes", "float32"),
        (2, "overlap", "float32"),
        (4, "moments", "float32"),
        (2, "overlap", "float64"),
        (4, "moments", "float64"),
    ]
    kinds = [kind for kind in kinds if kind[0] <= highest_order(scene)]

    def on_grid(order: Order, load: Load, side: float, precision: Precision) -> Configuration:
        nodes = nodes_for(scene.plate.size, side, order)
        return Configuration(order, load, nodes, longest_time_step(scene, order, nodes), precision)

    made = [on_grid(order, load, side, precision) for side in SIDES for order, load, precision in kinds]
    for order in dict.fromkeys(order for order, _, _ in kinds):
        base = on_grid(order, LOAD_OF[order], BASE_SIDE, "float32")
        longest = longest_time_step(scene, order, base.nodes)
        steps = [aligned(scene, fraction * longest) for fraction in TIME_STEP_FRACTIONS]
        steps.append(TOO_LONG * stability_limit(scene, order, base.nodes))
        made += [replace(base, time_step=step) for step in steps]
    return sorted(dict.fromkeys(made), key=lambda one: cost_of_run(scene, one))
