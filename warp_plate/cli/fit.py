"""``warp-plate fit SCENE --data FILE``: properties of a panel from measurements."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from warp_plate.fitting.fit_modes import ModeFit
    from warp_plate.fitting.fit_responses import ResponseFit

# First words of the file; correlations that are reported.
HEADING, STRONG = "# Fitted by warp-plate", 0.9


def fit(
    scene: options.SceneName,
    /,
    *,
    data: Annotated[list[Path], Parameter(negative="")],
    assignments: options.Assignments = None,
    out: Path | None = None,
    force: options.Force = False,
    pictures: options.Pictures = True,
    json: options.Json = False,
) -> None:
    """Fit properties of a panel to its measured natural frequencies or frequency responses, with 95 % intervals.

    The table [fit.free] of the scene lists the free properties and their ranges, such as
    "plate.young_modulus" = [6e10, 8e10]. The fitted scene is written as a scene file. Properties that the data cannot
    distinguish are reported and have no interval. fit.bootstrap = 200 adds intervals by the bootstrap, and
    fit.profile = 11 the profile likelihood of each property.

    Parameters
    ----------
    data
        CSV file whose first line names its columns: frequency (hertz) and, if they are known, damping (damping ratio),
        mode (number of the mode, from 1 for the lowest) and shapes (shape X Y for each point); or a universal file
        (.uff, .unv; needs the extra uff) with a dataset 55 for each mode. For a scene with tables [[measurement]] its
        frequency responses: CSV with the columns frequency, real and imaginary part of each; a universal file with a
        dataset 58 for each; .mat, .h5 or .nc with the arrays frequency and response; or time signals, as .wav, or as
        .csv with the table [fit.signals]. May be repeated, for files with as many responses each.
    out
        The fitted scene (.toml; default: SCENE.fitted.toml in this folder). Pictures of measured and fitted values
        (.png and .svg) are written beside it under the same name, and those of profile likelihoods under
        SCENE.fitted.profiles.
    """
    target = output.output_file(out, f"{Path(scene).stem}.fitted.toml", (), HEADING, force)
    loaded, scene = output.load_scene(scene, assignments)
    from warp_plate.fitting.fit import fit as fit_files
    from warp_plate.result.atomic_io import atomic_paths

    if loaded.folder is not None and loaded.folder.resolve() != target.parent.resolve():
        raise SceneError(f"--out {target}: the scene names files in {loaded.folder}; write the fitted scene there")
    with output.scene_errors(scene):
        if len(data) > 1 and not loaded.measurement:
            raise SceneError(f"--data {data[1]}: several files hold responses of tables [[measurement]]; there is none")
        found = fit_files(loaded, data)
    with atomic_paths(target) as (temporary,):
        temporary.write_text(
            f"{HEADING} to {', '.join(repr(path.name) for path in data)}\n{found.scene.to_toml()}", encoding="utf-8"
        )
    drawn, missing = _draw(found, target) if pictures else ([], None)
    written = [target, *drawn], missing
    output.report(json, partial(_as_json, scene, found), partial(_print, scene, found), written)


def _draw(found: ModeFit | ResponseFit, target: Path) -> output.Drawn:
    from warp_plate.fitting.assurance import assurance
    from warp_plate.fitting.fit_responses import ResponseFit
    from warp_plate.viz.plots.fit import draw_mode_fit, draw_profiles, draw_response_fit
    from warp_plate.viz.plots.frame import save_plots

    if isinstance(found, ResponseFit):
        drawn, missing = save_plots(draw_response_fit, found, target)
    else:
        mac = assurance(found.scene, found.measured, found.numbers)
        drawn, missing = save_plots(partial(draw_mode_fit, mac=mac), found, target)
    if found.profiles is not None and missing is None:
        drawn = [*drawn, *save_plots(draw_profiles, found, target.with_suffix(".profiles.toml"))[0]]
    return drawn, missing


def _as_json(name: str, found: ModeFit | ResponseFit) -> dict[str, object]:
    columns = {"value": found.values, "low": found.low, "high": found.high, "at_limit": found.at_limit}
    if found.bootstrap is not None:
        columns["bootstrap"] = found.bootstrap.T
    if found.profiles is not None:
        columns["profile"], columns["profile_rise"] = found.profiles
    return {
        "scene": name,
        "parameters": {key: {name: of[row] for name, of in columns.items()} for row, key in enumerate(found.keys)},
        **output.attributes(found, "correlations", "inseparable", "mirrored", "evaluations"),
        **_compared(found),
    }


def _compared(found: ModeFit | ResponseFit) -> dict[str, object]:
    """Return measured and fitted values, for ``--json``."""
    from warp_plate.fitting.fit_responses import ResponseFit

    if isinstance(found, ResponseFit):
        record = {"frequencies": found.measured.frequencies, "real": found.responses.real}
        record |= {"imaginary": found.responses.imag}
        return record | output.attributes(found, "rms_decibels", "rms_degrees")
    return {
        "modes": found.numbers,
        "frequencies_measured": found.measured.frequencies,
        **output.attributes(found, "frequencies", "errors"),
        "damping_ratios_measured": found.measured.damping,
        "damping_ratios": found.damping,
    }


def _print(name: str, found: ModeFit | ResponseFit, console: Console) -> None:
    from warp_plate.fitting.fit_responses import ResponseFit
    from warp_plate.scene.keys import unit_of

    console.print(f"{found.scene.title or name}\n")
    resampled = () if found.bootstrap is None else ("bootstrap from", "to")
    made = output.table("number", "unit", "value", "95 % from", "to", *resampled)
    ends = () if found.bootstrap is None else found.bootstrap
    for key, *numbers in zip(found.keys, found.values, found.low, found.high, *ends, strict=True):
        made.add_row(key, unit_of(found.scene, key), *(output.number_text(value, ".5g") for value in numbers))
    output.print_uncropped(console, made)
    console.print()
    output.print_uncropped(console, _responses(found) if isinstance(found, ResponseFit) else _modes(found))
    for line in _remarks(found):
        console.print(f"! {line}")


def _responses(found: ResponseFit) -> Table:
    """Return the table of the errors of each response."""
    made = output.table("response", "rms error (dB)", "rms error (°)")
    rows = zip(found.scene.measurement, found.rms_decibels, found.rms_degrees, strict=True)
    for each, decibels, degrees in rows:
        driven, (x, y) = each.actuator or "{:g},{:g}".format(*each.force_at or ()), each.point
        made.add_row(f"{driven} → {x:g},{y:g}", f"{decibels:.2g}", f"{degrees:.2g}")
    return made


def _modes(found: ModeFit) -> Table:
    """Return the table of modes, measured and fitted."""
    damped = bool(np.isfinite(found.measured.damping).any())
    ratios = ("damping measured", "fitted") if damped else ()
    made = output.table("mode", "measured (Hz)", "fitted (Hz)", "error (%)", *ratios)
    columns = (found.numbers, found.measured.frequencies, found.frequencies, 100 * found.errors)
    for number, measured, fitted, error, *pair in zip(*columns, found.measured.damping, found.damping, strict=True):
        cells = [output.number_text(value, ".3g") for value in pair] if damped else []
        made.add_row(str(number), f"{measured:.6g}", f"{fitted:.6g}", f"{error:.2g}", *cells)
    return made


def _remarks(found: ModeFit | ResponseFit) -> list[str]:
    """Return lines about properties that the data do not determine."""
    lines = []
    for group in found.inseparable:
        fault = "cannot be told apart by these data; fix all but one" if len(group) > 1 else "has no influence here"
        lines.append(f"{' and '.join(group)}: {fault}")
    for group in found.mirrored:
        lines.append(f"{' and '.join(group)}: may change places; give them different ranges, or measure off the middle")
    for key, limited in zip(found.keys, found.at_limit, strict=True):
        if limited:
            lines.append(f"{key}: is at an end of its range, so its interval is not valid; widen the range")
    for first, second in np.argwhere(np.triu(np.abs(found.correlations) > STRONG, 1)):
        value = found.correlations[first, second]
        lines.append(f"{found.keys[first]} and {found.keys[second]}: their errors are correlated by {value:+.3f}")
    return lines
