"""Tables and JSON records of results that several commands print: drives, objectives, robustness, cost, warnings."""

import math
from collections.abc import Mapping

from rich.console import Console

from warp_plate.analysis.result_warnings import exceeded_limits
from warp_plate.cli import output
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.result.case import (
    Case,
    amplitude_column,
    amplitudes_as_given,
    motion_table,
    relative_to_own,
    target_cases,
)
from warp_plate.result.model import Result, RobustComparison, crosstalk
from warp_plate.scene.errors import printable
from warp_plate.scene.model import Scene

COMPARED_CASES = ("equal", "single", "time_reversal", "inverse_filter")
ROBUST_ROWS = {
    "mean": "mean",
    "worst_5_percent": "mean of the worst 5 %",
    "worst": "worst",
    "nominal_plate": "nominal plate",
    "searched": "scenarios of the search",
}
# The stages of ``Result.seconds``.
STAGES = {
    "choose": "choosing the engine or grid",
    "compile": "compiling or loading",
    "solve": "solving",
    "robust": "validating",
    "baselines": "of baselines",
    "spectrum": "of the spectrum",
    "accuracy": "searching by more functions",
    "estimate": "estimating the error",
}


def print_motion(cases: Mapping[str, Case], scene: Scene, console: Console) -> None:
    """Print the motion of target and rest by case labels, with the largest drive; nothing if it is unknown."""
    headings, rows = motion_table(cases, scene)
    if rows:
        output.print_rows(console, headings, rows, "", title="Motion in the target / outside")


def motion_json(case: Case) -> dict[str, object] | None:
    """Return the motion of target and rest in a case, in SI units; None if unknown."""
    motion = case.motion
    if motion is None:
        return None
    pairs = {"velocity_rms": motion.velocity, "displacement_peak": motion.displacement}
    if motion.acceleration is not None:
        pairs["acceleration_rms"] = motion.acceleration
    named = {name: dict(zip(("target", "outside"), pair, strict=True)) for name, pair in pairs.items()}
    return {"contrast_db": motion.contrast, **named}


def print_drive(case: Case, scene: Scene, console: Console, target: str = "") -> None:
    """Print a drive as in Table 1 of the source paper. ``target``: its name if there are several."""
    heading, amplitudes = amplitude_column(scene, case.magnitude, ".4f")
    rows = []
    for index, actuator in enumerate(scene.actuators):
        phase = case.phase[index]
        others = (f"{values[index]:.5g}" for values in case.per_actuator.values())
        rows.append([actuator.name, amplitudes[index], f"{phase:.4f}", f"{phase / math.pi:.4f}", *others])
    headings = ["actuator", heading, "phase (rad)", "phase / π", *case.per_actuator]
    title = f"Drive found{f' for {printable(target)}' if target else ''}"
    output.print_rows(console, headings, rows, "", title=title)


def drive_json(case: Case, scene: Scene) -> list[dict[str, object]]:
    """Return a drive as one record for each actuator, including searched frequencies, positions and delays; ``force``
    [N] in place of ``magnitude`` where the scene has it."""
    per_actuator = output.attributes(case, "phase", "frequency", "centre", "delay")
    return [
        {
            "actuator": actuator.name,
            key: value,
            **{name: values[index] for name, values in per_actuator.items() if values is not None},
        }
        for index, (actuator, (key, value, _)) in enumerate(
            zip(scene.actuators, amplitudes_as_given(scene, case.magnitude), strict=True)
        )
    ]


def print_objectives(result: Result, console: Console) -> None:
    """Print a row for each objective with a column for each target's drive or case; nothing if the localization
    factor is the only objective, without limits on motion or sound."""
    if not result.objective_values:
        return
    searches = result.target_searches or [result]
    values_of = [search.objective_values for search in searches]
    columns = [target.name for target in result.scene.targets][: len(values_of)] or ["found"]
    by_case = result.objective_values_by_case
    others = {name.replace("_", "\n"): by_case[name] for name in COMPARED_CASES if name in by_case}
    lines: list[tuple[str, str, str, float | None]] = []  # key, label, weight, limit
    for objective in result.scene.search.objectives:
        kind, unit = objective.kind, REGION_QUANTITIES[objective.kind].unit.removeprefix("1")
        lines.append((kind, f"{kind} ({unit})" if unit else kind, f"{objective.weight:g}", None))
        if objective.rest_limit is not None:
            lines.append((f"{kind} of the rest", f"{kind} of the rest ({unit})", "", objective.rest_limit))
    levels = result.scene.limited_levels
    lines += [(name, f"{name} ({unit})", "", limit) for name, (unit, limit) in levels.items()]
    if not result.only_localization:
        lines.append(("sum", "weighted sum", "", None))
    if any("bound" in values for values in values_of) and not result.only_localization:
        kinds = [search.bound_kind for search in searches]
        bounded = "bound only" if "bound only" in kinds else "bound"
        lines.append(("bound", f"{bounded} of the sum, {result.scope}", "", None))
    rows = []
    for key, label, weight, limit in lines:
        cells = [output.number_text(values.get(key), ".4g") for values in values_of]
        cells += [output.number_text(values[key], ".4g") if key in values else "" for values in others.values()]
        rows.append([label, weight, "" if limit is None else f"{limit:g}", *cells])
    output.print_rows(console, ["objective", "weight", "limit", *columns, *others], rows)
    if others and not exceeded_limits(result):
        ignoring = ", ".join(others).replace("\n", " ")
        console.print(f"{ignoring}: these drives ignore the limits of the search.", style="dim")
    console.print()


def print_crosstalk(result: Result, console: Console) -> None:
    """Print the crosstalk: a row for each drive, a column for each target."""
    names, shares = list(target_cases(result.scene.targets)), crosstalk(result)
    relative, rows = relative_to_own(shares), []
    for row, name in enumerate(names):
        cells = [f"{share:.4f} ({level:+.1f} dB)" for share, level in zip(shares[row], relative[row], strict=True)]
        cells[row] = f"{shares[row, row]:.4f}"
        if math.isnan(shares[row, row]):
            cells = ["not searched"] * len(names)
        bound = result.target_searches[row].bound if row < len(result.target_searches) else None
        rows.append([name, *cells, output.number_text(bound, ".4f")])
    title = "Crosstalk: share of the plate's kinetic energy in"
    output.print_rows(console, ["drive for", *names, f"bound {result.scope}"], rows, "", title=title)


def crosstalk_json(result: Result) -> dict[str, object] | None:
    """Return shares of the plate's kinetic energy, also in decibels relative to each drive's own target; None for a
    single target."""
    cases = target_cases(result.scene.targets)
    if not cases:
        return None
    shares, searches = crosstalk(result), result.target_searches
    return {
        **{name: [getattr(search, name) for search in searches] for name in ("bound", "bound_kind", "evaluations")},
        "targets": list(cases),
        "cases": list(cases.values()),
        "share": shares,
        "decibels": relative_to_own(shares),
        "objectives": [search.objective_values or None for search in searches],
        "drives": {
            name: drive_json(result.cases[name], result.scene) for name in cases.values() if name in result.cases
        },
    }


def print_robust(result: Result, console: Console) -> None:
    """Print the comparison of the robust drive with the nominal one; nothing if the search was not robust."""
    compared = result.robust
    if result.scene.search.robust is None:
        return
    if compared is None:
        why = "no drive was found, Ctrl-C came first, or a validation scenario is not a valid plate"
        console.print(f"Not compared with a nominal drive: {why}.\n")
        return
    rows = []
    for key, values in compared.rows().items():
        measure = f" ({compared.measure} of {compared.scenarios})" if key == "searched" else ""
        rows.append([ROBUST_ROWS[key] + measure, *(f"{value:.4f}" for value in values)])
    if compared.bound is not None:
        rows.append([f"bound for the search's scenarios, {result.scope}", f"{compared.bound:.4f}", ""])
    if compared.failed.any():
        rows.append(["plates that failed", *map(str, compared.failed.tolist())])
    console.print(f"Over {compared.validation.shape[1]} fresh scenarios, which neither search has used:")
    output.print_rows(console, [_robust_quantity(compared), "robust drive", "nominal drive"], rows, "")


def robust_json(compared: RobustComparison | None) -> dict[str, object] | None:
    """Return the record "robust" of the JSON output; plates that failed are null in it."""
    if compared is None:
        return None

    by_drive = {**compared.rows(), "failed": compared.failed, "fresh": compared.validation}
    return {
        **output.attributes(compared, "measure", "scenarios", "bound"),
        "value": _robust_quantity(compared),
        **{key: dict(zip(("robust", "nominal"), values, strict=True)) for key, values in by_drive.items()},
    }


def _robust_quantity(compared: RobustComparison) -> str:
    return "localization factor" if compared.localization else "weighted sum of objectives"


def print_cost(result: Result, console: Console, start: str = "", elapsed: float | None = None) -> None:
    """Print where a result was computed, its cost and accuracy, the effects in the compiled kernels, and warnings.

    Args:
        elapsed: seconds of the whole command; None if the result has seconds of earlier ones too.
    """
    work, before, included = "", "finding the modes", "included"
    if not result.by_modes:
        work = f"{result.node_steps:.3g} node-steps on {result.device}, "
        before, included = "compiling or loading kernels", "compiled in"
    console.print(
        f"{start}{work}{result.path}: {result.seconds['solve']:.2f} s solving after {result.seconds['compile']:.2f} s "
        f"{before}. Effects {included}: {', '.join(result.effects) or 'none'}."
    )
    if "reason" in result.accuracy:
        took = f", chosen in {result.seconds['choose']:.2f} s" if "choose" in result.seconds else ""
        console.print(f"engine: {result.accuracy['reason']}{took}")
    if elapsed is not None:
        spent = {text: result.seconds[stage] for stage, text in STAGES.items() if stage in result.seconds}
        spent["loading, files and pictures"] = elapsed - sum(spent.values())
        stages = ", ".join(f"{value:.2f} s {text}" for text, value in spent.items())
        console.print(f"{elapsed:.2f} s in all: {stages}.")
    if "estimate" in result.accuracy:
        estimate = result.accuracy["estimate"]
        for part in (estimate, estimate.get("bound", {})):
            if "line" in part:
                console.print(part["line"])
    output.print_warnings(console, result.warnings)
