"""``warp-plate modes SCENE``: natural frequencies and shapes of the plate as the kernels have it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import cyclopts

from warp_plate.cli import output
from warp_plate.cli.options import Whole
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.plate.modes import NaturalModes
    from warp_plate.scene.model import Scene

ENDINGS = (".png", ".svg", ".pdf")


def modes(
    scene: str,
    /,
    *,
    count: Whole = 6,
    accuracy: str | None = None,
    out: Path | None = None,
    pictures: bool = True,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Show the natural frequencies and shapes of a plate, with its edges and its linear effects.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file.
    count
        How many modes, from the lowest.
    accuracy
        Such as 1% or 0.01: take the grid that keeps localization factors to it, instead of the scene's.
    out
        The picture of the shapes (.png, .svg or .pdf); SCENE-modes.png in this folder when left out.
    pictures
        Draw the shapes with their nodal lines (needs the extra viz).
    json
        Print one JSON object instead of a table.
    """
    target = output.output_file(out, scene, "modes", ENDINGS)
    if count < 1:
        raise SceneError(f"--count {count}: must be at least 1")
    loaded = _with_grid(output.load_scene(scene, accuracy))
    from warp_plate.plate.modes import natural_modes, refuse_many_nodes

    try:
        refuse_many_nodes(loaded)
    except SceneError as error:
        raise SceneError(f"{scene}: {error}") from None
    found = natural_modes(loaded, count)
    files, missing = _draw(loaded, found, target) if pictures else ([], None)
    if json:
        output.print_json(_record(scene, loaded, found, files))
        return
    _print(scene, loaded, found)
    output.print_files(files, missing)


def _with_grid(scene: Scene) -> Scene:
    """The scene with the grid that its accuracy asks for, if it does."""
    if scene.grid.accuracy is None:
        return scene
    from warp_plate.studies.localize import resolve

    return resolve(scene, "auto")[0]


def _draw(scene: Scene, found: NaturalModes, path: Path) -> tuple[list[Path], str | None]:
    """The files written, and None or why none was."""
    from warp_plate.result.atomic_io import atomic_path
    from warp_plate.viz.availability import missing_plots
    from warp_plate.viz.plots.modes import draw_modes

    problem = missing_plots()
    if problem is not None:
        return [], problem
    try:
        with atomic_path(path) as temporary:
            draw_modes(scene, found.frequencies, found.shapes, temporary)
        return [path], None
    except OSError as error:
        return [], f"{path}: cannot be written: {error}"


def _left_out(scene: Scene) -> list[str]:
    """Effects that the scene names and natural modes know nothing of."""
    effects = scene.effects
    lossy = {
        "damping": effects.damping is not None,
        "material damping": effects.material_damping is not None,
        "damping of the foundation": effects.foundation is not None and effects.foundation.damping > 0,
        "damping of oscillators": any(one.damping > 0 for one in effects.oscillators),
        "stretching": effects.stretching is not None,
    }
    return [name for name, named in lossy.items() if named]


def _record(name: str, scene: Scene, found: NaturalModes, files: list[Path]) -> dict[str, object]:
    return {
        "scene": name,
        "nodes": list(scene.grid.nodes),
        "order": scene.grid.order,
        "frequencies": found.frequencies.tolist(),
        "frequencies_stepped": found.stepped.tolist(),
        "time_step": found.time_step,
        "half_waves": [None if pair is None else list(pair) for pair in found.half_waves()],
        "oscillators": found.oscillators.tolist(),
        "left_out": _left_out(scene),
        "files": [str(file) for file in files],
    }


def _print(name: str, scene: Scene, found: NaturalModes) -> None:
    console = output.console()
    nx, ny = scene.grid.nodes
    console.print(f"{scene.title or name}: {nx} × {ny} nodes, order {scene.grid.order}\n")
    hung = [index for index, one in enumerate(scene.effects.oscillators) if one.mass > 0]
    made = output.table(
        "mode", "frequency (Hz)", "in a run (Hz)", "waves x × y", *(f"mass {index}" for index in hung)
    )
    rows = zip(found.frequencies, found.stepped, found.half_waves(), found.oscillators, strict=True)
    for number, (frequency, stepped, waves, motion) in enumerate(rows, start=1):
        made.add_row(
            str(number),
            f"{frequency:.2f}" if frequency else "0 (rigid)",
            f"{stepped:.2f}",
            "mixed" if waves is None else f"{waves[0]} × {waves[1]}",
            *(f"{motion[index]:.3g}" for index in hung),
        )
    console.print(made)
    console.print(
        f"\nIn a run: with steps of {found.time_step:.3g} s. Waves: half-waves, stretches of one sign along x and y."
        + (" Mass: motion of the oscillator's, the plate's largest being 1." if hung else "")
    )
    left_out = _left_out(scene)
    if left_out:
        console.print(f"Not in natural modes: {', '.join(left_out)}.")
