"""``warp-plate focus SCENE``: waveforms of all actuators that focus motion at points of the plate."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.cli import options, output

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.focus import FocusResult

FIGURES = (
    "peak",
    "focus_area",
    "contrast_db",
    "energy",
    "gap",
    "limits",
    "crosstalk_db",
    "misfit",
    "electrical_energy",
)
HOLDS = "a focus"


def focus(
    scene: options.SceneName,
    /,
    *,
    assignments: options.Assignments = None,
    waveforms: Path | None = None,
    out: Path | None = None,
    files: options.FileOptions = options.FileOptions(),
    colours: options.ColourChoice = options.ColourChoice(),
) -> None:
    """Compute a waveform for each actuator, so that the plate moves most at a point and a moment.

    The scene's table [focus] has the points, the moment and the limits of the waveforms; see docs/focusing.md. Methods
    are time reversal, one-bit time reversal, the inverse filter, which keeps the other points still, and the optimum of
    all waveforms within the limits. With [focus.burst] each point follows a burst, with [focus.wish] the waveform of a
    file. With [search.robust] an inverse filter is made for many panels within tolerances.

    Parameters
    ----------
    waveforms
        File of focus with waveforms made for another panel, which are played on this one: shows how a finger or another
        damping changes the focus.
    out
        The .h5 file with waveforms, responses and fields (default: SCENE-focus.h5 in this folder).
    """
    chosen = colours.chosen()
    target = output.output_file(out, f"{Path(scene).stem}-focus.h5", holds=HOLDS, force=files.force)
    loaded, scene = output.load_scene(scene, assignments)
    from warp_plate.focusing.focus import focus as compute
    from warp_plate.result.focus import load_focus, save_focus

    played = None if waveforms is None else load_focus(waveforms)
    with output.scene_errors(scene):
        result = compute(loaded, played)
    from warp_plate.viz.plots.waveforms import draw_focus

    written = [save_focus(result, target)]
    draw = partial(draw_focus, result, colours=chosen)
    drawn, missing = output.draw_plot(draw, target.with_suffix(".png"), files.pictures)
    output.report(files.json, _as_json, _print, scene, result, written=([*written, *drawn], missing))


def _as_json(name: str, result: FocusResult) -> dict[str, object]:
    assert result.scene.focus is not None
    return {
        **output.attributes(result.scene.focus, "points", "quantity", "time", "rate", "lowest", "highest"),
        **output.attributes(result, "unit", "modes", "bound", "condition", "half_wave", "seconds"),
        "methods": {method: _method_as_json(result, method) for method in result.methods},
    }


def _method_as_json(result: FocusResult, name: str) -> dict[str, object]:
    method = result.methods[name]
    record = {**output.attributes(method, *FIGURES), "resolution": result.resolution(name).tolist()}
    if method.panels is not None:
        record["panels"] = method.panels.summary()
    return record


def _print(name: str, result: FocusResult, console: Console) -> None:
    wish = result.scene.focus
    assert wish is not None
    samples = next(iter(result.methods.values())).waveforms.shape[-1]
    moment = f"at {1e3 * wish.time:g} ms" if result.wished is None else "that follows focus.wish"
    console.print(
        f"{result.scene.title or name}: {wish.quantity} {moment}, {len(result.scene.actuators)} "
        f"waveforms of {samples} samples, {result.modes} modes up to {wish.highest:g} Hz\n"
    )
    for index, (x, y) in enumerate(wish.points):
        table = output.table(
            f"at {x:g},{y:g}", f"peak ({result.unit})", "area (mm²)", "contrast (dB)", "energy", "gap", "limited by"
        )
        for method, reached in result.methods.items():
            table.add_row(
                method.replace("_", " "),
                f"{reached.peak[index]:.4g}",
                f"{1e6 * reached.focus_area[index]:.4g}",
                f"{reached.contrast_db[index]:.1f}",
                f"{reached.energy[index]:.4g}",
                f"{max(reached.gap[index], 0):.2g}",
                reached.limits[index],
            )
        output.print_uncropped(console, table, "")
    console.print(
        f"Energy in ({result.scene.drive_unit})²·s. Gap: relative distance of the peak from the bound of all waveforms."
    )
    for method in result.methods:
        if remarks := _remarks(result, method):
            console.print(f"{method.replace('_', ' ')}: {', '.join(remarks)}")


def _remarks(result: FocusResult, name: str) -> list[str]:
    """Return what a line says of a method, for all foci together."""
    from warp_plate.accuracy.configurations import percent

    method, others, remarks = result.methods[name], ~np.eye(len(result.bound), dtype=bool), []
    wish = "burst" if result.wished is None else "wish"
    if others.any():
        remarks.append(f"crosstalk at most {method.crosstalk_db[others].max():.1f} dB")
    if method.misfit is not None:
        remarks.append(f"{wish} followed within {percent(method.misfit.max())}")
    if method.electrical_energy is not None:
        remarks.append(f"electrical energy at most {method.electrical_energy.max():.3g} J")
    if (panels := method.panels) is not None:
        worst = [f"{panels.crosstalk_db.max():.1f} dB"] if others.any() else []
        worst += [] if panels.misfit is None else [percent(panels.misfit.max())]
        least = np.abs(panels.peak).min()
        worst.append(f"peak at least {least:.3g} {result.unit}")
        remarks.append(f"on {len(panels.peak)} panels {', '.join(worst)}")
    return remarks
