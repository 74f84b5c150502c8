"""Odd scenes and bad plates: nothing to do, two of one, next to nothing, everything; and neighbours of nonsense."""

from __future__ import annotations

import math

import numpy as np

from hard_cases.case import PATCHES, Case, Measured, Where, both, grouped, largest_difference, scene_of
from warp_plate import SceneError
from warp_plate.analysis.warnings import find_warnings
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.model import Scene

PATCH = (0.06, 0.1, 0.05, 0.12)
GENERAL = {"foundation": {"stiffness": 1e4}}


def _run(where: Where, scene: Scene, drives: object):
    return where.solver(scene).run(np.array(drives, dtype=complex), (scene.window.end,))


def no_drive(where: Where) -> Measured:
    """Largest number of a plate that nothing drives, beside one that is driven."""
    run = _run(where, scene_of(), [[0, 0], [1, 1]])
    odd = run.status[0] != "ok" or not math.isnan(localization_factor(run.energy)[0])
    return Measured(math.inf if odd else float(np.abs(run.displacement[0]).max()))


def two_in_one_place(where: Where) -> Measured:
    """Two actuators on one patch against one with their sum; opposite ones leave rounding alone."""
    run = _run(where, scene_of(areas=(PATCH, PATCH)), [[0.3, 0.7], [1.0, -1.0]])
    one = _run(where, scene_of(areas=(PATCH,)), [[1.0]])
    left = np.abs(run.displacement[1]).max() / np.abs(one.displacement).max()
    value = max(largest_difference(run.displacement[0], one.displacement[0]), left)
    return Measured(value)


def smaller_than_a_cell(where: Where) -> Measured:
    """A patch of a hundredth of a cell at a node against one of the whole cell with as much force in all."""
    cell = 0.2 / 12
    node = (6 * cell, 4 * cell)
    areas = [tuple(np.repeat(node, 2) + np.array([-1, 1, -1, 1]) * half * cell) for half in (0.05, 0.5)]
    small, whole = (
        _run(where, scene_of(areas=(area,)), [[force]]) for area, force in zip(areas, (100.0, 1.0), strict=True)
    )
    return Measured(largest_difference(small.displacement, whole.displacement))


def target_of_one_node(where: Where) -> Measured:
    """Its localization factor against the energy of that node's trace."""
    cell = 0.2 / 12
    x, y = 5 * cell, 7 * cell
    area = (x - cell / 2, x + cell / 2, y - cell / 2, y + cell / 2)
    scene = scene_of(target={"area": area})
    run = where.solver(scene).run([[1.0, 0.4j]], (), [(x, y)])
    scheme = make_scheme(scene)
    speed = np.diff(run.trace[0, 0], prepend=0.0)[slice(*scheme.window)] / scheme.time_step
    energy = 0.5 * scheme.surface_density * cell**2 * float((speed**2).mean())
    return Measured(abs(run.energy[0, run.regions.index("target")] / energy - 1))


def whole_plate(where: Where) -> Measured:
    """|LF − 1| where the target is the whole plate."""
    run = _run(where, scene_of(target={"area": (0.0, 0.2, 0.0, 0.2)}), [[1.0, 0.4j]])
    return Measured(float(np.abs(localization_factor(run.energy) - 1).max()))


def beyond_the_grid(where: Where) -> Measured:
    """Count cases that are neither refused nor warned of with their number: a frequency above half the steps' rate,
    and drives whose waves have fewer than ten points."""
    scene = scene_of()
    step = make_scheme(scene).time_step
    missed = 0
    try:
        make_scheme(scene.with_tables(drive={"frequency": 0.51 / step}, grid={**_grid(scene), "time_step": step}))
        missed += 1
    except SceneError as error:
        missed += f"{0.5 / step:.6g}" not in str(error)
    frequencies = np.geomspace(20.0, 0.4 / step, 9)
    points = []
    for frequency in frequencies:
        made = scene.with_tables(drive={"frequency": frequency}, grid={**_grid(scene), "time_step": step})
        (finding,) = (one for one in find_warnings(made, None) if one.name == "points a wavelength")
        points.append(finding.value)
        missed += finding.exceeded != (finding.value < 10) or f"{finding.value:.3g}" not in finding.sentence
    return Measured(float(missed))


def _grid(scene: Scene) -> dict[str, object]:
    return scene.grid.model_dump(exclude={"accuracy", "time_step"})


def bad_neighbours(effects: dict[str, object], plates: int, where: Where) -> Measured:
    """Bits that differ in good plates when every third one of the batch is nonsense, and bad ones not flagged."""
    scene = scene_of((13, 13), effects=effects)
    random = np.random.default_rng(1)
    drives = random.normal(size=(plates, len(PATCHES))) + 1j * random.normal(size=(plates, len(PATCHES)))
    solver, times = where.solver(scene), (0.003, 0.01)
    clean = solver.run(drives, times)
    bad = np.arange(plates) % 3 == 1
    spoilt = drives.copy()
    nonsense = [np.nan, np.inf, -np.inf, complex(0, np.nan), 1e300, 1e-300]
    for index, plate in enumerate(np.flatnonzero(bad)):
        spoilt[plate, index % 2] = nonsense[index % len(nonsense)]
        if nonsense[index % len(nonsense)] == 1e-300:
            spoilt[plate] = 1e-300
    mixed = solver.run(spoilt, times)
    good = ~bad
    differing = np.count_nonzero(mixed.energy[good] != clean.energy[good])
    differing += np.count_nonzero(mixed.displacement[good] != clean.displacement[good])
    unflagged = np.count_nonzero(mixed.status[bad] == "ok") + np.count_nonzero(mixed.status[good] != "ok")
    return Measured(float(differing + unflagged))


CASES = grouped(
    "Odd scenes",
    [
        Case("no drive at all", "rests, without a localization factor", "largest u", no_drive, both(0, 0)),
        Case(
            "two actuators in one place", "the same as one with their sum", "difference, relative",
            two_in_one_place, both(2e-6, 1e-14),
        ),
        Case(
            "an actuator smaller than a cell", "presses with its whole force", "difference, relative",
            smaller_than_a_cell, both(2e-5, 1e-12),
        ),
        Case(
            "a target of one node", "that node's energy", "difference, relative", target_of_one_node, both(1e-6, 1e-13)
        ),
        Case("the whole plate as target", "a localization factor of one", "|LF − 1|", whole_plate, both(1e-14, 1e-14)),
        Case(
            "a drive beyond what the grid carries", "refused, or warned of, with the number", "cases that were not",
            beyond_the_grid, both(0, 0),
        ),
    ]
    + [
        Case(
            f"every third of {plates} plates nonsense{', general path' if effects else ''}",
            "the others bit-identical, the bad ones flagged", "numbers that differ, plates not flagged",
            lambda where, effects=effects, plates=plates: bad_neighbours(effects, plates, where), both(0, 0),
        )
        for effects in ({}, GENERAL)
        for plates in (7, 40)
    ],
)  # fmt: skip
