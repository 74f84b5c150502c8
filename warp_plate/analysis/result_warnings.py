"""Warnings about a result: effects that its scene lacks, plates that failed, limits and settings of its search."""

import math

import numpy as np

from warp_plate.accuracy.configurations import percent
from warp_plate.analysis.warnings import (
    accuracy_warnings,
    explain_missing_energies,
    search_warnings,
    target_warnings,
    warning_texts,
)
from warp_plate.outline.outline import shared_areas
from warp_plate.plate.shapes import target_outlines
from warp_plate.problem.design_variables import has_design_tables
from warp_plate.problem.methods import unread_keys
from warp_plate.problem.objectives import EXCESS, LEVEL_EXCESS, keeps_limit
from warp_plate.result.case import target_cases
from warp_plate.result.model import Result
from warp_plate.scene.vary import counted

# Part of a range within which a value is its end.
NEAR_END = 1e-4
# RMS velocity of the target for each unit of the strongest actuator, relative to that of the best single actuator,
# below which a drive is weak; and share of a moved actuator's patch in its target that is said.
WEAK, IN_TARGET = 0.1, 0.01


def result_warnings(result: Result) -> tuple[str, ...]:
    """Return the warnings of a result: effects that its scene lacks, plates that failed, settings without effect."""
    lines = [
        f"{counted(count, 'plate')} of the search failed on the workers and counted as worst: {reason}"
        for reason, count in result.lost_plates.items()
    ]
    failed = next((case.status for case in result.cases.values() if case.status != "ok"), None)
    if failed is not None:
        return (*lines, explain_missing_energies(result.scene, failed))
    best = result.history.get("best")
    if best is not None and len(best) and not math.isfinite(best[-1]):
        lines.append("No plate that the search tried has energies; the best single actuator is shown in its place.")
        return tuple(lines)
    free = result.scene.search.magnitude is not None or not has_design_tables(result.scene)
    remedy = "" if free else " as strong as the scene's; [search.magnitude] allows weaker ones"
    for kind in exceeded_limits(result):
        lines.append(f"{kind}: no drive within the limit was found{remedy}; the nearest one is shown")
    if result.command == "localize":
        lines += [*search_warnings(result.scene), *range_warnings(result), *drive_warnings(result)]
        lines += unread_keys(result.scene.search)
    scene = result.case_scene(result.main_case)
    lines += target_warnings(scene, result.main_case.localization_factor)
    option = "--evaluator modal" if result.command == "localize" else "--path modal"
    lines += accuracy_warnings(scene, result.accuracy, option if result.by_modes else "")
    return (*lines, *warning_texts(scene, result.peak_displacement, gridded=not result.by_modes))


def range_warnings(result: Result) -> list[str]:
    """Return a warning if the best frequency is an end of the range in which it was searched."""
    table, searched = result.scene.search.frequency, result.cases["best"].frequency
    if table is None or searched is None:
        return []
    names = [actuator.name for actuator in result.scene.actuators]
    low, high = table.range
    ends = {
        f"{value:.4g}": None
        for name, value in zip(names, searched, strict=True)
        if name in (table.actuators or names) and min(value - low, high - value) <= NEAR_END * (high - low)
    }
    return [
        f"search.frequency.range = [{low:g}, {high:g}]: the best frequency, {end} Hz, is an end of it; a wider range "
        "may hold a better one."
        for end in ends
    ]


def drive_warnings(result: Result) -> list[str]:
    """Return warnings about drives found that hardly move the target, and actuators that were moved into it."""
    lines, reached = [], {}
    for name in ("best", "single"):
        of_case = result.cases[name]
        with np.errstate(invalid="ignore", divide="ignore"):
            reached[name] = np.sqrt(of_case.energy["target"]) / np.abs(of_case.phasors).max()
    if reached["best"] < WEAK * reached["single"]:
        share = percent(float(reached["best"] / reached["single"]))
        lines.append(
            f"The drive found is weak: the target moves at {share} of the velocity that the best single actuator of "
            "the same strength gives it. Actuators farther apart (search.position.clearance), or an objective "
            '"velocity", exclude drives that cancel out.'
        )
    scene, table = result.scene, result.scene.search.position
    for index, (name, case) in enumerate((target_cases(scene.targets) or {"": "best"}).items()):
        if table is None or case not in result.cases:
            break
        target = scene.aimed_at(index).target if name else scene.target
        outlines = [outline[:-1] for outline in target_outlines(scene, "target", target)]
        inside = [
            actuator.name
            for actuator in result.case_scene(result.cases[case]).actuators
            if (table.actuators is None or actuator.name in table.actuators)
            and shared_areas([actuator.flattened()], outlines).sum() > IN_TARGET * actuator.patch_area
        ]
        if inside:
            lines.append(
                f"Actuators sit in the target{f' {name}' if name else ''}: {', '.join(inside)}. If nothing may be "
                "mounted there, keep them out by search.position.area or search.position.areas."
            )
    return lines


def exceeded_limits(result: Result) -> list[str]:
    """Return the limits that the best drive for some target exceeds, by name; ``rest_limit`` by kinds of objectives."""
    limits = {row.kind: row.rest_limit for row in result.scene.search.objectives if row.rest_limit is not None}
    searches = [search.objective_values for search in result.target_searches or [result]]
    exceeded = [
        f"{kind} of the rest"
        for kind, limit in limits.items()
        if not all(keeps_limit(values.get(f"{kind} of the rest", 0.0), limit) for values in searches)
    ]
    for name, (unit, limit) in result.scene.limited_levels.items():
        reached = np.array([values[name] for values in searches if name in values])
        kept = reached <= (limit + LEVEL_EXCESS if unit == "dB(A)" else limit * (1 + EXCESS))
        if name == "velocity":
            kept = reached >= limit * (1 - EXCESS)
        exceeded += [name] * (not kept.all())
    return exceeded
