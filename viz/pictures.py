"""Pictures of results, and pictures, movies and pages of plates in motion, drawn off screen.

They raise DrawingUnavailable if VTK cannot draw here, and OSError if the file cannot be written.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.interrupts import check_interrupt, deferred_interrupts
from warp_plate.result.atomic_io import atomic_paths
from warp_plate.result.case import only_actuator
from warp_plate.result.model import Result
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import add_legend, at_frequency, caption, case_label, ordered_cases
from warp_plate.viz.availability import missing_plots, missing_renderer, prepare, set_up_renderer
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, PictureStyle, drawing_scale, field_of
from warp_plate.viz.page import write_page
from warp_plate.viz.plots.frame import save_plots
from warp_plate.viz.plots.plan import draw_crosstalk, draw_plan
from warp_plate.viz.plots.search import draw_history, draw_robust, draw_spectrum
from warp_plate.viz.scene3d import PlateActors, SideBySide, plate_subplots

if TYPE_CHECKING:
    import pyvista
    from PIL import Image

# Pictures are drawn larger by this factor and shrunk, as VTK's own anti-aliasing garbles subplots (VTK 9.4).
SUPERSAMPLING = 1.25
# Of figure 2: most plates in a row; of more recorded times, some are left out evenly. Font and sizes in pixels.
MOST_COLUMNS, FONT_SIZE, ROW_HEIGHT, KEY_WIDTH = 6, 20, 480, 180
# Part of the largest displacement below which a plate hardly moves.
AT_REST = 0.1
# Difference of displacements, over the largest, of cases that are drawn as one.
ALIKE = 1e-6
# Height of a plate's picture over its width; least duration of an MP4, which repeats its frames [s].
ASPECT, LEAST_DURATION = 0.78, 6.0
# In hundredths of a second, in which GIF counts; most viewers slow down shorter frames.
SHORTEST_GIF_FRAME = 2

OnFrame = Callable[[int, int], object]  # called with the numbers of frames done and in all
TakePicture = Callable[[], "Image.Image"]
PLOTS = (".svg", ".pdf")
ENDINGS = (".png", *PLOTS, ".gif", ".mp4", ".html")


def draw_all(
    result: Result, stem: str | Path, colours: ColourOptions = DEFAULT_COLOURS
) -> tuple[list[Path], str | None]:
    """Draw all that the result holds, as ``<stem>-history.png``, ``<stem>-surfaces.png`` and so on.

    Colours are those of fields over the plate. Returns the files written, and None or a sentence for each missing one,
    joined by "; ".
    """
    compared = result.robust is not None and bool(np.isfinite(result.robust.validation).any())
    jobs = {
        draw_history: len(result.history.get("best", ())) > 1,
        draw_robust: compared,
        draw_spectrum: result.spectrum,
        draw_crosstalk: result.scene.targets and result.command == "localize",
        draw_surfaces: result.times.size,
    }
    if result.times.size:
        prepare()
    written, problems = [], []
    for draw in (draw for draw, held in jobs.items() if held):
        path = Path(f"{stem}-{draw.__name__.removeprefix('draw_')}.png")
        options = {"colours": colours} if draw is draw_surfaces else {}
        files, problem = save_plots(partial(draw, result, **options), path, [".png"])
        written += files
        problems += [problem] if problem is not None else []
    return written, "; ".join(dict.fromkeys(problems)) or None


def draw_surfaces(result: Result, path: str | Path, colours: ColourOptions = DEFAULT_COLOURS) -> None:
    """Draw figure 2 of the paper as a PNG: a row for each case, by default with limits of its own, a column for each
    recorded time. Without ``record.times``, a time when hardly anything moves is left out.

    Raises ValueError if the result holds no displacement, and DrawingUnavailable if VTK cannot draw here.
    """
    if not result.times.size:
        raise ValueError("the result holds no displacement: record.times of its scene is empty")
    cases, scene = ordered_cases(result), result.scene
    first, *others = cases.values()
    slightest = ALIKE * np.nan_to_num(np.abs(first.displacement)).max()
    if others and all(np.allclose(one.displacement, first.displacement, 0, slightest, True) for one in others):
        cases = {"all drives": first}
    times = result.times.size
    shown = np.linspace(0, times - 1, min(times, MOST_COLUMNS)).round().astype(int).tolist()
    if not scene.record.times:
        peaks = np.array([np.nan_to_num(np.abs(case.displacement)).max(axis=(1, 2)) for case in cases.values()])
        moving = (peaks > AT_REST * peaks.max(axis=1, keepdims=True)).any(axis=0)
        shown = [index for index in shown if moving[index]] or shown
    width = min(730, max(520, (1600 - KEY_WIDTH) // len(shown)))
    weights = [width] * len(shown) + [KEY_WIDTH]
    font_size = round(SUPERSAMPLING * FONT_SIZE)
    size, shape = (sum(weights), ROW_HEIGHT * len(cases)), (len(cases), len(weights))
    with off_screen_plotter(size, shape=shape, col_weights=weights) as (plotter, take_picture):
        for row, (name, case) in enumerate(cases.items()):
            letter = f"({chr(ord('a') + row)}) " if len(cases) > 1 else ""
            label = letter + case_label(name, scene, only_actuator(case, scene))
            together = cases.values() if colours.limits == "common" else [case]
            scale = drawing_scale([one.displacement for one in together], scene.plate.size, colours=colours)
            driven = result.case_scene(case)
            frequency_text = at_frequency(scene, driven.drive.frequency)
            for column, index in enumerate(shown):
                plotter.subplot(row, column)
                text = caption(
                    label, float(result.times[index]), case.localization_factor, frequency_text=frequency_text
                )
                PlateActors(plotter, driven, case.displacement[index], scale, text, font_size, bar=False)
            plotter.subplot(row, len(shown))
            add_legend(plotter, scene, scale, font_size)
        take_picture().save(path, format="PNG", compress_level=3)


def missing_library(path: Path, plan: bool = False) -> str | None:
    """Return a sentence on what is missing to draw this file, or None; ``plan``: a .png seen from above."""
    ending = path.suffix.lower()
    off_screen = ending in (".gif", ".mp4") or (ending == ".png" and not plan)
    return missing_renderer() if off_screen else missing_plots()


def draw_motions(
    scene: Scene, motions: Sequence[Motion], path: Path, style: PictureStyle, frame: int,
    on_frame: OnFrame = lambda done, total: None,
) -> None:  # fmt: skip
    """Write motions of a scene, side by side, as the ending of the path says.

    Args:
        path: .png (a picture), .svg, .pdf (seen from above), .gif, .mp4 (movies) or .html (a page that plays them).
        frame: Frame of a picture.
        on_frame: Called with the numbers of frames done and in all of a movie.
    """
    ending = path.suffix.lower()
    with atomic_paths(path) as (temporary,):
        if ending in PLOTS or (style.plan and ending == ".png"):
            draw_plan(scene, motions, temporary, style, frame)
        elif ending == ".html":
            write_page(scene, motions, temporary, style)
        else:
            with _off_screen_plates(scene, motions, style) as (plates, take_picture):
                if ending == ".png":
                    plates.show(frame)
                    take_picture().save(temporary, format="PNG", compress_level=9)
                    return
                plates.show(largest_frame(motions, style.quantity))
                write = _write_gif if ending == ".gif" else _write_mp4
                write(temporary, _pictures(plates, take_picture, on_frame), take_picture(), plates.frames, style.rate)


def _pictures(plates: SideBySide, take_picture: TakePicture, on_frame: OnFrame) -> Iterator[Image.Image]:
    """Yield a picture of each frame."""
    for frame in range(plates.frames):
        plates.show(frame)
        yield take_picture()
        on_frame(frame + 1, plates.frames)


def _write_gif(path: Path, pictures: Iterator[Image.Image], sample: Image.Image, frames: int, rate: float) -> None:
    """Write a GIF of at most 50 frames a second."""
    from PIL import Image

    # One palette for all frames, as colours would flicker with several; this method keeps the background white.
    palette = sample.quantize(method=Image.Quantize.MAXCOVERAGE)
    first, *rest = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = 10 * max(SHORTEST_GIF_FRAME, round(100 / rate))
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=False)


def _write_mp4(path: Path, pictures: Iterator[Image.Image], sample: Image.Image, frames: int, rate: float) -> None:
    """Write an MP4 (H.264), which repeats its frames until it has at least six seconds."""
    from imageio_ffmpeg import get_ffmpeg_exe

    width, height = (sample.width // 2 * 2, sample.height // 2 * 2)  # H.264 requires even sides
    raw = f"-f rawvideo -vcodec rawvideo -s {width}x{height} -pix_fmt rgb24 -r {rate:.2f}".split()
    codec = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart"]
    # Not by imageio_ffmpeg.write_frames, which ignores the exit status, so that a full disk would cut the movie short.
    command = [get_ffmpeg_exe(), "-y", *raw, "-i", "-", *codec, "-v", "quiet", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        try:
            drawn = []
            for picture in pictures:
                drawn.append(picture.crop((0, 0, width, height)).tobytes())
                encoder.stdin.write(drawn[-1])
            for pixels in drawn * (math.ceil(LEAST_DURATION * rate / frames) - 1):
                encoder.stdin.write(pixels)
        except BrokenPipeError:
            pass  # it ended early
        except BaseException:
            encoder.kill()
            raise
        finally:
            encoder.communicate()
    if encoder.returncode:
        check_interrupt()  # a terminal sends Ctrl-C to the encoder too
        raise OSError(f"its encoder ended with status {encoder.returncode}; is the disk full?")


def largest_frame(motions: Sequence[Motion], quantity: str = "displacement") -> int:
    """Return the frame where the field is largest in any plate, or the displacement if the field is constant."""
    values = [field_of(motions, quantity).values(motion) for motion in motions]
    if len(values[0]) == 1:
        values = [motion.displacement for motion in motions]
    peaks = [np.abs(np.nan_to_num(array, posinf=0, neginf=0)).max(axis=(1, 2)) for array in values]
    return int(np.max(peaks, axis=0).argmax())


@contextmanager
def _off_screen_plates(
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
    """Yield a supersampled plotter, and a function that takes a picture of it with this size [pixels].

    Ctrl-C waits for the next picture or the end: VTK would lose it in filters written in Python, and draw on.
    """
    from PIL import Image

    set_up_renderer()
    large = (round(SUPERSAMPLING * size[0]), round(SUPERSAMPLING * size[1]))
    with deferred_interrupts(), closing(make_plotter(large, off_screen=True, **options)) as plotter:

        def take_picture() -> Image.Image:
            check_interrupt()
            plotter.render()
            pixels = np.asarray(plotter.screenshot(return_img=True))
            return Image.fromarray(pixels).resize(size, Image.Resampling.LANCZOS)

        yield plotter, take_picture


def make_plotter(size: tuple[int, int], **options: Any) -> pyvista.Plotter:
    """Return an empty white plotter without lights; size in pixels, options as of ``pyvista.Plotter``."""
    with deferred_interrupts():  # one that comes while libraries of VTK are loaded may crash Python
        import pyvista

        theme = pyvista.themes.DocumentTheme()
        plotter = pyvista.Plotter(border=False, window_size=list(size), theme=theme, lighting="none", **options)
        # VTK's anti-aliasing breaks wide lines here and there.
        plotter.disable_anti_aliasing()
    return plotter
