"""Pictures, movies and pages of plates in motion, drawn off screen, by the ending of the file.

They raise DrawingUnavailable if VTK cannot draw here, and OSError if the file cannot be written.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, Popen
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.atomic_io import atomic_paths
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.availability import EXTRA, missing_meshes, missing_plots, missing_renderer, set_up_renderer
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, field_of
from warp_plate.viz.page import write_page
from warp_plate.viz.plots.plan import draw_plan
from warp_plate.viz.scene3d import SideBySide, plate_subplots

if TYPE_CHECKING:
    import pyvista
    from PIL import Image

# Pictures are drawn larger by this factor and shrunk, as VTK's own anti-aliasing garbles subplots (VTK 9.4).
SUPERSAMPLING = 1.25
# Height of a plate's picture over its width; least duration of an MP4, which repeats its frames [s].
ASPECT, LEAST_DURATION = 0.78, 6.0
# In hundredths of a second, in which GIF counts; most viewers slow down shorter frames.
SHORTEST_GIF_FRAME = 2

OnFrame = Callable[[int, int], object]  # called with the numbers of frames done and in all
TakePicture = Callable[[], "Image.Image"]
PLOTS, MOVIES = (".svg", ".pdf"), (".gif", ".mp4")
ENDINGS = (".png", *PLOTS, *MOVIES, ".html")


@dataclass(frozen=True)
class PictureStyle:
    """Style of pictures and movies of motions."""

    quantity: str = "displacement"  # field in colour, a key of FIELDS
    width: int = 560  # width of one plate's picture, without the legend [pixels]
    heights: float | None = None  # factor by which heights are exaggerated (default: to suit the picture)
    colours: ColourOptions = DEFAULT_COLOURS  # colour map and limits of the field

    @property
    def font_size(self) -> int:
        """Height of the text [pixels]."""
        return max(8, round(self.width / 29))


def missing_movies() -> str | None:
    """Return a sentence on what is missing for MP4 files, or None."""
    return None if importlib.util.find_spec("imageio_ffmpeg") else f"MP4 files need imageio-ffmpeg: {EXTRA}"


def draw_picture(scene: Scene, motions: Sequence[Motion], path: Path, style: PictureStyle, frame: int) -> None:
    """Write one frame of all motions as a PNG."""
    with off_screen_plates(scene, motions, style) as (plates, take_picture):
        plates.show(frame)
        take_picture().save(path, format="PNG", compress_level=9)


def draw_movie(
    scene: Scene, motions: Sequence[Motion], path: Path, style: PictureStyle, rate: float, on_frame: OnFrame
) -> None:
    """Write all frames as a GIF, at most 50 a second, or as an MP4 (H.264) of at least six seconds."""
    with off_screen_plates(scene, motions, style) as (plates, take_picture):

        def pictures() -> Iterator[Image.Image]:
            for frame in range(plates.frames):
                plates.show(frame)
                yield take_picture()
                on_frame(frame + 1, plates.frames)

        if path.suffix.lower() == ".gif":
            plates.show(largest_frame(motions, style.quantity))
            _write_gif(path, pictures(), take_picture(), rate)
        else:
            _write_mp4(path, pictures(), take_picture().size, rate, math.ceil(LEAST_DURATION * rate / plates.frames))


def _write_gif(path: Path, pictures: Iterator[Image.Image], sample: Image.Image, rate: float) -> None:
    from PIL import Image

    # One palette for all frames, as colours would flicker with several; this method keeps the background white.
    palette = sample.quantize(method=Image.Quantize.MAXCOVERAGE)
    first, *rest = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = 10 * max(SHORTEST_GIF_FRAME, round(100 / rate))
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=False)


def _write_mp4(path: Path, pictures: Iterator[Image.Image], size: tuple[int, int], rate: float, repeats: int) -> None:
    import imageio_ffmpeg

    width, height = (side // 2 * 2 for side in size)  # H.264 requires even sides
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
    encoded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", str(path)]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *raw, *encoded]
    frames: list[bytes] = []
    with TemporaryFile() as errors:
        encoder = Popen(command, stdin=PIPE, stderr=errors)
        with suppress(BrokenPipeError), encoder:
            assert encoder.stdin is not None
            for picture in pictures:
                pixels = picture.crop((0, 0, width, height)).tobytes()
                encoder.stdin.write(pixels)
                frames += [pixels] * (repeats > 1)
            for _ in range(repeats - 1):
                encoder.stdin.writelines(frames)
        if encoder.returncode != 0:
            errors.seek(0)
            raise OSError(errors.read().decode(errors="replace").strip())


def largest_frame(motions: Sequence[Motion], quantity: str = "displacement") -> int:
    """Return the frame where the field is largest in any plate, or the displacement if the field is constant."""
    values = [field_of(motions, quantity).values(motion) for motion in motions]
    if len(values[0]) == 1:
        values = [motion.displacement for motion in motions]
    peaks = [np.abs(np.nan_to_num(array, posinf=0, neginf=0)).max(axis=(1, 2)) for array in values]
    return int(np.max(peaks, axis=0).argmax())


@contextmanager
def off_screen_plates(
    scene: Scene, motions: Sequence[Motion], style: PictureStyle
) -> Iterator[tuple[SideBySide, TakePicture]]:
    """Yield the plates in an off-screen plotter, and a function that takes a picture of them."""
    subplots = plate_subplots(len(motions), style.width, style.font_size, style.colours.separate)
    size = (sum(subplots["col_weights"]), round(subplots["shape"][0] * ASPECT * style.width))
    with off_screen_plotter(size, **subplots) as (plotter, take_picture):
        font_size = round(SUPERSAMPLING * style.font_size)
        plates = SideBySide(plotter, scene, motions, style.quantity, font_size, style.colours)
        if style.heights is not None:
            plates.exaggerate(style.heights)
        yield plates, take_picture


@contextmanager
def off_screen_plotter(size: tuple[int, int], **options: Any) -> Iterator[tuple[pyvista.Plotter, TakePicture]]:
    """Yield a supersampled plotter, and a function that takes a picture of it with this size [pixels]."""
    from PIL import Image

    set_up_renderer()
    large = (round(SUPERSAMPLING * size[0]), round(SUPERSAMPLING * size[1]))
    with closing(make_plotter(large, off_screen=True, **options)) as plotter:

        def take_picture() -> Image.Image:
            plotter.render()
            pixels = np.asarray(plotter.screenshot(return_img=True))
            return Image.fromarray(pixels).resize(size, Image.Resampling.LANCZOS)

        yield plotter, take_picture


def make_plotter(size: tuple[int, int], **options: Any) -> pyvista.Plotter:
    """Return an empty white plotter without lights; size in pixels, options as of ``pyvista.Plotter``."""
    import pyvista

    theme = pyvista.themes.DocumentTheme()
    plotter = pyvista.Plotter(border=False, window_size=list(size), theme=theme, lighting="none", **options)
    # VTK's anti-aliasing breaks wide lines here and there.
    plotter.disable_anti_aliasing()
    return plotter


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
