"""``warp-plate check`` and ``effects``: a scene with its warnings, and the price of its effects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console

from warp_plate.cli import options, output

if TYPE_CHECKING:
    from warp_plate.analysis.influence import Influence
    from warp_plate.analysis.warnings import Finding


def check(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneOptions = options.SceneOptions(),
    device: options.Device = "auto",
    allow_unstable: options.AllowUnstable = False,
    json: options.Json = False,
) -> None:
    """Show what a scene is, warnings about it, the work and memory of its run and of its search, and the numerics: time
    step and its limit, points per wavelength, condition and stepping path."""
    from warp_plate.analysis.check import check as check_scene
    from warp_plate.analysis.check import cost_text, costs_of
    from warp_plate.resolve import resolve

    loaded, scene = changes.load(scene)
    with output.scene_errors(scene), output.progress_bar("choosing the engine and checking", shown=not json):
        resolved = resolve(loaded, device, purpose="check", allow_unstable=allow_unstable)
        report = check_scene(resolved.scene, device, allow_unstable, resolved.by_modes)
        costs = costs_of(loaded, resolved)

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        of_costs = {name: cost_text(cost) for name, cost in costs.items()}
        output.print_lines(console, {**report.summary, **of_costs}.items(), "")
        _print_findings(report.findings, console)
        if report.numerics:
            console.print()
            output.print_lines(console, report.numerics.items())

    as_json = {name: {"refused": cost} if isinstance(cost, str) else vars(cost) for name, cost in costs.items()}
    output.report(json, lambda: {"scene": scene, **report.as_json(), **as_json}, show)


def effects(
    scene: options.SceneName,
    /,
    *names: str,
    changes: options.SceneOptions = options.SceneOptions(),
    device: options.Device = "auto",
    json: options.Json = False,
) -> None:
    """Show the cost and influence of every effect, on or off, and suggest effects that the scene lacks.

    Parameters
    ----------
    names
        Effects to switch, such as damping edges (default: all).
    """
    from warp_plate.analysis.influence import measure_effects
    from warp_plate.resolve import resolve

    loaded, scene = changes.load(scene)
    with output.scene_errors(scene):
        loaded = resolve(loaded, device, purpose="replay").scene
        with output.progress_bar("switching effects", shown=not json) as progress:
            influence = measure_effects(loaded, device, progress, names)
    record = {
        "scene": scene,
        "localization_factor": influence.localization_factor,
        "peak_displacement": influence.peak,
        "bare_step_seconds": influence.bare_step,
        "effects": list(map(vars, influence.toggles)),
        "numbers": list(map(vars, influence.findings)),
        "warnings": influence.warnings,
    }

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        print_influence(influence, console)
        _print_findings(influence.findings, console)

    output.report(json, lambda: record, show)


def _print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print warnings, then a table of the numbers within their thresholds; what is not judged is left out."""
    warnings = [finding.sentence for finding in findings if finding.exceeded]
    rows = []
    for finding in findings:
        if not finding.exceeded and not math.isnan(finding.value):
            inside = finding.value >= finding.threshold if finding.at_least else finding.value <= finding.threshold
            threshold = f"{'≥' if finding.at_least else '≤'} {finding.threshold:g}"
            rows.append((finding.name, f"{finding.value:.3g}", threshold + "; its effect is included" * (not inside)))
    output.print_warnings(console, warnings)
    if warnings:
        console.print()
    output.print_rows(console, ("within thresholds", "value", "threshold"), rows)


def print_influence(influence: Influence, console: Console) -> None:
    """Print the table of the effects that were switched, and how."""
    timed = influence.bare_step is not None
    rows = [["the scene as it is", "", *[""] * 2 * timed, *_results(influence.localization_factor, influence.peak)]]
    for switch in influence.toggles:
        cells = ["refused", ""]
        if switch.localization_factor is not None:
            cells = _results(switch.localization_factor, switch.peak)
        costs = ["", ""] * timed
        if switch.price is not None:
            costs = [f"{switch.price:+.0f} ± {switch.deviation:.0f} %", f"× {switch.steps:.3g}"]
        rows.append([_words(switch.name), "on" if switch.on else "off", *costs, *cells])
    headings = ["effect", "now", *["price of a step", "steps"] * timed, "factor", "largest displacement (m)"]
    output.print_rows(console, headings, rows)
    price = "\nThe scene is solved by modes, without steps, so no cost is measured. "
    if influence.bare_step is not None:
        price = (
            "\nPrice: time that the effect adds to a step, in % of the bare plate's step "
            f"({influence.bare_step:.2g} s), measured. Steps: factor by which it changes the number of steps. "
        )
    console.print(
        price + "Factor (localization) and displacement: with the effect switched on or off, under the scene's own "
        "drive:\n"
    )
    for switch in influence.toggles:
        console.print(f"{'without' if switch.on else 'with'} {_words(switch.name)}: {switch.alternative}")
    console.print()


def _results(localization_factor: float, peak: float | None) -> list[str]:
    return [output.number_text(localization_factor, ".4f"), output.number_text(peak, ".3g")]


def _words(name: str) -> str:
    return "free or springy edges" if name == "edges" else name.replace("_", " ")
