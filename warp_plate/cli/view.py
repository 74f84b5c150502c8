"""``warp-plate view RESULT``: a window that shows the plates of a result in motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cyclopts

from warp_plate.cli.moving import Choice, Field, check_looks, chosen_motions, playing_rate
from warp_plate.scene.errors import SceneError


def view(
    result: Path,
    /,
    *,
    field: Field = "displacement",
    case: Annotated[list[str] | None, cyclopts.Parameter(negative="")] = None,
    modes: int = 0,
    start: float | None = None,
    end: float | None = None,
    frames: int | None = None,
    rate: float | None = None,
    heights: float | None = None,
    device: str = "auto",
) -> None:
    """Show the plates of a result in motion, in a window; the key h lists what its keys do.

    A result keeps few displacements, so its scene is run once more under its drives for the frames.

    Parameters
    ----------
    result
        An .h5 file that localize or simulate wrote.
    field
        In colour: displacement, velocity, energy (kinetic energy density), rms-velocity or phase; heights are
        displacements always.
    case
        equal, single, best or drive; give it again for more. All, side by side, when left out.
    modes
        Show the first so many natural shapes instead, 6 at most.
    start
        Of the frames, in seconds; when both this and --end are left out, the last period of the drive, or of a drive
        that does not repeat the first burst, else the scene's window.
    end
        Of the frames, in seconds; the end of the run when only --start is there.
    frames
        How many; 60 a period, or as many as there are steps, and 600 at most, when left out.
    rate
        Frames a second at first; 30, or what plays a period in 1.4 s, when left out.
    heights
        How many times displacements are exaggerated at first.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.
    """
    check_looks(rate, heights)
    from warp_plate.result import load_result
    from warp_plate.viz.availability import missing_window

    loaded = load_result(result)
    if (problem := missing_window()) is not None:
        raise SceneError(
            f"no window can be opened: {problem}; write pictures, movies or a page with 'warp-plate render {result}'"
            ", or look in a browser with 'warp-plate explore SCENE'"
        )
    motions = chosen_motions(loaded, result, Choice(case or [], modes, start, end, frames, device), field, quiet=False)
    from warp_plate.viz.window import open_window

    open_window(loaded.scene, motions, field, Path(f"{result.stem}-view"), playing_rate(rate, motions), heights)
