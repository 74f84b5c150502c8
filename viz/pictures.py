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
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.availability import EXTRA, off_screen
from warp_plate.viz.comparison import Comparison, layout, quantity_of
from warp_plate.viz.edges import SIDES
from warp_plate.viz.lettering import TARGET, lookup_table
from warp_plate.viz.quantity import Scale

if TYPE_CHECKING:
    import pyvista
    from PIL import Image

# Drawn so many times larger and shrunk, for VTK's own smoothing (SSAA) garbles subplots in VTK 9.4. Twice looks hardly
# better and takes a second longer where a processor draws.
SMOOTHING = 1.25
# Height of a plate's picture over its width.
SHAPE = 0.78
# A movie of one period is played again until it has lasted this long [s].
LASTING = 6.0
# GIF counts hundredths of a second, and most viewers slow down what is faster than this.
FASTEST_GIF = 2
# Colours from here on are white in a GIF.
LIGHT = 247
# Told after each frame: frames done, frames in all.
Told = Callable[[int, int], object]


@dataclass(frozen=True)
class Look:
    """What pictures of motions have in common.

    quantity: in colour, a key of QUANTITIES; width: of one plate's picture, without the legend [pixels]; heights: how
    many times they are exaggerated; left out: so that the largest suits the picture.
    """

    quantity: str = "displacement"
    width: int = 560
    heights: float | None = None

    @property
    def font_size(self) -> int:
        """In pixels, for a picture of this width."""
        return max(8, round(self.width / 29))


def missing_movies() -> str | None:
    """None where MP4 can be written; otherwise one sentence that says what to install."""
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        return f"MP4 cannot be written without imageio-ffmpeg: {EXTRA}"
    return None


def draw_picture(scene: Scene, motions: Sequence[Motion], path: Path, look: Look, frame: int | None = None) -> None:
    """One frame of all motions as a PNG; left out: see :func:`largest_frame`.

    Raises:
        DrawingUnavailable: VTK cannot draw here; says what to install.
        OSError: the file cannot be written.
    """
    frame = largest_frame(motions, look.quantity) if frame is None else frame
    with stage(scene, motions, look) as (comparison, picture):
        comparison.show(frame)
        picture().save(path, format="PNG", compress_level=9)


def draw_gif(
    scene: Scene, motions: Sequence[Motion], path: Path, look: Look, rate: float, told: Told | None = None
) -> None:
    """All frames as a GIF that repeats for ever; rate: frames a second, 50 at most.

    Raises: see :func:`draw_picture`.
    """
    from PIL import Image

    indexed = []
    with stage(scene, motions, look) as (comparison, picture):
        # One palette for all frames: with their own, colours would flicker.
        some = []
        for frame in range(0, comparison.frames, max(1, comparison.frames // 4)):
            comparison.show(frame)
            some.append(picture())
        palette = _palette(some, comparison.scale)
        for frame in range(comparison.frames):
            comparison.show(frame)
            indexed.append(picture().quantize(palette=palette, dither=Image.Dither.NONE))
            if told is not None:
                told(frame + 1, comparison.frames)
    pause = 10 * max(FASTEST_GIF, round(100 / rate))
    first, *rest = indexed
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=pause, loop=0, optimize=False)


def draw_mp4(
    scene: Scene, motions: Sequence[Motion], path: Path, look: Look, rate: float, told: Told | None = None
) -> None:
    """All frames as an MP4 (H.264) that every browser plays; short ones are repeated to last six seconds.

    Raises:
        DrawingUnavailable: VTK cannot draw here; says what to install.
        OSError: the file cannot be written.
        ImportError: see :func:`missing_movies`.
    """
    import imageio_ffmpeg

    with stage(scene, motions, look) as (comparison, picture), TemporaryFile() as complaints:
        width, height = (side // 2 * 2 for side in picture().size)  # H.264 takes even sides only
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
        coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", "-f", "mp4"]
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *raw, *coded, str(path)]
        coder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=complaints)
        with contextlib.suppress(BrokenPipeError), coder:
            assert coder.stdin is not None
            _play(comparison, picture, (width, height), rate, coder.stdin, told)
        if coder.returncode != 0:
            complaints.seek(0)
            raise OSError(complaints.read().decode(errors="replace").strip())


def largest_frame(motions: Sequence[Motion], quantity: str = "displacement") -> int:
    """The frame where the quantity is largest in any plate; the displacement, where it is the same at all times."""
    shown = quantity_of(motions, quantity)
    fields = [shown.values(motion) for motion in motions]
    if len(fields[0]) == 1:
        fields = [motion.displacement for motion in motions]
    peaks = [np.abs(np.nan_to_num(field, posinf=0, neginf=0)).max(axis=(1, 2)) for field in fields]
    return int(np.max(peaks, axis=0).argmax())


@contextmanager
def stage(
    scene: Scene, motions: Sequence[Motion], look: Look
) -> Iterator[tuple[Comparison, Callable[[], Image.Image]]]:
    """The plates in a plotter off screen, and what takes a picture of them as they stand.

    Raises:
        DrawingUnavailable: VTK cannot draw here; says what to install.
    """
    from PIL import Image

    subplots = layout(len(motions), look.width, look.font_size)
    size = (sum(subplots["col_weights"]), round(subplots["shape"][0] * SHAPE * look.width))
    with off_screen():
        plotter = make_plotter((round(SMOOTHING * size[0]), round(SMOOTHING * size[1])), off_screen=True, **subplots)
        try:
            comparison = Comparison(plotter, scene, motions, look.quantity, round(SMOOTHING * look.font_size))
            if look.heights is not None:
                comparison.exaggerate(look.heights)

            def picture() -> Image.Image:
                plotter.render()
                large = plotter.screenshot(return_img=True)
                return Image.fromarray(np.asarray(large)).resize(size, Image.Resampling.LANCZOS)

            yield comparison, picture
        finally:
            plotter.close()


def make_plotter(size: tuple[int, int], **options: Any) -> pyvista.Plotter:
    """An empty plotter, white and without lights; size in pixels; options: PyVista's."""
    import pyvista

    plotter = pyvista.Plotter(
        border=False,
        window_size=list(size),
        theme=pyvista.themes.DocumentTheme(),
        lighting="none",
        **options,
    )
    # With VTK's smoothing, wide lines are broken here and there.
    plotter.disable_anti_aliasing()
    return plotter


def _palette(some: Sequence[Image.Image], scale: Scale) -> Image.Image:
    """A picture with 256 colours that suit all of these: half of them the scale's own, which would show steps else."""
    from PIL import Image

    sheet = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for index, one in enumerate(some):
        sheet.paste(one, (0, index * one.height))
    own = [*lookup_table(scale).values[::2, :3]]
    for colour in (TARGET, *(look.colour for look in SIDES.values())):
        # Smoothed lines and letters are mixed with paper.
        line = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
        own += [line + (255 - line) * part / 4 for part in range(4)]
    others = np.reshape(sheet.quantize(256 - len(own), method=Image.Quantize.MEDIANCUT).getpalette(), (-1, 3))
    colours = np.concatenate([own, others[: 256 - len(own)]])
    # Paper is to stay white, which a mean of many light colours is not.
    colours[colours.min(axis=1) >= LIGHT] = 255
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours.astype(np.uint8).tobytes())
    return palette


def _play(
    comparison: Comparison,
    picture: Callable[[], Image.Image],
    size: tuple[int, int],
    rate: float,
    out: IO[bytes],
    told: Told | None,
) -> None:
    """Write all frames as raw pixels of this size, and again until they last long enough."""
    again = math.ceil(LASTING * rate / comparison.frames)
    kept = []
    for frame in range(comparison.frames):
        comparison.show(frame)
        pixels = picture().crop((0, 0, *size)).tobytes()
        out.write(pixels)
        if again > 1:
            kept.append(pixels)
        if told is not None:
            told(frame + 1, comparison.frames)
    for _ in range(again - 1):
        out.writelines(kept)
