"""``warp-plate modes SCENE``: natural frequencies and mode shapes of the discretised plate."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.plate.modes import NaturalModes
    from warp_plate.scene.model import Scene

ENDINGS = (".png", ".svg", ".pdf")


def modes(
    scene: options.SceneName,
    /,
    *,
    count: options.Count = 6,
    accuracy: options.Accuracy | None = None,
    out: Path | None = None,
    pictures: options.Pictures = True,
    json: options.Json = False,
) -> None:
    """Show the natural frequencies and mode shapes of a plate, with its edges and its linear effects.

    Parameters
    ----------
    count
        Number of modes, from the lowest.
    out
        The picture of the shapes with their nodal lines (.png, .svg or .pdf; default: SCENE-modes.png in this folder).
    """
    target = output.output_file(out, f"{Path(scene).stem}-modes.png", ENDINGS)
    loaded = output.load_scene(scene, accuracy)
    from warp_plate.plate.modes import natural_modes, refuse_many_nodes
    from warp_plate.studies.grid_choice import resolve_grid

    with output.scene_errors(scene):
        loaded = resolve_grid(loaded, "auto").scene
        refuse_many_nodes(loaded)
        found = natural_modes(loaded, count)
    written = _draw(loaded, found, target) if pictures else ([], None)
    record, show = partial(_as_json, scene, loaded, found), partial(_print, scene, loaded, found)
    output.report(json, record, show, written)


def _draw(scene: Scene, found: NaturalModes, path: Path) -> output.Drawn:
    """Draw the mode shapes; return the files written, or why there are none."""
    from warp_plate.result.atomic_io import atomic_paths
    from warp_plate.viz.availability import missing_plots
    from warp_plate.viz.plots.modes import draw_modes

    if (problem := missing_plots()) is not None:
        return [], problem
    try:
        with atomic_paths(path) as (temporary,):
            draw_modes(scene, found.frequencies, found.shapes, temporary)
    except SceneError as error:
        return [], str(error)
    return [path], None


def _left_out(scene: Scene) -> list[str]:
    """Return the effects of the scene that natural modes leave out."""
    effects = scene.effects
    present = {
        "damping": effects.damping is not None,
        "material damping": effects.material_damping is not None,
        "loss factor": effects.loss_factor is not None,
        "modal damping": effects.modal_damping is not None,
        "damping of the foundation": effects.foundation is not None and effects.foundation.damping > 0,
        "damping of oscillators": any(oscillator.damping > 0 for oscillator in effects.oscillators),
        "stretching": effects.stretching is not None,
    }
    return [name for name, active in present.items() if active]


def _as_json(name: str, scene: Scene, found: NaturalModes) -> dict[str, object]:
    return {
        "scene": name,
        **output.attributes(scene.grid, "nodes", "order"),
        **output.attributes(found, "frequencies", "time_step", "oscillators"),
        "frequencies_stepped": found.stepped,
        "half_waves": found.half_waves(),
        "left_out": _left_out(scene),
    }


def _print(name: str, scene: Scene, found: NaturalModes, console: Console) -> None:
    nx, ny = scene.grid.nodes
    console.print(f"{scene.title or name}: {nx} × {ny} nodes, order {scene.grid.order}\n")
    masses = [index for index, oscillator in enumerate(scene.effects.oscillators) if oscillator.mass > 0]
    made = output.table(
        "mode", "frequency (Hz)", "in a run (Hz)", "waves x × y", *(f"mass {index}" for index in masses)
    )
    rows = zip(found.frequencies, found.stepped, found.half_waves(), found.oscillators, strict=True)
    for number, (frequency, stepped, waves, motion) in enumerate(rows, start=1):
        made.add_row(
            str(number),
            f"{frequency:.2f}" if frequency else "0 (rigid)",
            f"{stepped:.2f}",
            "mixed" if waves is None else f"{waves[0]} × {waves[1]}",
            *(f"{motion[index]:.3g}" for index in masses),
        )
    console.print(made)
    console.print(
        f"\nIn a run: with steps of {found.time_step:.3g} s. Waves: half-waves, stretches of one sign along x and y."
        + (" Mass: displacement of the oscillator relative to the largest of the plate." if masses else "")
    )
    if left_out := _left_out(scene):
        console.print(f"Not included in natural modes: {', '.join(left_out)}.")
