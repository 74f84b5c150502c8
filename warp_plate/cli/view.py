"""``warp-plate view RESULT``: a window that shows the plates of a result in motion."""

from __future__ import annotations

from pathlib import Path

from warp_plate.cli import options
from warp_plate.cli.motion_options import MotionOptions, check_playback, playback_rate, select_motions
from warp_plate.scene.errors import SceneError


def view(
    result: options.ResultFile,
    /,
    *,
    field: options.Field = "displacement",
    case: options.CaseNames | None = None,
    modes: options.ShapeCount = 0,
    start: options.Start | None = None,
    end: options.End | None = None,
    frames: options.Frames | None = None,
    rate: options.Rate | None = None,
    heights: options.Heights | None = None,
    device: options.Device = "auto",
) -> None:
    """Show the plates of a result in motion, in a window; the key h lists what its keys do.

    A result holds few displacements, so its scene is run again under its drives for the frames.
    """
    check_playback(rate, heights)
    from warp_plate.result import load_result
    from warp_plate.viz.availability import missing_window

    loaded = load_result(result)
    if (problem := missing_window()) is not None:
        raise SceneError(
            f"no window can be opened: {problem}; write pictures, movies or a page with 'warp-plate render {result}'"
            ", or look in a browser with 'warp-plate explore SCENE'"
        )
    chosen = MotionOptions(case or [], modes, start, end, frames, device)
    motions = select_motions(loaded, result, chosen, field, quiet=False)
    from warp_plate.viz.window import open_window

    open_window(loaded.scene, motions, field, Path(f"{result.stem}-view"), playback_rate(rate, motions), heights)
