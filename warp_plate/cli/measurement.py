"""``warp-plate fit`` and ``verify``: a panel's measurements and its scene."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.cli.report import Report, check_report, write_report
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.fitting.fit import ModeFit, ResponseFit
    from warp_plate.scene.model import Scene
    from warp_plate.studies.verify import Verification

# First words of the file; correlations that are reported.
FITTED = "# Fitted by warp-plate"


def fit(
    scene: options.SceneName,
    /,
    *,
    data: Annotated[list[Path], Parameter(negative="")],
    changes: options.SceneChanges = options.SceneChanges(),
    report: Report = None,
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Fit properties of a panel to its measured natural frequencies or frequency responses, with 95 % intervals.

    The table [fit.free] of the scene lists the free properties and their ranges, such as
    "plate.young_modulus" = [6e10, 8e10]. The fitted scene is written as a scene file, SCENE.fitted.toml. Properties
    that the data cannot distinguish are reported and have no interval.

    Parameters
    ----------
    data
        Text table with a header that names its columns: frequency (in Hz, or a unit that the header names) and, if they
        are known, damping (damping ratio), mode (number of the mode, from 1 for the lowest) and shapes (shape X Y for
        each point); or a universal file (.uff, .unv, .ufb; needs the extra uff) with a dataset 55 for each mode. For a
        scene with tables [[measurement]] its frequency responses: a table with the columns frequency, real and
        imaginary part, or magnitude and phase, of each; a universal file with a dataset 58 for each; .mat, .h5 or .nc
        with the arrays frequency and response; or time signals, as .wav, or as a table with [fit.signals]. May be
        repeated, for files with as many responses each. Without [[measurement]] a .wav of a tap has its modes.
    """
    from warp_plate.fitting.fit import fit as fit_files
    from warp_plate.result.atomic_io import write_atomically

    target = files.target(scene, ".fitted.toml", holds=FITTED)
    check_report(report, files.force)
    loaded, scene = changes.load(scene)
    if loaded.folder is not None and loaded.folder.resolve() != target.parent.resolve():
        raise SceneError(f"--out {target}: the scene names files in {loaded.folder}; write there")
    with output.scene_errors(scene):
        fitted = fit_files(loaded, data)
    heading = f"{FITTED} to {', '.join(repr(path.name) for path in data)}"
    save = partial(write_atomically, f"{heading}\n{fitted.scene.to_toml()}".encode())
    saves: dict[Path, Callable[[Path], object]] = {target: save}
    if report is not None:
        named = ", ".join(path.name for path in data)
        title, show = f"Fit of {fitted.scene.title or scene} to {named}", partial(_print_fit, scene, fitted)
        page = partial(
            write_report, title=title, show=show, draw=partial(_draw, fitted), appendix=fitted.scene.to_toml()
        )
        saves[report] = page
    write = partial(output.write_files, saves, partial(_draw, fitted, target) if files.pictures else None)
    output.report(files.json, _fit_as_json, _print_fit, scene, fitted, write=write)


def _draw(fitted: ModeFit | ResponseFit, target: Path) -> output.Drawn:
    from warp_plate.fitting.fit import ResponseFit, assurance
    from warp_plate.viz.plots.frame import save_plots
    from warp_plate.viz.plots.responses import draw_mode_fit, draw_response_fit

    if isinstance(fitted, ResponseFit):
        return save_plots(partial(draw_response_fit, fitted), target)
    mac = assurance(fitted.scene, fitted.measured, fitted.numbers)
    return save_plots(partial(draw_mode_fit, fitted, mac=mac), target)


def _fit_as_json(name: str, fitted: ModeFit | ResponseFit) -> dict[str, object]:
    from warp_plate.fitting.fit import ResponseFit

    columns = {"value": fitted.values, "low": fitted.low, "high": fitted.high, "at_limit": fitted.at_limit}
    record: dict[str, object] = {
        "scene": name,
        "parameters": {key: {name: of[row] for name, of in columns.items()} for row, key in enumerate(fitted.keys)},
        **output.attributes(fitted, "correlations", "inseparable", "mirrored", "evaluations"),
    }
    record |= output.attributes(fitted, "undetermined", "remarks")
    record["verdict"] = output.attributes(fitted.verdict, "describes", "cause", "error", "text")
    measured = fitted.measured.frequencies
    if isinstance(fitted, ResponseFit):
        record |= {"frequencies": measured, "real": fitted.responses.real, "imaginary": fitted.responses.imag}
        return record | output.attributes(fitted, "rms_decibels", "rms_degrees")
    record |= {"modes": fitted.numbers, "frequencies_measured": measured}
    record |= output.attributes(fitted, "frequencies", "errors")
    record |= {"damping_ratios_measured": fitted.measured.damping, "damping_ratios": fitted.damping}
    bars = fitted.measured.damping_bars
    return record if bars is None else record | {"damping_ratio_bars": bars}


def _print_fit(name: str, fitted: ModeFit | ResponseFit, console: Console) -> None:
    import numpy as np

    from warp_plate.fitting.fit import ResponseFit

    console.print(f"{fitted.scene.title or name}\n")
    _print_properties(fitted, console)
    if isinstance(fitted, ResponseFit):
        driven = (at.actuator or "{:g},{:g}".format(*at.force_at or ()) for at in fitted.scene.measurement)
        names = [
            f"{name} → {at.point[0]:g},{at.point[1]:g}"
            for name, at in zip(driven, fitted.scene.measurement, strict=True)
        ]
        columns = {"rms error (dB)": (fitted.rms_decibels, ".2g"), "rms error (°)": (fitted.rms_degrees, ".2g")}
    else:
        names = [str(number) for number in fitted.numbers]
        columns = {"measured (Hz)": (fitted.measured.frequencies, ".6g"), "fitted (Hz)": (fitted.frequencies, ".6g")}
        columns["error (%)"] = 100 * fitted.errors, ".2g"
        if np.isfinite(fitted.measured.damping).any():
            columns["damping measured"] = fitted.measured.damping, ".3g"
            if fitted.measured.damping_bars is not None:
                columns["±"] = fitted.measured.damping_bars, ".2g"
            columns["fitted"] = fitted.damping, ".3g"
    cells = [[output.number_text(value, digits) for value in values] for values, digits in columns.values()]
    kind = "response" if isinstance(fitted, ResponseFit) else "mode"
    output.print_rows(console, (kind, *columns), list(zip(names, *cells, strict=True)))
    output.print_warnings(console, fitted.warnings)


def _print_properties(fitted: ModeFit | ResponseFit, console: Console) -> None:
    """Print the values of the free properties with their intervals."""
    from warp_plate.scene.keys import unit_of

    headings = ["number", "unit", "value", "95 % from", "to"]
    rows = []
    for key, *values in zip(fitted.keys, fitted.values, fitted.low, fitted.high, strict=True):
        rows.append([key, unit_of(fitted.scene, key), *(output.number_text(value, ".5g") for value in values)])
    output.print_rows(console, headings, rows, "")


def verify(
    result: options.ResultFile,
    /,
    *,
    data: Path,
    case: str | None = None,
    report: Report = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Compare velocities measured under a drive with those that its result predicts.

    The measured localization factor comes with its uncertainty. One part is the noise; the other is the small number of
    points, estimated from the predicted field.

    Parameters
    ----------
    data
        CSV file whose first line names its columns: x and y (metres), velocity (root mean square, in any unit) and
        optionally uncertainty (standard deviation, in the same unit). Without that column, the spread of repeated
        readings at a point is the uncertainty.
    case
        Name of the drive in the result (default: best, or the one that was simulated).
    """
    from warp_plate.result.model import load_result
    from warp_plate.studies.verify import verify as compare_velocities

    check_report(report, force)
    loaded = load_result(result)
    verified = compare_velocities(loaded, data, case)
    write = None
    if report is not None:
        title = f"Verification of {loaded.scene.title or result} by {data.name}"
        show = partial(_print_verified, verified)
        draw = partial(_draw_verified, verified, loaded.case_scene(loaded.select_cases([verified.case])[verified.case]))
        save = partial(write_report, title=title, show=show, draw=draw, appendix=loaded.scene.to_toml())
        write = partial(output.write_files, {report: save}, None)
    output.report(json, _verified_as_json, _print_verified, verified, write=write)


def _draw_verified(verified: Verification, scene: Scene, path: Path) -> output.Drawn:
    from warp_plate.viz.plots.frame import save_plots
    from warp_plate.viz.plots.measured import draw_verified

    return save_plots(partial(draw_verified, verified, scene), path, [".png"])


def _verified_as_json(verified: Verification) -> dict[str, object]:
    names = ("case", "promised_factor", "localization_factor", "deviation", "sampling", "interval", "kept", "scale")
    return {
        **output.attributes(verified, *names, "correlation", "mirrored"),
        "points": verified.measured.points,
        "measured": verified.measured.velocity,
        "promised": verified.promised,
    }


def _print_verified(verified: Verification, console: Console) -> None:
    rows = (
        ("promised", verified.promised_factor, ".2f"),
        ("measured", verified.localization_factor, ".2f"),
        ("standard deviation by noise", verified.deviation, ".2g"),
        ("error of sampling", verified.sampling, ".2g"),
        ("measured, from", verified.interval[0], ".2f"),
        ("to", verified.interval[1], ".2f"),
    )
    percents = [(name, output.number_text(100 * value, digits, " %")) for name, value, digits in rows]
    output.print_rows(console, ("localization factor", ""), percents)
    console.print(
        f"\n{len(verified.promised)} points: measured velocities are {verified.scale:.4g} times the promised ones, and "
        f"their cosine is {verified.correlation:.4f}."
    )
    output.print_warnings(console, verified.warnings)
