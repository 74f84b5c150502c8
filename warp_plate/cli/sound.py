"""``warp-plate sound SCENE``: the sound of a plate under the scene's drive, over frequencies."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.cli.frf import NUMBER, PICTURES, ResponseFormat, formats_of, frequency_range, write_and_draw
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.sound import Sound


@Parameter(name="*")
@dataclass(frozen=True)
class SoundOptions:
    """Options of the sound.

    Attributes:
        at: Point X,Y,Z in metres in front of the plate, Z above it; may be repeated (default: 1 m above the middle of
            each target).
        range: Lowest and highest frequency in hertz, LOW:HIGH (default: as of frf).
    """

    at: Annotated[list[str] | None, Parameter(negative="", allow_leading_hyphen=True)] = None
    range: str | None = None


def sound(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    sounds: SoundOptions = SoundOptions(),
    to: Annotated[list[ResponseFormat] | None, Parameter(negative="")] = None,
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Show the sound of a linear plate under the scene's drive: power, pressure and directivity.

    The plate vibrates in a rigid baffle in free air at 20 °C and radiates to one side; the sound does not act on it.
    Frequencies are spaced so that every resonance is resolved. All is drawn as a picture (.png, .svg or .pdf).

    Parameters
    ----------
    to
        File with the numbers beside the picture; may be repeated: csv; hdf5, which xarray opens. The ending of --out
        (.csv, .h5) acts as --to.
    """
    from warp_plate.result.sound import WRITERS
    from warp_plate.studies.sound import sound as compute
    from warp_plate.viz.plots.sound import draw_sound

    target = files.target(scene, "-sound.png", endings=(*PICTURES, *(ending for ending, _ in WRITERS.values())))
    formats = formats_of(target, to, WRITERS)
    points = [_point(text) for text in sounds.at or ()]
    limits = None if sounds.range is None else frequency_range(sounds.range)
    if "hdf5" in formats:
        output.check_overwriting(target.with_suffix(".h5"), "a sound", files.force)
    loaded, scene = changes.load(scene)
    with output.scene_errors(scene, points="at", frequency_range="range"):
        result = compute(loaded, points, limits)
    drawn = write_and_draw(result, target, formats, WRITERS, draw_sound if files.pictures else None)
    output.report(files.json, _as_json, _print, scene, result, written=files.check_drawn(target, drawn))


def _point(text: str) -> tuple[float, float, float]:
    if re.fullmatch(f"{NUMBER},{NUMBER},{NUMBER}", text) is None:
        raise SceneError(f"--at {text}: must be X,Y,Z in metres, such as 0.05,0.1,1")
    x, y, z = map(float, text.split(","))
    return x, y, z


def _as_json(name: str, result: Sound) -> dict[str, object]:
    arrays = ("frequencies", "power", "power_level", "weighting", "efficiency", "localization_factor", "points")
    return {
        **output.attributes(result, "drive_frequency", *arrays, "pressure_levels"),
        "real": result.pressures.real,
        "imaginary": result.pressures.imag,
        **output.attributes(result, "natural_frequencies", "loss_factors", "angles", "directivity"),
    }


def _print(name: str, result: Sound, console: Console) -> None:
    index, loudest = result.at_drive, int((result.power_level + result.weighting).argmax())
    console.print(
        f"{result.title or name}: sound at {len(result.frequencies)} frequencies from {result.frequencies[0]:g} to "
        f"{result.frequencies[-1]:g} Hz\n"
    )
    rows = []
    for label, at in (("the drive's", index), ("loudest, A-weighted", loudest)):
        weighted = result.power_level[at] + result.weighting[at]
        values = [result.frequencies[at], result.power_level[at], weighted]
        values += [result.efficiency[at], result.localization_factor[at]]
        rows.append([label, *map(output.number_text, values, (".6g", ".1f", ".1f", ".3g", ".4f"))])
    headings = ("frequency", "Hz", "sound power (dB)", "dB(A)", "radiation efficiency", "localization factor")
    output.print_rows(console, headings, rows)
    levels = zip(result.labels, result.pressure_levels[:, index], strict=True)
    places = [[label, output.number_text(level, ".1f"), output.number_text(level + result.weighting[index], ".1f")]
              for label, level in levels]  # fmt: skip
    output.print_rows(console, ("point (m)", "pressure at the drive's frequency (dB)", "dB(A)"), places)
    output.print_warnings(console, result.warnings)
