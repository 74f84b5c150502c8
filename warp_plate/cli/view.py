"""``warp-plate view RESULT``: a window that shows the plates of a result in motion."""

from __future__ import annotations

from pathlib import Path

from warp_plate.cli import motion_options, options
from warp_plate.scene.errors import SceneError


def view(
    result: options.ResultFile,
    /,
    *,
    playback: motion_options.PlaybackOptions = motion_options.DEFAULT_PLAYBACK,
    colours: options.ColourChoice = options.DEFAULT_COLOURS,
    frames: motion_options.FrameOptions = motion_options.DEFAULT_FRAMES,
) -> None:
    """Show the plates of a result in motion, in a window; the key h lists what its keys do.

    A result holds few displacements, so its scene is run again under its drives to make the frames.
    """
    playback.check()
    chosen = colours.chosen()
    from warp_plate.result.model import load_result
    from warp_plate.viz.availability import missing_window

    loaded = load_result(result)
    if (problem := missing_window()) is not None:
        raise SceneError(
            f"no window can be opened: {problem}; write pictures, movies or a page with 'warp-plate render {result}'"
            ", or look in a browser with 'warp-plate explore SCENE'"
        )
    motions = motion_options.select_motions(loaded, result, frames, playback, quiet=False)
    from warp_plate.viz.window import open_window

    pictures, rate = Path(f"{result.stem}-view"), playback.frame_rate(motions)
    open_window(loaded.scene, motions, playback.field, pictures, rate, playback.heights, chosen)
