"""Commands about a scene: ``init``, ``keys``, ``check``, and the price of its ``effects`` and of ``accuracy``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError, printable

if TYPE_CHECKING:
    from warp_plate.accuracy.measure import AccuracyRow
    from warp_plate.accuracy.report import AccuracyReport
    from warp_plate.analysis.influence import Influence
    from warp_plate.analysis.warnings import Finding

HEADINGS = "single | bound | error % | u % | a plate | "
CELLS = "{localization_factor:.4f} | {bound:.4f} | {error} | {error_displacement} | {seconds} | {front}"
BY_MODES = "modes, without a grid"
ACCURACY_LEGEND = (
    "single, bound: localization factor of the best single actuator, and the largest that any drive can have. error: "
    "largest relative error of single, best drive and bound; u: error of the displacement under the best drive (L2 "
    "norm over plate and window). a plate: seconds per plate in a swarm, of modes its share of all that the swarm "
    "takes, from the scene on. ≤ no larger than the reference's own error: a bound. * no other row is both more "
    "accurate and faster; ~ not known."
)


def init(name: str, /, *, out: Path | None = None) -> None:
    """Write a preset as a TOML file to edit.

    Parameters
    ----------
    name
        The preset: paper, paper-supported, touch-panel, cantilever-display, composite-panel, large-amplitude,
        focusing-glass or four-fingers.
    out
        The file to write (default: NAME.toml in this folder). An existing file is never overwritten.
    """
    from warp_plate.scene.load import preset_text

    text = preset_text(name)
    path = out or Path(f"{name}.toml")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise SceneError(f"{path}: exists already; choose another name with --out") from None
    except (OSError, ValueError) as error:
        with suppress(OSError, ValueError):
            path.unlink()  # what a full disk took of it
        raise SceneError(f"{path}: cannot be written: {error}") from None
    print(printable(f"wrote {path}; run it with: warp-plate localize {path}"))


def keys(*tables: str, json: options.Json = False) -> None:
    """Show the tables of a scene file, or every key of a table with unit, default, range, example and meaning.

    Parameters
    ----------
    tables
        Tables such as plate, edges, drive.burst or effects.damping; "all" for all of them. Default: their names.
    """
    from warp_plate.scene.key_reference import table_references

    references = {heading.strip("[]"): table for table in table_references() for heading in table.headings}
    for name in tables:
        if name not in references and name != "all":
            raise SceneError(f"{name}: no such table; there are: {', '.join(list(references)[1:])}")
    selected = {name: references[name] for name in (references if "all" in tables else tables)}

    def show(console: Console) -> None:
        if not selected:
            tables = {name: table.description.split("\n\n")[0].replace("\n", " ") for name, table in references.items()}
            output.print_lines(console, ((name, text.replace("`", "")) for name, text in tables.items()))
        for name, table in selected.items():
            console.print(f"{name}: {table.description.replace('`', '')}\n", highlight=False)
            rows = [("key", "unit", "default", "range", "example", "meaning")]
            for key in table.keys:
                rows.append((key.name, key.unit, key.default, key.range, key.example, f"{key.meaning} ({key.type})"))
            output.print_lines(console, ([cell.replace("`", "") for cell in row] for row in rows), "")

    record = {name: [asdict(key) for key in table.keys] for name, table in (selected or references).items()}
    output.report(json, lambda: record, show)


def check(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneOptions = options.SceneOptions(),
    device: options.Device = "auto",
    allow_unstable: options.AllowUnstable = False,
    json: options.Json = False,
) -> None:
    """Show what a scene is, warnings about it, and the numerics of its run: time step and its limit, points per
    wavelength, condition, memory and stepping path."""
    from warp_plate.analysis.check import check as check_scene
    from warp_plate.resolve import resolve

    loaded, scene = changes.load(scene)
    with output.scene_errors(scene):
        resolved = resolve(loaded, device, purpose="check")
        report = check_scene(resolved.scene, device, allow_unstable, resolved.by_modes)

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        output.print_lines(console, report.summary.items(), "")
        _print_findings(report.findings, console)
        if report.numerics:
            console.print()
            output.print_lines(console, report.numerics.items())

    output.report(json, lambda: {"scene": scene, **report.as_json()}, show)


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
    from warp_plate.analysis.warnings import find_warnings
    from warp_plate.resolve import resolve

    loaded, scene = changes.load(scene)
    with output.scene_errors(scene):
        loaded = resolve(loaded, device, purpose="replay").scene
        with output.progress_bar("switching effects", shown=not json) as progress:
            influence = measure_effects(loaded, device, progress, names)
    findings = find_warnings(loaded, influence.peak)
    record = {
        "scene": scene,
        "localization_factor": influence.localization_factor,
        "peak_displacement": influence.peak,
        "bare_step_seconds": influence.bare_step,
        "effects": list(map(vars, influence.toggles)),
        "numbers": list(map(vars, findings)),
        "warnings": [finding.sentence for finding in findings if finding.exceeded],
    }

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        print_influence(influence, console)
        _print_findings(findings, console)

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
    for sentence in warnings:
        console.print(f"! {sentence}")
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


def accuracy(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    device: options.Device = "auto",
    budget: float = 120.0,
    path: options.Stepping = "auto",
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Measure error against run time for a scene, and recommend grids for errors from 10 % to 0.1 %.

    Grids, spatial orders, time steps and precisions are run from the cheapest to the most expensive and compared with
    a reference solution. The rest of the scene is unchanged. The measurements are written to a .json file.

    Parameters
    ----------
    budget
        Nominal seconds for the grids. They are counted in node-steps, so a busy machine measures the same grids. Grids
        beyond the budget are listed as skipped. The reference solution, modes and the first six grids come on top: up
        to a minute or two where damping couples the modes.
    """
    target = files.target(scene, "-accuracy.json", holds="measurements with reference")
    if not 0 < budget < float("inf"):
        raise SceneError(f"--budget {budget:g}: must be a positive number of seconds")
    loaded, scene = changes.load(scene)
    from warp_plate.accuracy.measure import describe_machine, describe_versions
    from warp_plate.accuracy.report import measure_accuracy
    from warp_plate.solve.devices import find_device

    name = find_device(device).alias
    machine = describe_machine(name)
    with output.scene_errors(scene), output.progress_bar("measuring", shown=not files.json) as show:
        report = measure_accuracy(loaded, source=scene, device=name, path=path, budget=budget, on_progress=show)
    record = {**report.as_json(), "machine": machine, "versions": describe_versions()}
    from warp_plate.viz.plots.search import draw_accuracy

    written = output.write_measurements(target, record, draw_accuracy, files.pictures)
    show_report = partial(_print_accuracy, report, machine["devices"][name])
    output.report(files.json, lambda: record, show_report, written=written)


def _print_accuracy(report: AccuracyReport, device: str, console: Console) -> None:
    reference = report.reference
    console.print(f"{report.scene} on {device}\n")
    measured = [(index, row) for index, row in enumerate(report.rows) if row.measured]
    for kind in dict.fromkeys(_kind(row) for _, row in measured):
        headings, cells = "nodes | Δt (s) | precision | ", "{size} | {time_step:.2g} | {precision} | "
        if kind == BY_MODES:
            headings, cells = "functions | ", "{size} | "
        records = [_record(report, index) for index, row in measured if _kind(row) == kind]
        output.print_table(console, headings + HEADINGS, cells + CELLS, records, "", title=kind)
    console.print(ACCURACY_LEGEND + "\n")
    console.print(
        f"Reference ({reference.kind}): best single actuator {reference.localization_factors['single']:.5f}, bound "
        f"{reference.bound:.5f}, known to {reference.uncertainty:.1g}.\n"
    )
    laws = [law for law in report.laws if law.family != "modal"]  # modes converge faster than any power
    if laws:
        headings = "measured laws | error ∝ h^ | u ∝ h^ | s ∝ n^"
        powers = "{order:.2f} | {order_displacement:.2f} | {cost_exponent:.2f}"
        output.print_table(console, headings, "{family} | " + powers, map(vars, laws), "")
    _print_recommendations(report, console)
    left_out = [row for row in report.rows if not row.measured]
    for row in (row for row in left_out if not row.status.startswith("skipped")):
        console.print(f"{_kind(row)}, {row.precision}, {_size(row)}: {row.status}")
    if skipped := sum(row.status.startswith("skipped") for row in left_out):
        console.print(f"{skipped} grids are skipped because they exceed --budget; --json lists them.")
    if report.interrupted:
        console.print("Interrupted by Ctrl-C; measurements up to then are shown.")


def _print_recommendations(report: AccuracyReport, console: Console) -> None:
    from warp_plate.accuracy.configurations import percent, seconds_text

    tolerances: dict[tuple[str, ...], list[str]] = {}  # by the other cells
    for recommended in report.recommended:
        cells = ["none within the budget", "", "", ""]
        if recommended.row is not None:
            row = report.rows[recommended.row]
            use = f"modes, {_size(row)}"
            if row.time_step is not None:
                use = f"{_size(row)}, order {row.order}, {row.load}, {row.time_step:.2g} s, {row.precision}"
            seconds = map(seconds_text, (row.seconds_per_plate or 0.0, recommended.seconds or 0.0))
            cells = [use, f"{error_text(row.error, report.reference.uncertainty)} %", *seconds]
        tolerances.setdefault(tuple(cells), []).append(percent(recommended.tolerance).removesuffix(" %"))
    headings = ("for", "use", "error", "a plate", f"{report.particles} × {report.iterations} plates")
    rows = [(f"{', '.join(asked)} %", *cells) for cells, asked in tolerances.items()]
    output.print_rows(console, headings, rows, "", texts=2)


def _kind(row: AccuracyRow) -> str:
    if row.load == "modal":
        return BY_MODES
    kind = f"order {row.order}, {row.load}"
    return f"as written: {kind}, {row.damping or 'no'} damping" if row.as_written else kind


def _size(row: AccuracyRow) -> str:
    return f"{row.nodes[0]} × {row.nodes[1]}"


def error_text(error: float | None, floor: float) -> str:
    """Return an error in percent, as a bound where it is no larger than that of the reference, ``floor``."""
    from warp_plate.accuracy.configurations import percent

    if error is None:
        return "~"
    text = f"≤{percent(error + floor)}" if error <= floor else percent(error)
    return text.removesuffix(" %")


def _record(report: AccuracyReport, index: int) -> dict[str, object]:
    """Return a measured row with the texts of its cells."""
    from warp_plate.accuracy.configurations import seconds_text
    from warp_plate.accuracy.report import displacement_floor

    row, uncertainty = report.rows[index], report.reference.uncertainty
    return {
        **vars(row),
        "size": _size(row),
        "error": error_text(row.error, uncertainty),
        "error_displacement": error_text(row.error_displacement, displacement_floor(uncertainty)),
        "seconds": seconds_text(row.seconds_per_plate or 0.0),
        "front": "*" if index in report.front else "",
    }
