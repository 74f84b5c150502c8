"""``warp-plate frf SCENE`` and ``sound``: responses and sound of a linear plate, over frequencies."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    import numpy as np

    from warp_plate.result.frequency_response import CoilResponse, FrequencyResponse
    from warp_plate.result.sound import Sound
    from warp_plate.scene.model import Scene

PICTURES = (".png", ".svg", ".pdf")
ResponseFormat = Literal["csv", "hdf5"]
# Endings and functions that write a result, by format.
Writers = Mapping[str, tuple[str, Callable[[Any, Path], None]]]
NUMBER = r"[-+]?(?:[0-9]{1,30}\.?[0-9]{0,30}|\.[0-9]{1,30})(?:[eE][-+]?[0-9]{1,2})?"
POINT = f"{NUMBER},{NUMBER}"
MOST_ROWS = 20


@Parameter(name="*")
@dataclass(frozen=True)
class ResponseOptions:
    """Options of the responses.

    Attributes:
        inputs: Name of an actuator, or a point X,Y in metres on which 1 N acts; may be repeated (default: all
            actuators, or of impedances all coils).
        at: Point X,Y in metres that responds; may be repeated (default: the scene's record.points, or the middle of
            each target); of sound pressure X,Y,Z, Z above the plate (default: 1 m above the middle of each target).
        range: Lowest and highest frequency in hertz, LOW:HIGH (default: from half the lowest natural frequency, or half
            the drive's frequency if that is lower, to twice the drive's frequency, and at least to the sixth mode).
        quantity: Displacement (receptance), velocity (mobility), acceleration (accelerance) or sound pressure per
            force, sound power under 1 N, radiation efficiency under each force, or the impedance of coils.
        unbaffled: Sound is that of a rectangle without a baffle, open at the back; the power is that of both sides.
    """

    inputs: Annotated[list[str] | None, Parameter(name="--from", negative="", allow_leading_hyphen=True)] = None
    at: Annotated[list[str] | None, Parameter(negative="", allow_leading_hyphen=True)] = None
    range: str | None = None
    quantity: Literal[
        "receptance", "mobility", "accelerance", "impedance", "sound_pressure", "sound_power", "radiation_efficiency"
    ] = "mobility"
    unbaffled: Annotated[bool, Parameter(negative="")] = False


def frf(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    responses: ResponseOptions = ResponseOptions(),
    to: Annotated[list[ResponseFormat] | None, Parameter(negative="")] = None,
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Show responses of a linear plate, its sound, impedances of coils, localization factor and mean square velocity.

    Responses are steady, for a force of 1 N; an actuator spreads it evenly over its patch. Frequencies are spaced so
    that every resonance is resolved, however sharp. They are drawn as a picture (.png, .svg or .pdf).

    Parameters
    ----------
    to
        File with the numbers beside the picture; may be repeated: csv; hdf5, which xarray opens. The ending of --out
        (.csv, .h5) acts as --to.
    """
    from warp_plate.result.frequency_response import WRITERS
    from warp_plate.studies.frequency_response import frf as compute
    from warp_plate.viz.plots.responses import draw_frequency_response

    target = files.target(scene, "-frf.png", endings=(*PICTURES, *(ending for ending, _ in WRITERS.values())))
    formats = formats_of(target, to, WRITERS)
    holds = {"csv": "localization factor [1]", "hdf5": "a frequency response"}
    for name in formats:
        output.check_overwriting(_path_of(target, WRITERS[name][0]), holds[name], files.force)
    listening = ("X,Y,Z", "0.05,0.1,1") if responses.quantity == "sound_pressure" else ()
    points = [_point(text, *listening) for text in responses.at or ()]
    limits = None if responses.range is None else frequency_range(responses.range)
    loaded, scene = changes.load(scene)
    names = {actuator.name for actuator in loaded.actuators}
    sources = [
        text if text in names or not re.fullmatch(POINT, text) else _point(text) for text in responses.inputs or ()
    ]
    with output.scene_errors(scene, inputs="from", points="at", frequency_range="range", quantity="quantity"):
        response = compute(loaded, sources, points, limits, responses.quantity, baffle=not responses.unbaffled)
    write = partial(write_and_draw, response, target, formats, WRITERS, draw_frequency_response, files)
    output.report(files.json, _as_json, _print, scene, loaded, response, write=write)


def _point(text: str, names: str = "X,Y", example: str = "0.05,0.1") -> Any:
    """Return the coordinates of ``--at`` [m], as many as there are names."""
    if re.fullmatch(",".join([NUMBER] * len(names.split(","))), text) is None:
        raise SceneError(f"--at {text}: must be {names} in metres, such as {example}")
    return tuple(map(float, text.split(",")))


def frequency_range(text: str) -> tuple[float, float]:
    """Return the lowest and the highest frequency [Hz] of ``--range``."""
    if re.fullmatch(f"{NUMBER}:{NUMBER}", text):
        low, high = map(float, text.split(":"))
        if 0 < low < high < 1e9:
            return low, high
    raise SceneError(f"--range {text}: must be LOW:HIGH in hertz, 0 < LOW < HIGH, such as 50:5000")


def formats_of(target: Path, to: list[ResponseFormat] | None, writers: Writers) -> list[ResponseFormat]:
    """Return the formats of ``--to``, and that of the ending of ``--out``."""
    by_ending = {ending: name for name, (ending, _) in writers.items()}
    return [*(to or ()), *([by_ending[target.suffix.lower()]] if target.suffix.lower() in by_ending else ())]


def _path_of(target: Path, ending: str) -> Path:
    return target if target.suffix.lower() == ending else target.with_suffix(ending)


def write_and_draw(
    result: Any,
    target: Path,
    formats: list[ResponseFormat],
    writers: Writers,
    draw: Callable[[Any, Path], object],
    files: options.FileOptions,
) -> output.Drawn:
    """Write the files of the formats and the picture, if wanted; return them, and why there is no picture."""
    from warp_plate.viz.plots.frame import save_plots

    saves: dict[Path, Callable[[Path], object]] = {}
    for name in formats:
        ending, write = writers[name]
        saves[_path_of(target, ending)] = partial(write, result)
    ending = target.suffix if target.suffix.lower() in PICTURES else ".png"
    plots = partial(save_plots, partial(draw, result), target, [ending]) if files.pictures else None
    return files.check_drawn(target, output.write_files(saves, plots))


def _as_json(name: str, scene: Scene, response: FrequencyResponse) -> dict[str, object]:
    return {
        **output.attributes(response, "quantity", "unit", "frequencies"),
        "pairs": [{"from": name, "at": point} for name, point in response.pairs],
        "real": response.responses.real,
        "imaginary": response.responses.imag,
        "inputs": response.inputs,
        **({"level": response.level(abs(response.responses))} if response.level_unit else {}),
        **output.attributes(response, "localization_factor", "bound", "mean_square_velocity"),
        **output.attributes(response, "natural_frequencies", "loss_factors", "undamped"),
        "errors": dataclasses.asdict(response.errors),
        **({} if response.coils is None else {"coils": _coils_as_json(response.coils)}),
    }


def _coils_as_json(coils: CoilResponse) -> dict[str, object]:
    """Return the motion of coils, complex numbers as their real and imaginary parts."""
    parts: dict[str, object] = {"names": coils.names}
    for name in ("voltage", "current", "stroke"):
        values = getattr(coils, name)
        parts[name] = {"real": values.real, "imaginary": values.imag}
    return parts | output.attributes(coils, "electrical_power", "mechanical_power")


def _print(name: str, scene: Scene, response: FrequencyResponse, console: Console) -> None:
    import numpy as np

    low, high, count = response.frequencies[0], response.frequencies[-1], len(response.natural_frequencies)
    quantity = response.quantity.replace("_", " ")
    console.print(
        f"{scene.title or name}: {quantity} at {len(response.frequencies)} frequencies from {low:g} to {high:g} Hz, "
        f"{count} modes\n"
    )
    peaks, errors, real = [], response.errors, response.of_plate
    for index in response.distinct[:MOST_ROWS]:
        label, values = response.labels[index], response.responses[index]
        at = int(np.nan_to_num(np.abs(values)).argmax())
        of_value, of_frequency = errors.responses[index, at] / abs(values[at] or 1), errors.frequencies[at]
        phase, frequency = np.degrees(np.angle(values[at])), response.frequencies[at]
        numbers = [abs(values[at]), 100 * of_value, frequency, 100 * of_frequency, *([phase] * (not real))]
        numbers += [float(response.level(numbers[0]))] if response.level_unit else []
        peaks.append([label, *map(output.number_text, numbers, (".4g", ".2g", ".6g", ".2g", ".1f", ".1f"))])
    last = [*["phase (°)"] * (not real), *[f"level ({response.level_unit})"] * bool(response.level_unit)]
    output.print_rows(console, ["response", f"largest ({response.unit})", "± (%)", "at (Hz)", "± (%)", *last], peaks)
    if len(response.distinct) > MOST_ROWS:
        console.print(f"and {len(response.distinct) - MOST_ROWS} more, in the files of --to and in --json")
    if response.coils is not None and scene.drive.frequency in response.frequencies:
        at, coils = int(np.searchsorted(response.frequencies, scene.drive.frequency)), response.coils
        columns = (abs(coils.voltage), abs(coils.current), coils.electrical_power, coils.mechanical_power)
        numbers = np.transpose([values[:, at] for values in (*columns, 1e3 * abs(coils.stroke))]).tolist()
        console.print(f"\nCoils under the scene's drive at {scene.drive.frequency:g} Hz (peaks, and mean powers):\n")
        headings = ("coil", "voltage (V)", "current (A)", "electrical (W)", "mechanical (W)", "stroke (mm)")
        rows = [[name, *(f"{number:.4g}" for number in row)] for name, row in zip(coils.names, numbers, strict=True)]
        output.print_rows(console, headings, rows)
    best, of_drive = int(np.nanargmax(response.bound)), np.nanmax(errors.localization_factor, initial=0)
    console.print(
        f"\nLocalization factor of the scene's drive: {_extremes(response.localization_factor)}, with errors of at "
        f"most {of_drive:.2g}; the best drive at each frequency reaches up to {response.bound[best]:.4f} ± "
        f"{errors.bound[best]:.2g}, at {response.frequencies[best]:.6g} Hz. Errors hold for curves whose resonances "
        f"are shifted, by at most {100 * errors.frequencies.max():.2g} %."
    )
    output.print_warnings(console, response.warnings)


def _extremes(values: np.ndarray) -> str:
    finite = [value for value in values.tolist() if math.isfinite(value)]
    return f"{min(finite):.4f} to {max(finite):.4f}" if finite else "none (no motion)"


@Parameter(name="*")
@dataclass(frozen=True)
class SoundOptions:
    """Options of the sound.

    Attributes:
        at: Point X,Y,Z in metres in front of the plate, Z above it; may be repeated (default: 1 m above the middle of
            each target).
        range: Lowest and highest frequency in hertz, LOW:HIGH (default: as of frf).
        unbaffled: The plate is a rectangle without a baffle, open at the back; the power is that of both sides.
    """

    at: Annotated[list[str] | None, Parameter(negative="", allow_leading_hyphen=True)] = None
    range: str | None = None
    unbaffled: Annotated[bool, Parameter(negative="")] = False


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

    The plate vibrates in a rigid baffle in free air at 20 °C and radiates to one side, unless --unbaffled; the sound
    acts on it only in scenes with [effects.air].

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
    holds = {"csv": "sound power [W]", "hdf5": "a sound"}
    for name in formats:
        output.check_overwriting(_path_of(target, WRITERS[name][0]), holds[name], files.force)
    points = [_point(text, "X,Y,Z", "0.05,0.1,1") for text in sounds.at or ()]
    limits = None if sounds.range is None else frequency_range(sounds.range)
    loaded, scene = changes.load(scene)
    with output.scene_errors(scene, points="at", frequency_range="range"):
        result = compute(loaded, points, limits, baffle=not sounds.unbaffled)
    write = partial(write_and_draw, result, target, formats, WRITERS, draw_sound, files)
    output.report(files.json, _sound_as_json, _print_sound, scene, result, write=write)


def _sound_as_json(name: str, result: Sound) -> dict[str, object]:
    arrays = ("frequencies", "power", "power_level", "weighting", "efficiency", "localization_factor", "points")
    return {
        **output.attributes(result, "drive_frequency", *arrays, "pressure_levels"),
        "real": result.pressures.real,
        "imaginary": result.pressures.imag,
        **output.attributes(result, "natural_frequencies", "loss_factors", "angles", "directivity"),
    }


def _print_sound(name: str, result: Sound, console: Console) -> None:
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
