"""``warp-plate modes SCENE``: natural frequencies, damping and mode shapes of the plate, or of its grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from cyclopts import Parameter

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.plate.modes import NaturalModes
    from warp_plate.scene.model import Scene

ENDINGS = (".png", ".svg", ".pdf")
# Significant digits of frequencies without a grid; motions of masses below STILL are zero.
DIGITS, STILL = 6, 1e-9


@Parameter(name="*")
@dataclass(frozen=True)
class ModeOptions:
    """Options of the modes.

    Attributes:
        count: Number of modes, from the lowest.
        grid: Show the modes of the scene's grid, at which time-stepped runs ring, and their errors.
        accuracy: With --grid: largest relative error of localization factors; the program chooses the cheapest grid.
    """

    count: options.PositiveInteger = 6
    grid: bool = False
    accuracy: str | None = None


def modes(
    scene: options.SceneName,
    /,
    *,
    assignments: options.Assignments = None,
    shown: ModeOptions = ModeOptions(),
    out: Path | None = None,
    pictures: options.Pictures = True,
    colormap: options.Colormap = None,
    json: options.Json = False,
) -> None:
    """Show the natural frequencies, damping and shapes of a plate, with its edges and its linear effects.

    Parameters
    ----------
    out
        The picture of the shapes with their nodal lines (.png, .svg or .pdf; default: SCENE-modes.png in this folder).
    """
    target = output.output_file(out, f"{Path(scene).stem}-modes.png", ENDINGS)
    if shown.accuracy is not None and not shown.grid:
        raise SceneError("--accuracy: chooses a grid; add --grid")
    loaded, scene = output.load_scene(scene, assignments, shown.accuracy)
    from warp_plate.modal.continuous_modes import continuous_modes

    errors, left_out = None, _left_out(loaded, shown.grid)
    with output.scene_errors(scene):
        natural = exact = continuous_modes(loaded, shown.count)
        if shown.grid:
            loaded, natural = _grid_modes(loaded, shown.count)
            exact_frequencies = exact.frequencies[: len(natural.frequencies)]
            moving = np.where(exact_frequencies > 0, exact_frequencies, math.nan)
            errors = natural.frequencies / moving - 1
    written = _draw(loaded, natural, target, options.ColourChoice(colormap)) if pictures else ([], None)
    output.report(json, _as_json, _print, scene, loaded, natural, errors, left_out, written=written)


def _grid_modes(scene: Scene, count: int) -> tuple[Scene, NaturalModes]:
    """Return the scene with its grid, without effects that cannot be stepped, and the modes of the grid."""
    from warp_plate.plate.modes import natural_modes, refuse_many_nodes
    from warp_plate.resolve import resolve

    effects = scene.effects.keeping(lambda effect: effect.stepped)
    gridded = resolve(scene.model_copy(update={"effects": effects}), purpose="simulate", evaluator="direct").scene
    refuse_many_nodes(gridded)
    return gridded, natural_modes(gridded, count)


def _draw(scene: Scene, natural: NaturalModes, path: Path, colours: options.ColourChoice) -> output.Drawn:
    from warp_plate.viz.plots.modes import draw_modes

    draw = partial(draw_modes, scene, natural.frequencies, natural.shapes, colours=colours.chosen())
    return output.draw_plot(draw, path)


def _left_out(scene: Scene, grid: bool) -> list[str]:
    """Return the effects of the scene that these modes leave out."""
    left_out = scene.effects.damping_names(scene.plate) if grid else []
    left_out += [name.replace("_", " ") for name in scene.effects.keeping(lambda effect: not effect.linear).names]
    return [*left_out, "electrostatic force"] if scene.drive.electrostatic is not None else left_out


def _as_json(
    name: str, scene: Scene, natural: NaturalModes, errors: np.ndarray | None, left_out: list[str]
) -> dict[str, object]:
    record = {"scene": name, "half_waves": natural.half_waves(), "left_out": left_out}
    record |= output.attributes(natural, "frequencies", "oscillators")
    if errors is not None:
        record |= output.attributes(scene.grid, "nodes", "order")
        return record | {"time_step": natural.time_step, "frequencies_stepped": natural.stepped, "errors": errors}
    assert natural.loss_factors is not None
    return record | {"damping_ratios": natural.loss_factors / 2, "loss_factors": natural.loss_factors}


def _print(
    name: str, scene: Scene, natural: NaturalModes, errors: np.ndarray | None, left_out: list[str], console: Console
) -> None:
    from warp_plate.effects.effect import attachments
    from warp_plate.plate.signals import highest_frequency

    nx, ny = scene.grid.nodes
    grid = "" if errors is None else f": {nx} × {ny} nodes, order {scene.grid.order}"
    console.print(f"{scene.title or name}{grid}\n")
    masses = [index for index, attached in enumerate(attachments(scene.terms)) if attached.mass > 0]
    columns = _columns(natural, errors)
    table = output.table("mode", *columns, "lobes x × y", *(f"mass {index}" for index in masses))
    rows = zip(zip(*columns.values(), strict=True), natural.half_waves(), natural.oscillators, strict=True)
    for number, (cells, waves, motion) in enumerate(rows, start=1):
        table.add_row(
            str(number),
            *cells,
            "mixed" if waves is None else f"{waves[0]} × {waves[1]}",
            *(f"{motion[index] if abs(motion[index]) > STILL else 0:.3g}" for index in masses),
        )
    console.print(table)
    console.print(
        ("" if errors is None else f"\nIn a run: frequencies of time steps of {natural.time_step:.3g} s.")
        + "\nLobes: half-waves along x and y."
        + (" Mass: displacement of the oscillator relative to the largest of the plate." if masses else "")
    )
    highest, count = highest_frequency(scene), natural.frequencies.size
    if errors is None and natural.frequencies[-1] < highest:
        console.print(f"The plate is driven at up to {highest:g} Hz, above these; --count {2 * count} shows more.")
    if left_out:
        console.print(f"Not included in natural modes: {', '.join(left_out)}.")


def _columns(natural: NaturalModes, errors: np.ndarray | None) -> dict[str, list[str]]:
    """Return the texts of the columns of numbers by their headings."""
    moving = natural.frequencies > 0
    if errors is not None:
        return {
            "frequency (Hz)": [f"{value:.2f}" if value else "0 (rigid)" for value in natural.frequencies],
            "error (%)": [f"{100 * error:.2g}" if moves else "" for error, moves in zip(errors, moving, strict=True)],
            "in a run (Hz)": [f"{value:.2f}" for value in natural.stepped],
        }
    assert natural.loss_factors is not None
    damping = list(zip(natural.loss_factors, moving, strict=True))
    return {
        "frequency (Hz)": [_digits(value) if value else "0 (rigid)" for value in natural.frequencies],
        "damping ratio": [f"{factor / 2:.4g}" if moves else "" for factor, moves in damping],
        "loss factor": [f"{factor:.4g}" if moves else "" for factor, moves in damping],
    }


def _digits(value: float) -> str:
    """Return a number with DIGITS significant digits and no exponent."""
    return f"{value:.{max(0, DIGITS - 1 - math.floor(math.log10(value)))}f}"
