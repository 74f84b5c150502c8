"""``warp-plate specify SCENE``: the drive that meets a specification, or what is in its way."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.cli.measured import answers_measured

if TYPE_CHECKING:
    from warp_plate.result.specified import RegionLevels, SpecifiedDrive

BEST = ".best.toml"
# Most cases of the tolerances that are printed.
MOST_CASES = 12
# Least gain [dB] of a limit twice as large, at first, that is printed.
LEAST_GAIN = 0.01
NOTHING = 1e-12  # over the least level wanted: the motion of a nodal point or a held edge
MEASURES = ("weakest", "mean", "worst")


def specify(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    tolerances: Annotated[bool, Parameter(help="Also find one drive for all cases of the tolerances.")] = True,
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Find the drive that meets the levels of [specification], or prove that none does.

    Levels in targets and elsewhere hold at every point, in steady motion. The answer has forces, margins of all
    requirements, what is in the way, and what larger limits would do; it is written to a .json file with a picture,
    and the drive as OUT.best.toml, which simulate runs.

    A scene with [measured] in place of [plate] is answered from its measured responses, as by measured.
    """
    if answers_measured(scene, "specification", changes, files):
        return
    import warp_plate
    from warp_plate.result.atomic_io import write_atomically
    from warp_plate.scene.errors import toml_comment
    from warp_plate.viz.plots.specified import draw_specified

    target = files.target(scene, "-specify.json", "measurements with contrast_db")
    best = target.with_suffix(BEST)
    output.check_overwriting(best, "# Found by: warp-plate specify", files.force)
    loaded, scene = changes.load(scene)
    with output.scene_errors(scene), output.progress_bar("frequencies", shown=not files.json) as show:
        answer = warp_plate.specify(loaded, tolerances, on_progress=show)
    record = _as_json(scene, answer)
    draw = partial(draw_specified, answer)
    run = f"Run it by: warp-plate simulate {best.name} --path modal"
    head = toml_comment(f"Found by: warp-plate specify {scene}", run)
    others = {best: partial(write_atomically, (head + answer.driven_scene().to_toml()).encode())}
    write = partial(output.write_measurements, target, record, lambda _, *paths: draw(*paths), files.pictures, others)
    output.report(files.json, lambda: record, partial(_print, scene, answer), write=write)


def _as_json(source: str, answer: SpecifiedDrive) -> dict[str, object]:
    names = ("feasible", "proved", "frequency", "contrast_db", "bound_db", "interval", "effort", "largest_level")
    driven = {"V": "voltages", "N": "forces", "A": "currents"}.get(answer.unit, "drives")
    record = {
        "scene": source,
        **output.attributes(answer, *names),
        driven: answer.peaks,
        "phases": answer.phases,
        "levels": {row.name: _level_as_json(answer, row) for row in answer.levels},
        "margins": [vars(row) for row in answer.margins],
        "obstacles": answer.obstacles,
        "gains_db": dict(zip(answer.peaks, answer.gains.tolist(), strict=True)),
        "spectrum": output.attributes(answer, "frequencies", "contrasts", "efforts"),
        "pareto": {part: getattr(answer, f"pareto_{part}") for part in ("levels", "contrasts", "efforts")},
        "tolerances": [vars(row) for row in answer.scatter],
        "robust": answer.robust if answer.scatter else None,
        "robust_frequency": answer.robust_frequency if answer.scatter else None,
        f"robust_{driven}": answer.robust_peaks if answer.scatter else None,
        "robust_phases": answer.robust_phases if answer.scatter else None,
        "notes": answer.notes,
    }
    return output.json_value(record)


def _level_as_json(answer: SpecifiedDrive, row: RegionLevels) -> dict[str, object]:
    rms = {f"{measure}_rms": getattr(row, measure) / math.sqrt(2) for measure in MEASURES}
    return {**output.attributes(row, *MEASURES, "worst_at", "weakest_at"), **rms, **_decibels(answer, row)}


def _decibels(answer: SpecifiedDrive, row: RegionLevels) -> dict[str, float]:
    """Return the levels of a region over the least level that is wanted."""
    levels = {measure: getattr(row, measure) / answer.least_wanted for measure in MEASURES}
    return {
        f"{measure}_db": 20 * math.log10(level) if level > NOTHING else -math.inf for measure, level in levels.items()
    }


def _print(source: str, answer: SpecifiedDrive, console: Console) -> None:
    console.print(f"{answer.scene.title or source}: {answer.verdict}\n")
    mixed = len(set(answer.units)) > 1
    unit = "" if mixed else f" ({answer.unit})"
    drives = [(answer.peaks, answer.phases)]
    headings = ["actuator", f"limit{unit}", f"peak{unit}", "phase lag (°)"]
    if answer.scatter:
        drives.append((answer.robust_peaks, answer.robust_phases))
        headings[2] = f"at {answer.frequency:.6g} Hz: peak{unit}"
        headings += [f"for all cases, at {answer.robust_frequency:.6g} Hz: peak{unit}", "phase lag (°)"]
    rows = []
    for name, limit, own in zip(answer.peaks, answer.limits.tolist(), answer.units, strict=True):
        after = f" {own}" if mixed else ""
        rows.append([name, f"{limit:.4g}{after}"])
        for peaks, phases in drives:
            rows[-1] += [f"{peaks[name]:.4g}{after}", f"{math.degrees(phases[name]):.1f}"]
    output.print_rows(console, headings, rows, "")
    _print_levels(answer, console)
    rows = [
        [row.requirement, f"{row.wanted:.4g}", f"{row.reached:.4g}", row.unit, f"{round(row.margin_db, 2) + 0.0:+.2f}"]
        for row in answer.margins
    ]
    requirement = f"requirement at {answer.frequency:.6g} Hz" if answer.scatter else "requirement"
    output.print_rows(console, [requirement, "limit", "reached", "unit", "margin (dB)"], rows, "")
    if math.isfinite(answer.contrast_db):
        low, high = answer.interval
        digits = 3 if high - low > 0.01 else 5
        console.print(
            f"Contrast, elsewhere over target: {answer.contrast_db:.2f} dB, with the numerical error {low:.{digits}f} "
            f"to {high:.{digits}f} dB; no drive within the limits has less than {answer.bound_db:.2f} dB."
        )
    gains = zip(answer.peaks, answer.gains.tolist(), answer.limits.tolist(), answer.units, strict=True)
    worth = [f"{gain:.3g} dB/{unit} at {name}" for name, gain, limit, unit in gains if gain * limit > LEAST_GAIN]
    if worth:
        console.print(f"Larger limits lower the contrast, at first by {', '.join(worth)}.")
    if answer.feasible:
        console.print(f"A drive within {100 * answer.effort:.3g} % of the limits meets the specification, too.")
    if answer.pareto_levels.size:
        _print_pareto(answer, console)
    if answer.scatter:
        _print_tolerances(answer, console)
    output.print_warnings(console, answer.warnings)


def _print_levels(answer: SpecifiedDrive, console: Console) -> None:
    """Print the levels of all regions, peak and rms, in g and µm, and in dB over the least level wanted."""
    from warp_plate.scene.specification import STANDARD_GRAVITY

    micrometres, rows = 1e6 / (2 * math.pi * answer.frequency) ** 2, []
    for row in answer.levels:
        decibels = [output.number_text(level, ".2f") for level in _decibels(answer, row).values()]
        for kind, part in (("peak", 1.0), ("rms", 1 / math.sqrt(2))):
            levels = [getattr(row, measure) * part for measure in MEASURES]
            cells = [f"{value * unit:.4g}" for unit in (1 / STANDARD_GRAVITY, micrometres) for value in levels]
            rows.append([row.name, kind, *cells, *(decibels if kind == "peak" else [""] * len(decibels))])
    headings = [
        f"levels at {answer.frequency:.6g} Hz",
        "",
        *(f"{measure} ({unit})" for unit in ("g", "µm", "dB") for measure in MEASURES),
    ]
    output.print_rows(console, headings, rows, "", texts=2)
    if (beyond := answer.where_elsewhere) is not None:
        console.print(f"{beyond}\n")


def _print_pareto(answer: SpecifiedDrive, console: Console) -> None:
    """Print the least contrast and the least effort for every other level of the curve."""
    rows = []
    curve = (answer.pareto_levels, answer.pareto_contrasts, answer.pareto_efforts)
    for level, contrast, effort in list(zip(*(part.tolist() for part in curve), strict=True))[::2]:
        rows.append([f"{level:.4g}", output.number_text(contrast, ".1f"), output.number_text(100 * effort, ".3g")])
    headings = ["level over that wanted", "least contrast (dB)", "least limits as specified (%)"]
    output.print_rows(console, headings, rows, "", title="Other levels in the target")


def _print_tolerances(answer: SpecifiedDrive, console: Console) -> None:
    """Print the worst cases of the tolerances: the nominal drive, one drive for all, and the best of each."""
    worst = sorted(answer.scatter, key=lambda case: (case.met, -case.robust_db))[:MOST_CASES]
    rows = []
    for case in worst:
        levels = [f"{case.nominal_level:.3f}", f"{case.nominal_db:.2f}", f"{case.robust_level:.3f}"]
        best = output.number_text(case.best_db, ".2f")
        rows.append([case.text, *levels, f"{case.robust_db:.2f}", "yes" if case.met else "no", best])
    headings = ["case", "nominal drive: level", "contrast (dB)", "one drive for all: level", "contrast (dB)", "met"]
    title = f"Tolerances (levels over those wanted), one drive for all at {answer.robust_frequency:.6g} Hz"
    output.print_rows(console, [*headings, "retuned (dB)"], rows, "", title=title)
    if (others := len(answer.scatter) - len(worst)) > 0:
        console.print(f"{others} better cases are left out; --json has all.\n")
