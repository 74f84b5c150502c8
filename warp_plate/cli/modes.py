"""``warp-plate modes SCENE``: natural frequencies, damping and mode shapes of the plate."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from rich.console import Console

from warp_plate.cli import options, output, postpone_garbage

if TYPE_CHECKING:
    import numpy as np

    from warp_plate.modal.continuous_modes import NaturalModes
    from warp_plate.scene.model import Scene

ENDINGS, RIGID = (".png", ".svg", ".pdf"), "0 (rigid)"
# Motions of masses below this are zero.
STILL = 1e-9
# Most masses with a column in the printed table.
MOST_MASSES = 8


def modes(
    scene: options.SceneName,
    /,
    *,
    count: options.PositiveInteger = 6,
    changes: options.SceneChanges = options.SceneChanges(),
    files: options.FileOptions = options.FileOptions(),
    colormap: options.Colormap = None,
) -> None:
    """Show the natural frequencies, damping and shapes of a plate, with its edges and its linear effects.

    A picture (.png, .svg or .pdf) shows the shapes with their nodal lines.

    Parameters
    ----------
    count
        Number of modes, from the lowest.
    """
    from warp_plate.modal.continuous_modes import continuous_modes, linear_part
    from warp_plate.modal.modes import errors_of_frequencies

    target = files.target(scene, "-modes.png", endings=ENDINGS)
    loaded, scene = changes.load(scene)
    left_out = [name.replace("_", " ") for name in loaded.effects.keeping(lambda effect: not effect.linear).names]
    left_out += ["electrostatic force"] * (loaded.drive.electrostatic is not None)
    with output.scene_errors(scene):
        natural = continuous_modes(loaded, count)
    errors = errors_of_frequencies(linear_part(loaded), natural.frequencies)

    def write() -> output.Drawn:
        if not files.pictures:
            return [], None
        postpone_garbage()
        from warp_plate.viz.plots.frame import save_plots
        from warp_plate.viz.plots.modes import draw_modes

        colours = options.ColourChoice(colormap).chosen()
        draw = partial(draw_modes, loaded, natural.frequencies, natural.shapes, colours=colours)
        return files.check_drawn(target, save_plots(draw, target, [target.suffix]))

    output.report(files.json, _as_json, _print, scene, loaded, natural, errors, left_out, write=write)


def _as_json(
    name: str, scene: Scene, natural: NaturalModes, errors: np.ndarray, left_out: list[str]
) -> dict[str, object]:
    record = {"scene": name, "errors": errors, "half_waves": natural.half_waves(), "left_out": left_out}
    record |= output.attributes(natural, "frequencies", "oscillators")
    assert natural.loss_factors is not None
    return record | {"damping_ratios": natural.loss_factors / 2, "loss_factors": natural.loss_factors}


def _print(
    name: str, scene: Scene, natural: NaturalModes, errors: np.ndarray, left_out: list[str], console: Console
) -> None:
    import numpy as np

    from warp_plate.effects.effect import attachments
    from warp_plate.plate.signals import highest_frequency

    assert natural.loss_factors is not None
    console.print(f"{scene.title or name}\n")
    masses = [index for index, attached in enumerate(attachments(scene.terms)) if attached.mass > 0]
    masses = masses if len(masses) <= MOST_MASSES else []
    columns, rows = (natural.frequencies, errors, natural.loss_factors, natural.half_waves(), natural.oscillators), []
    for number, (frequency, error, factor, waves, motion) in enumerate(zip(*columns, strict=True), 1):
        numbers = [RIGID, "", "", ""]
        if frequency:
            bar = f"{100 * error:.2g}" if math.isfinite(error) else "unknown"
            numbers = [f"{frequency:.6g}", bar, f"{factor / 2:.4g}", f"{factor:.4g}"]
        rows.append(
            [
                str(number),
                *numbers,
                "mixed" if waves is None else f"{waves[0]} × {waves[1]}",
                *(f"{motion[mass] if abs(motion[mass]) > STILL else 0:.3g}" for mass in masses),
            ]
        )
    headings = ["mode", "frequency (Hz)", "error (%)", "damping ratio", "loss factor", "lobes x × y"]
    output.print_rows(console, [*headings, *(f"mass {index}" for index in masses)], rows)
    console.print(
        "\nLobes: half-waves along x and y."
        + (" Mass: displacement of the oscillator relative to the largest of the plate." if masses else "")
    )
    if not np.isfinite(errors).all():
        console.print("Errors are unknown: they take 1.4 times as many functions along each side, which are too many.")
    highest, count = highest_frequency(scene), natural.frequencies.size
    if natural.frequencies[-1] < highest:
        console.print(f"The plate is driven at up to {highest:g} Hz, above these; --count {2 * count} shows more.")
    if left_out:
        console.print(f"Not included in natural modes: {', '.join(left_out)}.")
