"""Finds the coarsest grid of one order that keeps an error, with as few trials as the law of that order allows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.accuracy.configurations import (
    LOAD_OF,
    Configuration,
    Order,
    Precision,
    bending_wave,
    longest_time_step,
    node_steps,
    nodes_for,
)
from warp_plate.accuracy.reference_solution import ReferenceSolution
from warp_plate.accuracy.trial_runs import TrialRun, cost_of_run, try_out
from warp_plate.reference.forced import localization_factors
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# The first grid tried: cells in a bending wave of the driven plate for an error of 1 % with fourth order.
CELLS_A_WAVE = 6.3
FIRST_SIDES = (12.0, 120.0)
# The fewest: coarser grids may agree with each other and be wrong.
FEWEST_CELLS_A_WAVE = 4.0
# Sides that differ by less are not worth another trial; a trial may take a side this much shorter than the last.
CLOSE_ENOUGH = 1.06
BOLDNESS = 0.6
# A grid that keeps the error is confirmed by one with so many times the nodes a side; that often it may fail to be.
STEADY, CHANCES = 1.2, 4
# Grids tried for one order and precision, and what is out of question: node-steps of a plate, nodes of a side.
TRIALS, MOST_NODE_STEPS, MOST_NODES = 10, 2e10, 8193


@dataclass(frozen=True)
class Aim:
    """scene; its truth; error: the largest that is kept, relative; device to try on; asked: (drives, actuators) beside
    the usual ones."""

    scene: Scene
    truth: ReferenceSolution
    error: float
    device: str
    asked: np.ndarray | None = None

    def first_side(self) -> float:
        """A guess of what fourth order takes."""
        cells = CELLS_A_WAVE * self._waves() * (0.01 / self.error) ** 0.25
        return min(max(1 + cells, FIRST_SIDES[0]), FIRST_SIDES[1])

    def _waves(self) -> float:
        """Bending waves along the side of a square as large as the plate."""
        return math.sqrt(math.prod(self.scene.plate.size)) / bending_wave(self.scene)

    def configuration(self, order: Order, precision: Precision, side: float) -> Configuration:
        """As coarse in time as the limits allow, and with so many cells a wave that the grid can carry it."""
        nodes = nodes_for(self.scene.plate.size, max(side, 1 + FEWEST_CELLS_A_WAVE * self._waves()), order)
        return Configuration(order, LOAD_OF[order], nodes, longest_time_step(self.scene, order, nodes), precision)

    def drives(self) -> np.ndarray:
        """(drives, actuators): best single actuator, best drive, all actuators alike, and those asked for."""
        alike = np.ones(len(self.scene.actuators))
        usual = np.array([self.truth.drives["single"], self.truth.drives["best"], alike])
        return usual if self.asked is None else np.concatenate([usual, self.asked])

    def attempt(self, configuration: Configuration) -> TrialRun:
        """The error of :meth:`drives`; infinite where the grid cannot be had."""
        drives = self.drives()
        try:
            return try_out(
                self.scene, configuration, drives, localization_factors(self.truth.matrices, drives), self.device
            )
        except SceneError:  # too coarse for an actuator
            return TrialRun(configuration, math.inf, cost_of_run(self.scene, configuration))

    def needed(self, trial: TrialRun) -> Configuration:
        """The grid that would keep the error by the law of the trial's order."""
        factor = max(1.0, trial.error / self.error) ** (1 / trial.configuration.order)
        return finer(self.scene, trial.configuration, factor)


def finer(scene: Scene, configuration: Configuration, factor: float) -> Configuration:
    """With so many times the cells along each side."""
    nx, ny = (math.ceil(factor * (count - 1) - 1e-9) + 1 for count in configuration.nodes)
    step = longest_time_step(scene, configuration.order, (nx, ny))
    return replace(configuration, nodes=(nx, ny), time_step=step)


def confirmed(aim: Aim, order: Order, precision: Precision, first: float, ceiling: float = math.inf) -> TrialRun:
    """As :func:`cheapest`, but a somewhat finer grid keeps the error as well.

    Errors of coarse grids may pass through zero; what is right by such a chance is not taken.
    """
    too_coarse = 0.0
    trial = cheapest(aim, order, precision, first, ceiling)
    for _ in range(CHANCES):
        if trial.error > aim.error:
            break
        second = aim.attempt(finer(aim.scene, trial.configuration, STEADY))
        if second.error <= aim.error:
            break
        too_coarse = math.sqrt(math.prod(trial.configuration.nodes)) * CLOSE_ENOUGH
        trial = cheapest(aim, order, precision, STEADY * too_coarse, ceiling, too_coarse)
    else:
        return replace(trial, error=math.inf)
    return trial


def cheapest(
    aim: Aim,
    order: Order,
    precision: Precision,
    first: float,
    ceiling: float = math.inf,
    too_coarse: float = 0.0,
) -> TrialRun:
    """The coarsest grid found that keeps the error, else the last one tried.

    first: nodes of a side to begin with; ceiling: a cost. No search where keeping the error would cost much more.
    too_coarse: nodes of a side that are known not to do.
    """
    best, last, keeps = None, None, math.inf
    side = first
    for _ in range(TRIALS):
        configuration = aim.configuration(order, precision, side)
        impossible = node_steps(aim.scene, configuration) > MOST_NODE_STEPS or max(configuration.nodes) > MOST_NODES
        if impossible or (last is not None and configuration == last.configuration):
            break
        last = aim.attempt(configuration)
        if last.error <= aim.error:
            best, keeps = last, side
        else:
            too_coarse = max(too_coarse, side)
        if best is None:
            if math.isfinite(last.error) and cost_of_run(aim.scene, aim.needed(last)) > 2 * ceiling:
                break
            side = min(max(1.01 * _predicted(aim, last, side), side + 1), 2 * side)
        else:
            if keeps <= CLOSE_ENOUGH * too_coarse:
                break
            side = _coarser(_predicted(aim, last, side), too_coarse, keeps)
    return best or last or TrialRun(configuration, math.inf, math.inf)


def _predicted(aim: Aim, trial: TrialRun, side: float) -> float:
    """Nodes of a side at which the error would be the one aimed at, by the law of the trial's order."""
    if not math.isfinite(trial.error):
        return 1.5 * side
    return 1 + (side - 1) * (trial.error / aim.error) ** (1 / trial.configuration.order)


def _coarser(predicted: float, too_coarse: float, keeps: float) -> float:
    """Between a side that is too short and one that is enough: where the law says, else in the middle."""
    lowest = max(BOLDNESS * keeps, CLOSE_ENOUGH * too_coarse)
    if predicted >= keeps:
        return math.sqrt(max(lowest, 1.0) * keeps)
    return min(max(1.02 * predicted, lowest), keeps - 1)
