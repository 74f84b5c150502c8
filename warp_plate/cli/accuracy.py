"""``warp-plate accuracy``: error against run time, and grids that it recommends."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.accuracy.measure import AccuracyRow
    from warp_plate.accuracy.report import AccuracyReport

HEADINGS = ("single", "bound", "error %", "u %", "a plate", "")
BY_MODES = "modes, without a grid"
ACCURACY_LEGEND = (
    "single, bound: localization factor of the best single actuator, and the largest that any drive can have. error: "
    "largest relative error of single, best drive and bound; u: error of the displacement under the best drive (L2 "
    "norm over plate and window). a plate: seconds per plate in a swarm, of modes its share of all that the swarm "
    "takes, from the scene on. ≤ no larger than the reference's own error: a bound. * no other row is both more "
    "accurate and faster; ~ not known."
)


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

    write = partial(output.write_measurements, target, record, draw_accuracy, files.pictures)
    show_report = partial(_print_accuracy, report, machine["devices"][name])
    output.report(files.json, lambda: record, show_report, write=write)


def _print_accuracy(report: AccuracyReport, device: str, console: Console) -> None:
    reference = report.reference
    console.print(f"{report.scene} on {device}\n")
    measured = [(index, row) for index, row in enumerate(report.rows) if row.measured]
    for kind in dict.fromkeys(_kind(row) for _, row in measured):
        headings = ("functions",) if kind == BY_MODES else ("nodes", "Δt (s)", "precision")
        rows = [_cells(report, index) for index, row in measured if _kind(row) == kind]
        output.print_rows(console, (*headings, *HEADINGS), rows, "", title=kind)
    console.print(ACCURACY_LEGEND + "\n")
    console.print(
        f"Reference ({reference.kind}): best single actuator {reference.localization_factors['single']:.5f}, bound "
        f"{reference.bound:.5f}, known to {reference.uncertainty:.1g}.\n"
    )
    laws = [law for law in report.laws if law.family != "modal"]  # modes converge faster than any power
    if laws:
        columns = ("measured laws", "error ∝ h^", "u ∝ h^", "s ∝ n^")
        powers = ("order", "order_displacement", "cost_exponent")
        cells = [[law.family, *(output.number_text(getattr(law, name), ".2f") for name in powers)] for law in laws]
        output.print_rows(console, columns, cells, "")
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


def _cells(report: AccuracyReport, index: int) -> list[str]:
    """Return the texts of the cells of a measured row."""
    from warp_plate.accuracy.configurations import seconds_text
    from warp_plate.accuracy.report import displacement_floor

    row, uncertainty = report.rows[index], report.reference.uncertainty
    step = [] if row.load == "modal" else [output.number_text(row.time_step, ".2g"), row.precision]
    return [
        _size(row),
        *step,
        *(output.number_text(value, ".4f") for value in (row.localization_factor, row.bound)),
        error_text(row.error, uncertainty),
        error_text(row.error_displacement, displacement_floor(uncertainty)),
        seconds_text(row.seconds_per_plate or 0.0),
        "*" if index in report.front else "",
    ]
