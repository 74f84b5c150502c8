"""Moving plates as files: a picture, a movie, a page or a plan, by the ending of the path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from warp_plate.result.atomic_io import atomic_paths
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.availability import missing_meshes, missing_plots, missing_renderer
from warp_plate.viz.page import write_page
from warp_plate.viz.pictures import OnFrame, PictureStyle, draw_movie, draw_picture, missing_movies
from warp_plate.viz.plots.plan import draw_plan

PLOTS, MOVIES = (".svg", ".pdf"), (".gif", ".mp4")
ENDINGS = (".png", *PLOTS, *MOVIES, ".html")


def missing_library(path: Path, plan: bool = False) -> str | None:
    """Return a sentence on what is missing to draw this file, or None; ``plan``: a .png seen from above."""
    ending = path.suffix.lower()
    if ending in PLOTS or (plan and ending == ".png"):
        return missing_plots()
    if ending == ".html":
        return missing_meshes()
    return missing_renderer() or (missing_movies() if ending == ".mp4" else None)


def draw_motions(
    scene: Scene,
    motions: Sequence[Motion],
    path: Path,
    style: PictureStyle,
    frame: int,
    rate: float,
    plan: bool = False,
    on_frame: OnFrame = lambda done, total: None,
) -> None:
    """Write motions as the ending of the path says.

    Args:
        scene: Scene of the motions.
        motions: Plates, side by side.
        path: .png (a picture), .svg, .pdf (seen from above), .gif, .mp4 (movies) or .html (a page that plays them).
        style: Quantity in colour, width, heights and colours.
        frame: Frame of a picture.
        rate: Frames per second of movies and pages.
        plan: Draw a .png seen from above too.
        on_frame: Called with the numbers of frames done and in all of a movie.
    """
    ending = path.suffix.lower()
    with atomic_paths(path) as (temporary,):
        if ending in PLOTS or (plan and ending == ".png"):
            draw_plan(scene, motions, temporary, style.quantity, frame, style.colours)
        elif ending == ".png":
            draw_picture(scene, motions, temporary, style, frame)
        elif ending == ".html":
            write_page(scene, motions, temporary, style.quantity, rate, style.heights, style.colours)
        else:
            draw_movie(scene, motions, temporary, style, rate, on_frame)
