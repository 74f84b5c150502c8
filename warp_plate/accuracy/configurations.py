"""Configurations: the grid, order, loads, time step and precision that a scene can be solved with; numbers in text."""

import math
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from warp_plate.modal.modes import REACH
from warp_plate.plate.operator import FEWEST_NODES
from warp_plate.plate.scheme import SAFETY, STEPS_A_PERIOD
from warp_plate.plate.signals import highest_frequency, key_of_highest
from warp_plate.plate.stability_limit import find_limit, needs_moment_form
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Window
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device

Order = Literal[2, 4]
Load = Literal["overlap", "nodes", "moments"]
Precision = Literal["float32", "float64"]

# Weights of loads with which errors fall as fast as the order allows.
LOAD_OF: dict[Order, Load] = {2: "overlap", 4: "moments"}
# Nominal time of a node-step of second order in float32 [s], and that of others relative to it, measured with
# ``warp-plate accuracy``.
NODE_STEP_SECONDS = {"cpu": 0.6e-9, "cuda": 2e-11}
RELATIVE_COST = {(2, "float32"): 1.0, (2, "float64"): 1.4, (4, "float32"): 2.0, (4, "float64"): 2.8}
# Cells in a bending wave for an error of 1 % with fourth order. At least so many waves count: patches and targets need
# cells where waves are long.
CELLS_A_WAVE, FEWEST_WAVES = 6.3, 2.4
# Nodes along each side of a square plate; each grid has about twice the nodes of the one before.
SIDES = (13, 19, 27, 37, 53, 75, 105, 149, 209, 297, 417)
# Side of the grid on which the time step is varied, and these time steps as fractions of the longest.
BASE_SIDE, TIME_STEP_FRACTIONS = 27, (0.5, 0.25)
# A time step above the stability limit, to show that it is refused.
TOO_LONG = 1.05
# A time step may be this fraction shorter if the window then starts at the end of a step.
ALIGNMENT, MOST_STEPS_TRIED = 0.08, 1000
# Most modes that are solved for to judge an error.
MOST_MODES = 1000


@dataclass(frozen=True)
class Configuration:
    """Numerical settings of a run."""

    order: Order  # spatial order
    load: Load  # weights of loads and regions
    nodes: tuple[int, int]  # nodes (nx, ny), edges included
    time_step: float | None  # time step [s]; None for the one that ``make_scheme`` chooses
    precision: Precision  # precision of the time steps

    @property
    def grid_text(self) -> str:
        """Nodes, order and load, for people."""
        return f"{self.nodes[0]} × {self.nodes[1]}, order {self.order}, {self.load}"

    def __str__(self) -> str:
        return f"{self.grid_text.replace(',', ' nodes,', 1)}, {self.precision}"


def configuration_of(scene: Scene) -> Configuration:
    """Return the configuration of the scene as written."""
    grid = scene.grid
    return Configuration(grid.order, grid.load, grid.nodes, grid.time_step, grid.precision)


def regrid(scene: Scene, configuration: Configuration) -> Scene:
    """Return the scene on another grid, with centred damping, which is of second order in time."""
    effects = scene.effects
    if effects.damping is not None:
        effects = effects.model_copy(update={"damping": effects.damping.model_copy(update={"scheme": "centred"})})
    return scene.with_tables(effects=effects.model_dump(), grid=asdict(configuration))


def highest_order(scene: Scene) -> Order:
    """Return the highest spatial order that the scene allows."""
    return 2 if needs_moment_form(scene) else 4


def bending_wavelength(scene: Scene) -> float:
    """Return the length [m] of a free bending wave at the drive's highest frequency, 2π√(κ/ω)."""
    return math.sqrt(2 * math.pi * scene.plate.kappa / highest_frequency(scene))


def waves_along(scene: Scene) -> float:
    """Return the number of bending waves along the side of a square with the plate's area."""
    return math.sqrt(math.prod(scene.plate.size)) / bending_wavelength(scene)


def refuse_many_modes(scene: Scene) -> None:
    """Refuse a scene with more than MOST_MODES modes, with a SceneError."""
    # By Weyl's law, those of a square wave number up to REACH times that of the drive.
    modes = math.pi * REACH * math.prod(scene.plate.size) / bending_wavelength(scene) ** 2
    if modes > MOST_MODES:
        width, height = scene.plate.size
        limit = f"at most {MOST_MODES} are computed (the plate is {width:g} × {height:g} m)"
        raise SceneError(f"{key_of_highest(scene)}: {modes:.0f} modes would be needed; {limit}")


def nodes_for(size: tuple[float, float], side: float, order: Order = 2) -> tuple[int, int]:
    """Return (nx, ny) of nearly square cells, as many as a square of ``side`` × ``side`` nodes has."""
    spacing = math.sqrt(size[0] * size[1]) / (side - 1)
    fewest = FEWEST_NODES[order]
    return max(fewest, round(size[0] / spacing) + 1), max(fewest, round(size[1] / spacing) + 1)


def spacing_of(size: tuple[float, float], nodes: tuple[int, int]) -> float:
    """Return the square root of the area of a cell [m] of a plate with these sides [m]."""
    return math.sqrt(size[0] / (nodes[0] - 1) * size[1] / (nodes[1] - 1))


def stability_limit(scene: Scene, order: Order, nodes: tuple[int, int]) -> float:
    """Return the largest stable time step [s] with centred damping."""
    return find_limit(regrid(scene, Configuration(order, LOAD_OF[order], nodes, None, "float64")))[0].time_step


def longest_time_step(scene: Scene, order: Order, nodes: tuple[int, int]) -> float:
    """Return the longest :func:`aligned` time step [s] that the stability limit and the drive allow."""
    longest = min(SAFETY * stability_limit(scene, order, nodes), 1 / (STEPS_A_PERIOD * highest_frequency(scene)))
    return aligned(scene.window, longest)


def aligned(window: Window, longest: float) -> float:
    """Return a time step [s] up to ``longest`` that divides the run, and if possible the time before the window."""
    fewest = math.ceil(window.end / longest * (1 - 1e-12))
    # If the window starts within a step, a part of that step is counted or lost, which is an error of first order.
    steps = fewest + np.arange(min(int(ALIGNMENT * fewest), MOST_STEPS_TRIED) + 1)
    before = window.start / window.end * steps
    misalignment = np.round(np.abs(before - np.round(before)), 6)
    return window.end / int(steps[np.argmin(misalignment)])


def make_configuration(scene: Scene, order: Order, nodes: tuple[int, int]) -> Configuration:
    """Return the configuration in float32 with the loads that the order needs and the longest time step."""
    return Configuration(order, LOAD_OF[order], nodes, longest_time_step(scene, order, nodes), "float32")


def refine(scene: Scene, configuration: Configuration, factor: float) -> Configuration:
    """Return a configuration with ``factor`` times the cells along each side."""
    nx, ny = (math.ceil(factor * (count - 1) - 1e-9) + 1 for count in configuration.nodes)
    return replace(configuration, nodes=(nx, ny), time_step=longest_time_step(scene, configuration.order, (nx, ny)))


def node_steps(scene: Scene, configuration: Configuration) -> float:
    """Return the number of moving nodes times the number of steps of a run."""
    nx, ny = configuration.nodes
    step = configuration.time_step or longest_time_step(scene, configuration.order, configuration.nodes)
    return (nx - 2) * (ny - 2) * scene.window.end / step


def cost_of_run(scene: Scene, configuration: Configuration) -> float:
    """Return the time that a plate takes, in node-steps of second order in float32."""
    return node_steps(scene, configuration) * RELATIVE_COST[configuration.order, configuration.precision]


def nominal_seconds(scene: Scene, configuration: Configuration, device: str) -> float:
    """Return the nominal time of a plate in a batch [s]."""
    return cost_of_run(scene, configuration) * NODE_STEP_SECONDS["cuda" if find_device(device).is_cuda else "cpu"]


def fourth_order(scene: Scene, error: float) -> Configuration:
    """Return the configuration of fourth order with a relative error, by the law of its convergence."""
    cells = CELLS_A_WAVE * (0.01 / error) ** 0.25 * max(FEWEST_WAVES, waves_along(scene))
    return make_configuration(scene, 4, nodes_for(scene.plate.size, 1 + cells, 4))


def make_configurations(scene: Scene) -> list[Configuration]:
    """Return the configurations that ``warp-plate accuracy`` measures, from cheap to expensive."""
    configurations: list[Configuration] = []
    for order in (order for order in LOAD_OF if order <= highest_order(scene)):
        grids = [make_configuration(scene, order, nodes_for(scene.plate.size, side, order)) for side in SIDES]
        configurations += [replace(grid, load="nodes") for grid in grids if order == 2]
        configurations += [*grids, *(replace(grid, precision="float64") for grid in grids)]
        base = make_configuration(scene, order, nodes_for(scene.plate.size, BASE_SIDE, order))
        longest = longest_time_step(scene, order, base.nodes)
        steps = [aligned(scene.window, fraction * longest) for fraction in TIME_STEP_FRACTIONS]
        steps.append(TOO_LONG * stability_limit(scene, order, base.nodes))
        configurations += [replace(base, time_step=step) for step in steps]
    return sorted(dict.fromkeys(configurations), key=partial(cost_of_run, scene))


def percent(value: float) -> str:
    """Return 0.00853 as "0.85 %", 0.01 as "1 %", and values below 0.001 % with an exponent."""
    return f"{100 * value:.0e} %" if 0 < value < 1e-5 else f"{two_digits(100 * value)} %"


def seconds_text(value: float) -> str:
    """Return a duration with a suitable unit: "2.1 ms"."""
    unit, name = next((unit for unit in ((1.0, "s"), (1e-3, "ms")) if value >= unit[0]), (1e-6, "µs"))
    return f"{two_digits(value / unit)} {name}"


def two_digits(value: float) -> str:
    """Return two digits without exponent or trailing zeros: 410, 4.1, 4, 0.041."""
    if not math.isfinite(value) or value == 0:
        return f"{value:g}"
    decimals = 1 - math.floor(math.log10(abs(value)))
    text = f"{round(value, decimals):.{max(0, decimals)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
