"""``warp-plate measured SCENE``: drives from measured responses, without a model of the plate."""

from __future__ import annotations

import glob
import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    import numpy as np

    from warp_plate.problem.trade_off import Compromise
    from warp_plate.studies.measured_drives import MeasuredDrives

SHOWN = 7  # compromises between contrast and fidelity that are printed


def measured(
    scene: Annotated[Path, Parameter(help="A TOML file with a table [measured].")],
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Find drives from measured responses alone: no plate is computed.

    The table [measured] of the scene names a file with the responses of scanned points to each actuator (HDF5, MAT or
    universal). The answer has the drive of the largest localization factor with an interval and what bounds all drives,
    the trade-off of contrast against fidelity; with [specification] the drive of least effort for wanted and allowed
    levels; with [focus] waveforms, as WAV files. It is written to a .json file with a picture; see
    docs/measured-drives.md.
    """
    from warp_plate.result.export import write_wav
    from warp_plate.scene.measured import MeasuredScene
    from warp_plate.studies.measured_drives import measured_drives
    from warp_plate.viz.plots.measured import draw_measured

    target = files.target(str(scene), "-measured.json", "measurements with measured_bound")
    loaded = MeasuredScene.load(scene, changes.assignments or [])
    own = target.exists() and '\n "focus":' in target.read_text(encoding="utf-8", errors="replace")
    if loaded.focus is not None and not own:
        for waveform in sorted(target.parent.glob(f"{glob.escape(target.stem)}-*.wav")):
            output.check_overwriting(waveform, "a waveform of measured", files.force)
    with output.progress_bar("frequencies", shown=not files.json) as show:
        found = measured_drives(loaded, on_progress=show)
    record = output.json_value(_as_json(str(scene), found))
    draw = partial(draw_measured, found)
    others = {path: partial(write_wav, signal) for path, signal in found.waveforms(target).items()}
    write = partial(output.write_measurements, target, record, lambda _, *paths: draw(*paths), files.pictures, others)
    output.report(files.json, lambda: record, partial(_print, str(scene), found), write=write)


def answers_measured(
    scene: str | None, needed: str | None, changes: options.SceneChanges, files: options.FileOptions, *others: object
) -> bool:
    """Answer a scene with a table [measured] as the command ``measured`` does; return False for other scenes.

    Args:
        needed: table that the scene must have.
        others: options of the command that must not be given, for there is no plate to compute.
    """
    from warp_plate.scene.load import parse_toml, read_scene_text
    from warp_plate.scene.measured import MeasuredScene

    if scene is None or "measured" not in parse_toml(read_scene_text(scene)[0], scene):
        return False
    for of in (changes, *others):
        for name, value in vars(of).items():
            if name != "assignments" and value != getattr(type(of)(), name):
                option = name.replace("_", "-")
                raise SceneError(f"--{option}: is of computed plates; {scene} has responses that were measured")
    if needed is not None and getattr(MeasuredScene.load(scene, changes.assignments or []), needed) is None:
        raise SceneError(f"{scene}: {needed}: is missing; write [{needed}], see docs/measured-drives.md")
    measured(Path(scene), changes=options.SceneChanges(changes.assignments), files=files)
    return True


def _as_json(source: str, found: MeasuredDrives) -> dict[str, object]:
    best, levels, focus = found.localized, found.levels, found.focus
    record: dict[str, object] = {
        "scene": source,
        "frequency": found.frequency,
        "drive": _drive(found, best.drive),
        "localization_factor": best.factor,
        "interval": best.interval,
        "robust": {"drive": _drive(found, best.robust_drive), "localization_factor": best.robust_factor}
        | {"interval": best.robust_interval},
        "measured_bound": best.measured_bound,
        "bound": best.bound,
        "spectrum": {"frequencies": found.frequencies, "bounds": found.factors},
        "trade_off": [_compromise(found, one) for one in found.curve],
        "spans": [_compromise(found, one) for one in found.spans],
        "warnings": found.warnings,
    }
    if levels is not None:
        names = ("frequency", "feasible", "proved", "effort", "effort_bound", "contrast_db", "contrast_bound_db")
        record["specification"] = {
            **output.attributes(levels, *names),
            "drive": _drive(found, levels.drive),
            "contrast_drive": _drive(found, levels.contrast_drive),
            "levels": [vars(level) for level in levels.levels],
        }
    if focus is not None:
        figures = ("peak", "contrast_db", "crosstalk_db", "misfit", "gap")
        methods = {name: output.attributes(method, *figures) for name, method in focus.methods.items()}
        record["focus"] = {"points": focus.table.points, "bound": focus.bound, "methods": methods}
    return record


def _drive(found: MeasuredDrives, drive: np.ndarray) -> dict[str, dict[str, float]]:
    """Return magnitudes, in the unit of the drives, and phase lags [rad] by the names of the actuators."""
    values = zip(found.names, drive * found.plate.largest, strict=True)
    return {name: {"magnitude": abs(value), "phase": -math.atan2(value.imag, value.real)} for name, value in values}


def _compromise(found: MeasuredDrives, one: Compromise) -> dict[str, object]:
    return {**output.attributes(one, "contrast_db", "misfit", "bound"), "drive": _drive(found, one.drive)}


def _print(source: str, found: MeasuredDrives, console: Console) -> None:
    best, matrix, unit = found.localized, found.plate.matrix, found.scene.measured.unit
    size = f"{len(matrix.points)} points, {len(found.names)} actuators, {len(matrix.frequencies)} frequencies"
    console.print(f"{found.scene.title or source}: {size}; the drive for {next(iter(found.plate.targets))}\n")
    rows = []
    for name, (factor, (low, high)) in {
        "largest": (best.factor, best.interval),
        "robust": (best.robust_factor, best.robust_interval),
    }.items():
        rows.append([name, *(f"{100 * value:.2f} %" for value in (factor, low, high))])
    heading = f"localization factor at {found.frequency:.6g} Hz"
    output.print_rows(console, [heading, "measured", "true, from", "to"], rows, "")
    console.print(
        f"No drive has a larger factor than {100 * best.measured_bound:.2f} % by the measured responses, nor than "
        f"{100 * best.bound:.2f} % by responses within their errors.\n"
    )
    columns = {"largest": best.drive, "robust": best.robust_drive}
    if found.levels is not None:
        columns["levels"] = found.levels.drive
    headings = ["actuator", *(cell for name in columns for cell in (f"{name} ({unit})", "phase lag (°)"))]
    shown = {name: _drive(found, drive) for name, drive in columns.items()}
    rows = [
        [name, *(cell for of in shown.values() for cell in _cells(of[name]["magnitude"], of[name]["phase"]))]
        for name in found.names
    ]
    output.print_rows(console, headings, rows, "")
    few = found.curve[:: max(1, len(found.curve) // SHOWN)]
    rows = [[f"{one.contrast_db:.2f}", f"{100 * one.misfit:.2f}", f"{100 * one.bound:.2f}"] for one in few]
    title = "Contrast of target and rest, against the misfit of the target's motion"
    output.print_rows(console, ["contrast (dB)", "least misfit (%)", "no drive below (%)"], rows, "", title=title)
    _print_levels(found, console)
    if found.focus is not None:
        _print_focus(found, console)
    output.print_warnings(console, found.warnings)


def _cells(magnitude: float, phase: float) -> list[str]:
    return [output.number_text(magnitude, ".4g"), output.number_text(round(math.degrees(phase), 1) + 0.0, ".1f")]


def _print_levels(found: MeasuredDrives, console: Console) -> None:
    if (levels := found.levels) is None:
        return
    rows = [
        [row.name, *(output.number_text(value, ".4g") for value in (row.wanted, row.reached, row.uncertainty))]
        for row in levels.levels
    ]
    output.print_rows(console, ["level (m/s² peak)", "limit", "reached", "± of the mean"], rows, "")
    met = "a drive meets" if levels.feasible else "no drive meets" if levels.proved else "no drive was found that meets"
    effort, least = f"{100 * levels.effort:.3g} % of the largest drives", f"{100 * levels.effort_bound:.3g} %"
    effort = f"the least effort is {effort}, proved to be at least {least}"
    if math.isinf(levels.effort):
        least = "a million times" if levels.effort_bound > 1e6 else f"{least} of"
        effort = f"one would take at least {least} the largest drives"
    console.print(f"At {levels.frequency:.6g} Hz {met} the levels; {effort}.")
    if math.isfinite(levels.contrast_db):
        console.print(
            f"Elsewhere over target: {levels.contrast_db:.2f} dB within the largest drives; no drive has less than "
            f"{levels.contrast_bound_db:.2f} dB."
        )


def _print_focus(found: MeasuredDrives, console: Console) -> None:
    assert found.focus is not None
    for index, (x, y) in enumerate(found.focus.table.points):
        rows = []
        for name, method in found.focus.methods.items():
            numbers = method.peak[index], method.contrast_db[index], 100 * max(float(method.gap[index]), 0.0)
            cells = [
                output.number_text(value, digits) for value, digits in zip(numbers, (".4g", ".1f", ".2g"), strict=True)
            ]
            rows.append([name.replace("_", " "), *cells])
        unit = "m" if found.focus.table.quantity == "displacement" else "m/s"
        output.print_rows(console, [f"at {x:g},{y:g}", f"peak ({unit})", "contrast (dB)", "below bound (%)"], rows, "")
