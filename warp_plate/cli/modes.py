"""``warp-plate modes SCENE``: natural frequencies, damping and mode shapes of the plate, or of its grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    import numpy as np

    from warp_plate.plate.modes import NaturalModes
    from warp_plate.scene.model import Scene

ENDINGS, RIGID, GRID_HEADINGS = (".png", ".svg", ".pdf"), "0 (rigid)", ("error (%)", "in a run (Hz)")
# Motions of masses below this are zero.
STILL = 1e-9


@Parameter(name="*")
@dataclass(frozen=True)
class ModeOptions:
    """Options of the modes.

    Attributes:
        count: Number of modes, from the lowest.
        grid: Show the modes of the scene's grid, at which time-stepped runs ring, and their errors.
    """

    count: options.PositiveInteger = 6
    grid: options.Switch = False


def modes(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneOptions = options.SceneOptions(),
    shown: ModeOptions = ModeOptions(),
    files: options.FileOptions = options.FileOptions(),
    colormap: options.Colormap = None,
) -> None:
    """Show the natural frequencies, damping and shapes of a plate, with its edges and its linear effects.

    A picture (.png, .svg or .pdf) shows the shapes with their nodal lines.
    """
    from warp_plate.modal.continuous_modes import continuous_modes

    target = files.target(scene, "-modes.png", endings=ENDINGS)
    if changes.accuracy is not None and not shown.grid:
        raise SceneError("--accuracy: chooses a grid; add --grid")
    loaded, scene = changes.load(scene)
    errors, left_out = None, _left_out(loaded, shown.grid)
    with output.scene_errors(scene):
        natural = exact = continuous_modes(loaded, shown.count)
        if shown.grid:
            loaded, natural = _grid_modes(loaded, shown.count)
            moving = exact.frequencies[: len(natural.frequencies)].copy()
            moving[moving == 0] = math.nan
            errors = natural.frequencies / moving - 1
    written: output.Drawn = [], None
    if files.pictures:
        from warp_plate.viz.plots.frame import save_plots
        from warp_plate.viz.plots.modes import draw_modes

        colours = options.ColourChoice(colormap).chosen()
        draw = partial(draw_modes, loaded, natural.frequencies, natural.shapes, colours=colours)
        written = save_plots(draw, target, [target.suffix])
    output.report(files.json, _as_json, _print, scene, loaded, natural, errors, left_out, written=written)


def _grid_modes(scene: Scene, count: int) -> tuple[Scene, NaturalModes]:
    """Return the scene with its grid, without effects that cannot be stepped, and the modes of the grid."""
    from warp_plate.plate.modes import natural_modes
    from warp_plate.resolve import resolve

    effects = scene.effects.keeping(lambda effect: effect.stepped)
    gridded = resolve(scene.model_copy(update={"effects": effects}), purpose="simulate", evaluator="direct").scene
    return gridded, natural_modes(gridded, count)


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
    rows = []
    for index, waves in enumerate(natural.half_waves()):
        motion = natural.oscillators[index]
        rows.append(
            [
                str(index + 1),
                *_numbers(natural, errors, index),
                "mixed" if waves is None else f"{waves[0]} × {waves[1]}",
                *(f"{motion[mass] if abs(motion[mass]) > STILL else 0:.3g}" for mass in masses),
            ]
        )
    headings = ["mode", "frequency (Hz)", *(("damping ratio", "loss factor") if errors is None else GRID_HEADINGS)]
    output.print_rows(console, [*headings, "lobes x × y", *(f"mass {index}" for index in masses)], rows)
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


def _numbers(natural: NaturalModes, errors: np.ndarray | None, index: int) -> list[str]:
    """Return the frequency of a mode, with its error and that in a run on a grid, else its damping."""
    frequency = natural.frequencies[index]
    if errors is not None:
        error = f"{100 * errors[index]:.2g}" if frequency else ""
        return [f"{frequency:.2f}" if frequency else RIGID, error, f"{natural.stepped[index]:.2f}"]
    assert natural.loss_factors is not None
    factor = natural.loss_factors[index]
    return [f"{frequency:.6g}", f"{factor / 2:.4g}", f"{factor:.4g}"] if frequency else [RIGID, "", ""]
