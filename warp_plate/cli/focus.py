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
    from warp_plate.viz.colours import ColourOptions

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
    force: options.Force = False,
    pictures: options.Pictures = True,
    colours: options.ColourChoice = options.DEFAULT_COLOURS,
    json: options.Json = False,
) -> None:
    """Compute a waveform for each actuator, so that the plate moves most at a point and a moment.

    The scene's table [focus] has the points, the moment and the limits of the waveforms; see docs/focusing.md. Methods
    are time reversal, one-bit time reversal, the inverse filter, which keeps the other points still, and the optimum of
    all waveforms within the limits. With [focus.burst] each point follows a burst.

    Parameters
    ----------
    waveforms
        File of focus with waveforms made for another panel, which are played on this one: shows how a finger or another
        damping changes the focus.
    out
        The .h5 file with waveforms, responses and fields (default: SCENE-focus.h5 in this folder).
    """
    chosen = colours.chosen()
    target = output.output_file(out, f"{Path(scene).stem}-focus.h5", holds=HOLDS, force=force)
    loaded, scene = output.load_scene(scene, assignments)
    from warp_plate.focusing.focus import focus as compute
    from warp_plate.result.focus import load_focus, save_focus

    played = None if waveforms is None else load_focus(waveforms)
    with output.scene_errors(scene):
        found = compute(loaded, played)
    files, missing = [save_focus(found, target)], None
    if pictures:
        drawn, missing = _draw(found, target.with_suffix(".png"), chosen)
        files += drawn
    output.report(json, partial(_as_json, found), partial(_print, scene, found), (files, missing))


def _draw(found: FocusResult, path: Path, colours: ColourOptions) -> output.Drawn:
    from warp_plate.result.atomic_io import atomic_paths
    from warp_plate.viz.availability import missing_plots
    from warp_plate.viz.plots.focus import draw_focus

    if (problem := missing_plots()) is not None:
        return [], problem
    with atomic_paths(path) as (temporary,):
        draw_focus(found, temporary, colours)
    return [path], None


def _as_json(found: FocusResult) -> dict[str, object]:
    assert found.scene.focus is not None
    return {
        **output.attributes(found.scene.focus, "points", "quantity", "time", "rate", "lowest", "highest"),
        **output.attributes(found, "unit", "modes", "bound", "seconds"),
        "methods": {name: output.attributes(method, *FIGURES) for name, method in found.methods.items()},
    }


def _print(name: str, found: FocusResult, console: Console) -> None:
    table = found.scene.focus
    assert table is not None
    console.print(
        f"{found.scene.title or name}: {table.quantity} at {1e3 * table.time:g} ms, {len(found.scene.actuators)} "
        f"waveforms of {table.samples} samples, {found.modes} modes up to {table.highest:g} Hz\n"
    )
    for index, (x, y) in enumerate(table.points):
        made = output.table(
            f"at {x:g},{y:g}", f"peak ({found.unit})", "area (mm²)", "contrast (dB)", "energy", "gap", "limited by"
        )
        for method, reached in found.methods.items():
            made.add_row(
                method.replace("_", " "),
                f"{reached.peak[index]:.4g}",
                f"{1e6 * reached.focus_area[index]:.4g}",
                f"{reached.contrast_db[index]:.1f}",
                f"{reached.energy[index]:.4g}",
                f"{max(reached.gap[index], 0):.2g}",
                reached.limits[index],
            )
        output.print_uncropped(console, made)
        console.print()
    console.print(
        f"Energy in ({found.scene.drive_unit})²·s. Gap: relative distance of the peak from the bound for all waveforms."
    )
    others = ~np.eye(len(table.points), dtype=bool)
    for method, reached in found.methods.items():
        remarks = [f"crosstalk at most {reached.crosstalk_db[others].max():.1f} dB"] if others.any() else []
        if reached.misfit is not None:
            remarks.append(f"bursts followed within {100 * reached.misfit.max():.2g} %")
        if reached.electrical_energy is not None:
            remarks.append(f"electrical energy at most {reached.electrical_energy.max():.3g} J")
        if remarks:
            console.print(f"{method.replace('_', ' ')}: {', '.join(remarks)}")
