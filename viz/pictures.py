"""Pictures and movies of plates in motion, drawn off screen: PNG, GIF, MP4."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import TARGET, lookup_table
from warp_plate.viz.availability import EXTRA, off_screen
from warp_plate.viz.edge_styles import EDGE_STYLES
from warp_plate.viz.fields import DrawingScale, field_of
from warp_plate.viz.side_by_side import SideBySide, plate_subplots

if TYPE_CHECKING:
    import pyvista
    from PIL import Image

# Pictures are drawn larger by this factor and shrunk, as VTK's own anti-aliasing garbles subplots (VTK 9.4).
SUPERSAMPLING = 1.25
# Height of a plate's picture over its width.
ASPECT = 0.78
# Least duration of a movie, which repeats its frames [s].
LEAST_DURATION = 6.0
# GIF counts hundredths of a second, and most viewers slow down frames shorter than this.
SHORTEST_GIF_FRAME = 2
# Colours from here on are white in a GIF.
LIGHT = 247

# Called after each frame with the numbers of frames done and in all.
OnFrame = Callable[[int, int], object]
TakePicture = Callable[[], "Image.Image"]


@dataclass(frozen=True)
class PictureStyle:
    """Style of pictures and movies of motions.

    Attributes:
        quantity: field in colour, a key of FIELDS.
        width: width of one plate's picture, without the legend [pixels].
        heights: factor by which heights are exaggerated (default: to suit the picture).
    """

    quantity: str = "displacement"
    width: int = 560
    heights: float | None = None

    @property
    def font_size(self) -> int:
        """Height of the text [pixels]."""
        return max(8, round(self.width / 29))


def missing_movies() -> str | None:
    """Return a sentence on what is missing for MP4 files, or None."""
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        return f"MP4 files need imageio-ffmpeg: {EXTRA}"
    return None


def draw_picture(
    scene: Scene, motions: Sequence[Motion], path: Path, style: PictureStyle, frame: int | None = None
) -> None:
    """Write one frame of all motions as a PNG (default: :func:`largest_frame`).

    Raises:
        DrawingUnavailable: VTK cannot draw here.
        OSError: the file cannot be written.
    """
    frame = largest_frame(motions, style.quantity) if frame is None else frame
    with off_screen_plates(scene, motions, style) as (plates, take_picture):
        plates.show(frame)
        take_picture().save(path, format="PNG", compress_level=9)


def draw_gif(
    scene: Scene,
    motions: Sequence[Motion],
    path: Path,
    style: PictureStyle,
    rate: float,
    on_frame: OnFrame | None = None,
) -> None:
    """Write all frames as a GIF that repeats forever, at ``rate`` frames a second (50 at most).

    Raises: see :func:`draw_picture`.
    """
    from PIL import Image

    with off_screen_plates(scene, motions, style) as (plates, take_picture):
        samples = []
        for frame in range(0, plates.frames, max(1, plates.frames // 4)):
            plates.show(frame)
            samples.append(take_picture())
        # One palette for all frames: with palettes of their own, colours would flicker.
        palette = _palette(samples, plates.scale)
        pictures = _all_frames(plates, take_picture, on_frame)
        first, *rest = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = 10 * max(SHORTEST_GIF_FRAME, round(100 / rate))
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=False)


def draw_mp4(
    scene: Scene,
    motions: Sequence[Motion],
    path: Path,
    style: PictureStyle,
    rate: float,
    on_frame: OnFrame | None = None,
) -> None:
    """Write all frames as an MP4 (H.264) that every browser plays; short ones repeat for at least six seconds.

    Raises:
        DrawingUnavailable: VTK cannot draw here.
        OSError: the file cannot be written.
        ImportError: see :func:`missing_movies`.
    """
    import imageio_ffmpeg

    with off_screen_plates(scene, motions, style) as (plates, take_picture), TemporaryFile() as errors:
        width, height = (side // 2 * 2 for side in take_picture().size)  # H.264 requires even sides
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
        encoded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", "-f", "mp4"]
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *raw, *encoded, str(path)]
        repeats = math.ceil(LEAST_DURATION * rate / plates.frames)
        kept: list[bytes] = []
        encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=errors)
        with contextlib.suppress(BrokenPipeError), encoder:
            assert encoder.stdin is not None
            for picture in _all_frames(plates, take_picture, on_frame):
                pixels = picture.crop((0, 0, width, height)).tobytes()
                encoder.stdin.write(pixels)
                kept += [pixels] * (repeats > 1)
            for _ in range(repeats - 1):
                encoder.stdin.writelines(kept)
        if encoder.returncode != 0:
            errors.seek(0)
            raise OSError(errors.read().decode(errors="replace").strip())


def largest_frame(motions: Sequence[Motion], quantity: str = "displacement") -> int:
    """Return the frame where the field is largest in any plate, or the displacement if the field is constant."""
    field = field_of(motions, quantity)
    values = [field.values(motion) for motion in motions]
    if len(values[0]) == 1:
        values = [motion.displacement for motion in motions]
    peaks = [np.abs(np.nan_to_num(array, posinf=0, neginf=0)).max(axis=(1, 2)) for array in values]
    return int(np.max(peaks, axis=0).argmax())


@contextmanager
def off_screen_plates(
    scene: Scene, motions: Sequence[Motion], style: PictureStyle
) -> Iterator[tuple[SideBySide, TakePicture]]:
    """Yield the plates in an off-screen plotter, and a function that takes a picture of them.

    Raises:
        DrawingUnavailable: VTK cannot draw here.
    """
    subplots = plate_subplots(len(motions), style.width, style.font_size)
    size = (sum(subplots["col_weights"]), round(subplots["shape"][0] * ASPECT * style.width))
    with off_screen_plotter(size, **subplots) as (plotter, take_picture):
        plates = SideBySide(plotter, scene, motions, style.quantity, round(SUPERSAMPLING * style.font_size))
        if style.heights is not None:
            plates.exaggerate(style.heights)
        yield plates, take_picture


@contextmanager
def off_screen_plotter(size: tuple[int, int], **options: Any) -> Iterator[tuple[pyvista.Plotter, TakePicture]]:
    """Yield a supersampled plotter, and a function that takes a picture of it with this size [pixels].

    Raises:
        DrawingUnavailable: VTK cannot draw here.
    """
    from PIL import Image

    with off_screen():
        large = (round(SUPERSAMPLING * size[0]), round(SUPERSAMPLING * size[1]))
        plotter = make_plotter(large, off_screen=True, **options)

        def take_picture() -> Image.Image:
            plotter.render()
            pixels = np.asarray(plotter.screenshot(return_img=True))
            return Image.fromarray(pixels).resize(size, Image.Resampling.LANCZOS)

        try:
            yield plotter, take_picture
        finally:
            plotter.close()


def make_plotter(size: tuple[int, int], **options: Any) -> pyvista.Plotter:
    """Return an empty white plotter without lights; size in pixels, options as of ``pyvista.Plotter``."""
    import pyvista

    theme = pyvista.themes.DocumentTheme()
    plotter = pyvista.Plotter(border=False, window_size=list(size), theme=theme, lighting="none", **options)
    # VTK's anti-aliasing breaks wide lines here and there.
    plotter.disable_anti_aliasing()
    return plotter


def _palette(samples: Sequence[Image.Image], scale: DrawingScale) -> Image.Image:
    """Return an image with 256 colours for all samples, half of them the colour map's, to avoid bands."""
    from PIL import Image

    sheet = Image.new("RGB", (samples[0].width, samples[0].height * len(samples)))
    for index, sample in enumerate(samples):
        sheet.paste(sample, (0, index * sample.height))
    reserved = [*lookup_table(scale).values[::2, :3]]
    for colour in (TARGET, *(style.colour for style in EDGE_STYLES.values())):
        # Smoothed lines and letters blend into the white background.
        line = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
        reserved += [line + (255 - line) * part / 4 for part in range(4)]
    free = 256 - len(reserved)
    others = np.reshape(sheet.quantize(free, method=Image.Quantize.MEDIANCUT).getpalette(), (-1, 3))
    colours = np.concatenate([reserved, others[:free]])
    # Keep the background white, not the mean of many light colours.
    colours[colours.min(axis=1) >= LIGHT] = 255
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours.astype(np.uint8).tobytes())
    return palette


def _all_frames(plates: SideBySide, take_picture: TakePicture, on_frame: OnFrame | None) -> Iterator[Image.Image]:
    for frame in range(plates.frames):
        plates.show(frame)
        yield take_picture()
        if on_frame is not None:
            on_frame(frame + 1, plates.frames)
