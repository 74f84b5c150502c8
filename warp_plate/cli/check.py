"""``warp-plate check``, ``effects`` and ``accuracy``: numerics of a scene, price of its effects and of its errors."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.cli import options, output, tables
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from warp_plate.accuracy.measure import AccuracyRow
    from warp_plate.accuracy.report import AccuracyReport
    from warp_plate.analysis.influence import Influence

ACCURACY_HEADINGS = ("single", "bound", "error %", "u %", "a plate", "")
BY_MODES = "modes, without a grid"
ACCURACY_LEGEND = (
    "single, bound: localization factor of the best single actuator, and the largest that any drive can have. error: "
    "largest relative error of single, best drive and bound; u: error of the displacement under the best drive (L2 "
    "norm over plate and window). a plate: seconds per plate in a swarm, of modes its share of all that the swarm "
    "takes, from the scene on. ≤ no larger than the reference's own error: a bound. * no other row is both more "
    "accurate and faster; ~ not known."
)


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
    loaded, scene = changes.load(scene)
    from warp_plate.analysis.check import check as check_scene
    from warp_plate.resolve import resolve

    with output.scene_errors(scene):
        resolved = resolve(loaded, device, purpose="check")
        report = check_scene(resolved.scene, device, allow_unstable, resolved.by_modes)

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        console.print(output.lines_table(report.summary.items()), "")
        tables.print_findings(report.findings, console)
        if report.numerics:
            console.print("", output.lines_table(report.numerics.items()))

    output.report(json, lambda: {"scene": scene, **report.as_json()}, show)


def effects(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneOptions = options.SceneOptions(),
    device: options.Device = "auto",
    json: options.Json = False,
) -> None:
    """Show the cost and influence of every effect, on or off, and suggest effects that the scene lacks."""
    loaded, scene = changes.load(scene)
    from warp_plate.analysis.influence import measure_effects
    from warp_plate.analysis.warnings import find_warnings
    from warp_plate.resolve import resolve

    with output.scene_errors(scene):
        loaded = resolve(loaded, device, purpose="replay").scene
        with output.progress_bar("switching effects", shown=not json) as progress:
            influence = measure_effects(loaded, device, progress)
    findings = find_warnings(loaded, influence.peak)
    record = {
        "scene": scene,
        "localization_factor": influence.localization_factor,
        "peak_displacement": influence.peak,
        "bare_step_seconds": influence.bare_step,
        "effects": [asdict(switch) for switch in influence.toggles],
        "numbers": [asdict(finding) for finding in findings],
        "warnings": [finding.sentence for finding in findings if finding.exceeded],
    }

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        _print_influence(influence, console)
        tables.print_findings(findings, console)

    output.report(json, lambda: record, show)


def _print_influence(influence: Influence, console: Console) -> None:
    costs = () if influence.bare_step is None else ("price of a step", "steps")
    table = output.table("effect", "now", *costs, "factor", "largest displacement (m)")
    blank = [""] * len(costs)
    table.add_row("the scene as it is", "", *blank, *_motion_cells(influence.localization_factor, influence.peak))
    for switch in influence.toggles:
        cells = ["refused"]
        if switch.localization_factor is not None:
            cells = _motion_cells(switch.localization_factor, switch.peak)
        if switch.price is not None:
            cells = [f"{switch.price:+.0f} ± {switch.deviation:.0f} %", f"× {switch.steps:.3g}", *cells]
        table.add_row(_words(switch.name), "on" if switch.on else "off", *cells)
    console.print(table)
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


def _motion_cells(localization_factor: float, peak: float | None) -> list[str]:
    return [output.number_text(localization_factor, ".4f"), output.number_text(peak, ".3g")]


def _words(name: str) -> str:
    return "free or springy edges" if name == "edges" else name.replace("_", " ")


def accuracy(
    scene: options.SceneName,
    /,
    *,
    assignments: options.Assignments = None,
    device: options.Device = "auto",
    budget: float = 120.0,
    path: options.Stepping = "auto",
    out: Path | None = None,
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Measure error against run time for a scene, and recommend grids for errors from 10 % to 0.1 %.

    Grids, spatial orders, time steps and precisions are run from the cheapest to the most expensive and compared with
    a reference solution. The rest of the scene is unchanged.

    Parameters
    ----------
    budget
        Nominal seconds for the grids. They are counted in node-steps, so a busy machine measures the same grids. Grids
        beyond the budget are listed as skipped. The reference solution, modes and the first six grids come on top: up
        to a minute or two where damping couples the modes.
    out
        The file of measurements (.json; default: SCENE-accuracy.json in this folder).
    """
    target = output.output_file(
        out, f"{Path(scene).stem}-accuracy.json", holds="measurements with reference", force=files.force
    )
    if not 0 < budget < float("inf"):
        raise SceneError(f"--budget {budget:g}: must be a positive number of seconds")
    loaded, scene = output.load_scene(scene, assignments)
    from warp_plate.accuracy.machine import describe_machine, describe_versions
    from warp_plate.accuracy.report import measure_accuracy
    from warp_plate.solve.devices import find_device
    from warp_plate.viz.plots.accuracy import draw_accuracy

    name = find_device(device).alias
    machine = describe_machine([name])
    with output.scene_errors(scene), output.progress_bar("measuring", shown=not files.json) as show:
        report = measure_accuracy(loaded, source=scene, device=name, path=path, budget=budget, on_progress=show)
    record = {**report.as_json(), "machine": vars(machine), "versions": describe_versions()}
    written = output.write_measurements(target, record, draw_accuracy, files.pictures)
    show_report = partial(_print_accuracy, report, machine.devices[name])
    output.report(files.json, lambda: record, show_report, written=written)


def _print_accuracy(report: AccuracyReport, device: str, console: Console) -> None:
    reference = report.reference
    console.print(f"{report.scene} on {device}\n")
    for kind in dict.fromkeys(map(_kind, report.rows)):
        head = ("functions",) if kind == BY_MODES else ("nodes", "Δt (s)", "bits")
        table = output.table(*head, *ACCURACY_HEADINGS, title=kind)
        for index, row in enumerate(report.rows):
            if _kind(row) == kind and not row.status.startswith("skipped"):
                table.add_row(*_cells(row, index in report.front, reference.uncertainty))
        if table.row_count:
            console.print(table, "")
    console.print(ACCURACY_LEGEND + "\n")
    console.print(
        f"Reference ({reference.kind}): best single actuator {reference.localization_factors['single']:.5f}, bound "
        f"{reference.bound:.5f}, known to {reference.uncertainty:.1g}.\n"
    )
    laws = output.table("measured laws", "error ∝ h^", "u ∝ h^", "s ∝ n^")
    for law in (law for law in report.laws if law.family != "modal"):  # modes converge faster than any power
        powers = (law.order, law.order_displacement, law.cost_exponent)
        laws.add_row(law.family, *("–" if power is None else f"{power:.2f}" for power in powers))
    if laws.row_count:
        console.print(laws, "")
    console.print(_recommendations(report), "")
    missing: dict[str, list[str]] = {}
    for row in report.rows:
        if not row.measured:
            status = row.status.replace("skipped: would take", "skipped because of the time limit:")
            status, _, reason = status.partition(": ")
            grid = f"{_size(row)} ({reason})" if reason else _size(row)
            missing.setdefault(f"{_kind(row)}, {row.precision}: {status}", []).append(grid)
    for kind, grids in missing.items():
        console.print(f"{kind}: {', '.join(grids)}")
    if report.interrupted:
        console.print("Interrupted by Ctrl-C; measurements up to then are shown.")


def _recommendations(report: AccuracyReport) -> Table:
    from warp_plate.accuracy.configurations import percent, seconds_text

    swarm = f"{report.particles} × {report.iterations} plates"
    table = output.table("for", "use", "error", "a plate", swarm)
    table.columns[1].justify = "left"
    tolerances: dict[tuple[str, ...], list[str]] = {}  # by the other cells
    for recommended in report.recommended:
        cells = ["none within the budget"]
        if recommended.row is not None:
            row = report.rows[recommended.row]
            use = f"modes, {_size(row)}"
            if row.time_step is not None:
                use = f"{_size(row)}, order {row.order}, {row.load}, {row.time_step:.2g} s, {row.precision}"
            seconds = (row.seconds_per_plate or 0.0, recommended.seconds or 0.0)
            error = error_text(row.error, report.reference.uncertainty)
            cells = [use, f"{error} %", *map(seconds_text, seconds)]
        tolerances.setdefault(tuple(cells), []).append(percent(recommended.tolerance))
    for cells_of, asked in tolerances.items():
        table.add_row(", ".join(text.removesuffix(" %") for text in asked) + " %", *cells_of)
    return table


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


def _cells(row: AccuracyRow, on_front: bool, uncertainty: float) -> list[str]:
    from warp_plate.accuracy.configurations import seconds_text
    from warp_plate.accuracy.report import displacement_floor

    head = [_size(row)]
    if _kind(row) != BY_MODES:
        head += ["" if row.time_step is None else f"{row.time_step:.2g}", row.precision.removeprefix("float")]
    if not row.measured:
        return [*head, *[""] * 4, row.status.partition(":")[0], ""]
    head += [f"{row.localization_factor:.4f}", f"{row.bound:.4f}"]
    errors = (row.error, row.error_displacement)
    floors = (uncertainty, displacement_floor(uncertainty))
    shown = list(map(error_text, errors, floors))
    return [*head, *shown, seconds_text(row.seconds_per_plate or 0.0), "*" if on_front else ""]
