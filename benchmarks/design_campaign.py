"""Random panels: slopes of what is designed against differences, and designs judged by finite elements.

    python benchmarks/design_campaign.py slopes [--first 0] [--count 200] [--processes 2] [--json]
    python benchmarks/design_campaign.py designs [--first 0] [--count 60] [--processes 2] [--json]

A number is a scene of ``random_panels.py``. "slopes" compares slopes by each free number with central differences of
the values; every fifth scene is a square panel with all its symmetries, where two drives reach the bound and the slope
has to lie between the slopes of both sides, and every fifth one has a free outline. "designs" searches, and lets
``judge.py``, which shares no code with the program, compute what the best drive does before and after, and what limits
are passed. ``--json`` prints a line for each scene as it is done.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from error_bars.elements import element_frequencies
from error_bars.judge import true_factors
from random_panels import designed_scene, shaped_scene, symmetric_scene, true_mass, varied_scene

from warp_plate import Scene, SceneError
from warp_plate.designing.candidates import gridded
from warp_plate.designing.design import design
from warp_plate.designing.panel import FreePanel
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors

# Steps of the differences, as parts of the range of a number.
STEPS = (8e-2, 4e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3)
# Steps where bounds nearly repeat: their slopes change within such distances.
FINE_STEPS = (4e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
# Steps of one-sided differences.
SIDE_STEPS = (1e-3, 4e-4)
# Norm of slopes, per range of a number, of which errors are parts at least: rounding of values shows in differences.
LEAST = 1e-4
# Where these do not tell, polynomials of a degree through so many values within distances average rounding.
DEGREE, POINTS, DISTANCES = 11, 36, (2e-2, 6e-3, 2e-3, 6e-4)


def slopes_of(number: int) -> tuple[int, str, list[tuple[str, float]]]:
    """Return the kind of a scene, and the error of each slope as a part of the largest one."""
    try:
        if number % 5 == 4:
            return number, "symmetric", _one_sided(symmetric_scene(number), number)
        scene = (partial(designed_scene, limited=True), varied_scene, varied_scene, shaped_scene)[number % 5](number)
        panel = FreePanel(scene)
        rng = np.random.default_rng([number, 49])
        numbers = 0.2 + 0.6 * rng.random(panel.count)
        if scene.design.limits.gap is not None:
            panel.follow(numbers)
        value = panel.evaluate(numbers)
        directions = (
            [("map", np.append(rng.normal(size=panel._mapped), np.zeros(len(panel.keys))))] if panel._mapped else []
        )
        directions += [(key, np.eye(panel.count)[panel._mapped + index]) for index, key in enumerate(panel.keys)]
        every = np.vstack([value.slopes, value.excess_slopes])
        sizes = np.linalg.norm(every, axis=1)
        errors = []
        for name, direction in directions:
            direction = direction / np.linalg.norm(direction)
            scale = np.maximum(sizes, LEAST)
            off = np.abs(_richardson(panel, numbers, direction, STEPS) - every @ direction) / scale
            for distance in DISTANCES if off.min(axis=0).max() > 5e-7 else ():
                fitted = _fitted(panel, numbers, direction, distance)
                off = np.vstack([off, np.abs(fitted - every @ direction) / scale])
            if off.min(axis=0).max() > 5e-7:
                finer = _richardson(panel, numbers, direction, FINE_STEPS)
                off = np.vstack([off, np.abs(finer - every @ direction) / scale])
            labels = ["value", *(f"limit {index}" for index in range(len(value.excess)))]
            errors += [(f"{name}: {label}", float(error)) for label, error in zip(labels, off.min(axis=0), strict=True)]
        return number, "plain" if not value.excess.size else "limited", errors
    except SceneError as error:
        return number, f"refused: {error}", []


def _difference(panel: FreePanel, numbers: np.ndarray, direction: np.ndarray, step: float) -> np.ndarray:
    one, other = (panel.evaluate(numbers + sign * step * direction, sloped=False) for sign in (1, -1))
    return np.append(one.smooth - other.smooth, one.excess - other.excess) / (2 * step)


def _richardson(panel: FreePanel, numbers: np.ndarray, direction: np.ndarray, steps: Sequence[float]) -> np.ndarray:
    """Return slopes extrapolated from the differences with each two steps."""
    ends = [_difference(panel, numbers, direction, step) for step in steps]
    ratios = [(rough / fine) ** 2 - 1 for rough, fine in pairwise(steps)]
    return np.array(
        [fine + (fine - rough) / ratio for (rough, fine), ratio in zip(pairwise(ends), ratios, strict=True)]
    )


def _fitted(panel: FreePanel, numbers: np.ndarray, direction: np.ndarray, distance: float) -> np.ndarray:
    """Return the slope at the middle of polynomials through values, even ones left out."""
    places = distance * np.cos(np.pi * (np.arange(POINTS) + 0.5) / (2 * POINTS))
    ends = np.array([2 * step * _difference(panel, numbers, direction, step) for step in places])
    odd = np.polynomial.chebyshev.chebvander(places / distance, DEGREE)[:, 1::2]
    return (
        np.linalg.lstsq(odd, ends / 2, rcond=None)[0].T
        @ [(-1) ** k * (2 * k + 1) for k in range(odd.shape[1])]
        / distance
    )


def _one_sided(scene: Scene, number: int) -> list[tuple[str, float]]:
    """Return by how much a slope leaves the interval of the slopes of both sides."""
    panel, rng = FreePanel(scene), np.random.default_rng([number, 50])
    middle, direction = panel.start(), rng.normal(size=panel.count)
    direction /= np.linalg.norm(direction)
    slopes = panel.evaluate(middle).slopes
    slope, size, excess = slopes @ direction, float(np.linalg.norm(slopes)), []
    for step in SIDE_STEPS:
        sides = (
            [panel.evaluate(middle + sign * step * index * direction, sloped=False).least for index in range(4)]
            for sign in (-1, 1)
        )
        left, right = (
            sign * np.array([-11, 18, -9, 2]) @ values / (6 * step) for sign, values in zip((-1, 1), sides, strict=True)
        )
        excess.append(max(min(left, right) - slope, slope - max(left, right), 0.0) / size)
    kind = "one-sided, repeated" if right - left > 1e-4 * size else "one-sided, simple"
    return [(kind, min(excess))]


def judged(scene: Scene, objective: str) -> tuple[float, float]:
    """Return the localization factor of the scene's best drive by modes, or of its own, by the judge, and by how much
    it changes with the degree of the elements."""
    phasors = scene_phasors(scene) if objective == "drive" else ModalSolver(gridded(scene), "cpu").response.best_drive()
    degree = 7 if scene.effects.layers or scene.effects.variation else 10
    fine, coarse = (float(true_factors(scene, np.asarray(phasors)[None], each)[0]) for each in (degree, degree - 2))
    return fine, abs(fine - coarse)


def design_of(number: int) -> tuple[int, str, dict[str, float]]:
    """Return what a design of a random scene does, and what the judge says of it."""
    try:
        scene = designed_scene(number, limited=True, accurate=number % 2 == 0)
        limits, objective = scene.design.limits, scene.design.objective
        panel = design(scene, check=False)
    except SceneError as error:
        return number, f"refused: {error}", {}
    bare = scene.model_copy(update={"design": None})
    row = {
        "before": panel.before.value,
        "after": panel.after.value,
        "kept": float(panel.after.kept),
        "kept before": float(panel.before.kept),
    }
    several = bool(scene.design.tolerance or scene.design.frequencies)
    if objective != "energy_target" and not several:
        (first, unsure), (second, unsure_after) = judged(bare, objective), judged(panel.scene, objective)
        row |= {"judged before": first, "judged after": second, "unsure": unsure + unsure_after}
    if limits.mass is not None:
        row["mass"] = true_mass(panel.scene) / limits.mass - 1
    if limits.gap is not None:
        natural = element_frequencies(panel.scene, 16, 9)
        row["gap"] = float(np.minimum(natural / limits.gap[0] - 1, 1 - natural / limits.gap[1]).max())
    if scene.design.thickness is not None and panel.improved:
        low, high = scene.design.thickness.range
        row["range"] = max(low / panel.thickness.min() - 1, panel.thickness.max() / high - 1)
        if scene.design.thickness.mass is not None:
            plates = [
                one.model_copy(update={"effects": one.effects.model_copy(update={"oscillators": (), "layers": ()})})
                for one in (panel.scene, bare)
            ]
            row["mass of the plate"] = abs(true_mass(plates[0]) / true_mass(plates[1]) - 1)
    return number, "improved" if panel.improved else "stays", row


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=["slopes", "designs"])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=None)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    task, count = {"slopes": (slopes_of, 200), "designs": (design_of, 60)}[asked.what]
    numbers, rows = range(asked.first, asked.first + (asked.count or count)), []
    with get_context("spawn").Pool(asked.processes) as pool:
        for row in pool.imap_unordered(partial(_timed, task), numbers):
            rows.append(row)
            if asked.json:
                print(json.dumps(row), flush=True)
    (summarise_slopes if asked.what == "slopes" else summarise_designs)(rows)
    print(f"slowest {max(row[-1] for row in rows):.0f} s of processor time, all {sum(row[-1] for row in rows):.0f} s")


def _timed(task, number):
    began = time.process_time()
    return *task(number), time.process_time() - began


def summarise_slopes(rows: list) -> None:
    errors = [(error, number, name) for number, _, found, _ in rows for name, error in found]
    kinds = [kind for _, kind, _, _ in rows]
    print(f"{len(rows)} scenes, {sum(kind.startswith('refused') for kind in kinds)} refused, {len(errors)} slopes")
    for kind in ("plain", "limited", "symmetric"):
        print(f"  {kind}: {kinds.count(kind)} scenes")
    repeated = [error for error, _, name in errors if "repeated" in name]
    print(f"  repeated bounds {len(repeated)}, largest excess {max(repeated, default=0):.1e}")
    sizes = np.array([error for error, _, _ in errors])
    print(
        f"errors as parts of the norm of the slopes: median {np.median(sizes):.1e}, above 1e-6: {(sizes > 1e-6).sum()}"
    )
    for error, number, name in sorted(errors, reverse=True)[:25]:
        print(f"  {error:.1e} scene {number} {name}")
    for number, kind, _, _ in rows:
        if kind.startswith("refused"):
            print(f"  scene {number} {kind}"[:110])


def summarise_designs(rows: list) -> None:
    done = [(number, row) for number, _, row, _ in rows if row]
    kinds = [kind for _, kind, _, _ in rows]
    print(
        f"{len(rows)} scenes: {kinds.count('improved')} improved, {kinds.count('stays')} stay, "
        f"{len(rows) - len(done)} refused"
    )
    worse = [number for number, row in done if row["after"] < row["before"] and row["kept before"]]
    print(
        f"worse than the start: {worse}; limits not kept although the scene kept them: "
        f"{[number for number, row in done if row['kept before'] and not row['kept']]}"
    )
    pairs = [(number, row) for number, row in done if "judged after" in row]
    off = [
        (max(abs(row[f"judged {when}"] / row[when] - 1) for when in ("before", "after")), number)
        for number, row in pairs
    ]
    print(
        f"judged {len(pairs)}: median difference from modes {np.median([error for error, _ in off]):.1e}; largest "
        + ", ".join(f"{error:.1e} ({number})" for error, number in sorted(off, reverse=True)[:6])
    )
    lost = sorted(
        (row["judged after"] - row["judged before"], row["unsure"], row["after"] - row["before"], number)
        for number, row in pairs
        if row["kept before"]
    )
    print(
        "least judged gains (± the judge's change with its degree; by modes): "
        + ", ".join(f"{gain:+.1e} ± {unsure:.0e}; {modes:+.1e} ({number})" for gain, unsure, modes, number in lost[:8])
    )
    for name in ("mass", "gap", "range", "mass of the plate"):
        passed = [
            (row[name], number) for number, row in done if name in row and (row["kept"] or name not in ("mass", "gap"))
        ]
        print(
            f"{name}: {len(passed)}, passed at most by "
            + ", ".join(f"{error:.1e} ({number})" for error, number in sorted(passed, reverse=True)[:4])
        )
    for number, kind, _, _ in rows:
        if kind.startswith("refused"):
            print(f"  scene {number} {kind}"[:110])


if __name__ == "__main__":
    main()
