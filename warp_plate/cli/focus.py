"""``warp-plate focus SCENE``: waveforms of all actuators that focus motion at points of the plate."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.cli.measured import answers_measured

if TYPE_CHECKING:
    from warp_plate.result.focus import FocusResult

FIGURES: tuple[str, ...] = ("peak", "focus_area", "contrast_db", "energy", "gap", "limits")
FIGURES += ("crosstalk_db", "misfit", "electrical_energy")


def focus(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    waveforms: Path | None = None,
    files: options.FileOptions = options.FileOptions(),
    colours: options.ColourChoice = options.ColourChoice(),
) -> None:
    """Compute a waveform for each actuator, so that the plate moves most at a point and a moment.

    The scene's table [focus] has the points, the moment and the limits of the waveforms; see docs/focusing.md. Methods
    are time reversal, one-bit time reversal, the inverse filter, which keeps the other points still, and the optimum of
    all waveforms within the limits. With [focus.burst] each point follows a burst, with [focus.wish] the waveform of a
    file. With [search.robust] an inverse filter is made for many panels within tolerances.

    A scene with [measured] in place of [plate] is answered from its measured responses, as by measured.

    Parameters
    ----------
    waveforms
        File of focus with waveforms made for another panel, which are played on this one: shows how a finger or another
        damping changes the focus.
    """
    if answers_measured(scene, "focus", changes, files, colours):
        return
    from warp_plate.focusing.focus import focus as compute
    from warp_plate.result.focus import load_focus, save_focus
    from warp_plate.viz.plots.frame import save_plots
    from warp_plate.viz.plots.responses import draw_focus

    chosen = colours.chosen()
    target = files.target(scene, "-focus.h5", holds="a focus")
    loaded, scene = changes.load(scene)
    played = None if waveforms is None else load_focus(waveforms)
    with output.scene_errors(scene):
        result = compute(loaded, played)
    draw = partial(save_plots, partial(draw_focus, result, colours=chosen), target, [".png"])
    write = partial(output.write_files, {target: partial(save_focus, result)}, draw if files.pictures else None)
    output.report(files.json, _as_json, _print, scene, result, write=write)


def _as_json(name: str, result: FocusResult) -> dict[str, object]:
    assert result.scene.focus is not None
    return {
        **output.attributes(result.scene.focus, "points", "quantity", "time", "rate", "lowest", "highest"),
        **output.attributes(result, "unit", "modes", "bound", "condition", "half_wave", "seconds", "warnings"),
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
        rows = []
        for method, reached in result.methods.items():
            numbers = (reached.peak, 1e6 * reached.focus_area, reached.contrast_db, reached.energy, reached.gap.clip(0))
            digits = (".4g", ".4g", ".1f", ".4g", ".2g")
            cells = [output.number_text(of[index], form) for of, form in zip(numbers, digits, strict=True)]
            rows.append([method.replace("_", " "), *cells, reached.limits[index]])
        headings = (f"at {x:g},{y:g}", f"peak ({result.unit})", "area (mm²)", "contrast (dB)", "energy", "gap")
        output.print_rows(console, (*headings, "limited by"), rows, "")
    console.print(
        f"Energy in ({result.scene.drive_unit})²·s. Gap: relative distance of the peak from the bound of all waveforms."
    )
    for line in result.warnings:
        console.print(line)
