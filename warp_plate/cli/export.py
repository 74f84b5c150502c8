"""``warp-plate export RESULT``: a result in the formats of other programs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cyclopts import Parameter

from warp_plate.cli import options, output
from warp_plate.cli.render import FRAME_ARGUMENTS, FrameOptions, span_of
from warp_plate.scene.errors import SceneError, printable

Format = Literal["vtkhdf", "traces-csv", "drive-wav", "drive-csv"]
# Ending that is added to the result's name, and options beside --case.
SERIES, SIGNAL = ("start", "end", "frames", "device"), ("rate", "duration", "full-scale")
FORMATS: dict[Format, tuple[str, tuple[str, ...]]] = {
    "vtkhdf": (".vtkhdf", SERIES),
    "traces-csv": ("-traces.csv", ()),
    "drive-wav": ("-drive.wav", (*SIGNAL, "encoding")),
    "drive-csv": ("-drive.csv", SIGNAL),
}
# With fewer times than this ParaView shows pictures rather than a motion.
FEW_TIMES = 10


@Parameter(name="*")
@dataclass(frozen=True)
class SignalOptions:
    """Options of drive files.

    Attributes:
        rate: drive-wav and drive-csv: samples a second (default: 48000).
        duration: drive-wav and drive-csv: longest duration in seconds (default: 1).
        full_scale: drive-wav and drive-csv: force in N that 1.0 stands for, if the scene gives a force for every
            actuator; else pressure in N/m² or voltage (default: the drive's largest).
        encoding: drive-wav: float32 (default), pcm16 or pcm24.
    """

    rate: options.Integer | None = None
    duration: float | None = None
    full_scale: float | None = None
    encoding: Literal["float32", "pcm16", "pcm24"] | None = None


def export(
    result: options.ResultFile,
    /,
    *,
    to: Format,
    shown: FrameOptions = FrameOptions(),
    signal: SignalOptions = SignalOptions(),
    out: Path | None = None,
    json: options.Json = False,
) -> None:
    """Write a result for ParaView, a spreadsheet or the amplifier. (MATLAB can read the result file directly.)

    For a file written by focus, drive-wav and drive-csv write the waveforms of --case METHOD, one file per point.

    --start, --end, --frames and --device are for vtkhdf: they run the scene again and write displacements and
    velocities at evenly spaced times instead of the recorded displacements.

    Parameters
    ----------
    to
        vtkhdf: a time series for ParaView 5.12 and later;
        traces-csv: displacement at the scene's record.points; drive-wav, drive-csv: a channel for each actuator over a
        whole number of periods, of the best drive unless --case names another.
    out
        The file to write (default: RESULT with another ending, in this folder).
    """
    from warp_plate.analysis.export import export as export_result
    from warp_plate.result.focus import FocusResult, load_focus
    from warp_plate.result.hdf5 import describe_file
    from warp_plate.result.model import Result, load_result

    target = output.output_file(out, f"{result.stem}{FORMATS[to][0]}")
    given = {name: value for name, value in vars(signal).items() if value is not None}
    for name, value in {**output.attributes(shown, *SERIES), **given}.items():
        name = name.replace("_", "-")
        if value is not None and name not in FORMATS[to][1]:
            raise SceneError(f"--{name} {value}: has no effect with --to {to}; leave it out")
    if shown.device is not None and shown.start is shown.end is shown.frames is None:
        raise SceneError(f"--device {shown.device}: nothing is run without --frames, --start or --end; leave it out")
    loaded: Result | FocusResult
    if describe_file(result) == "a focus":
        loaded, span = load_focus(result), None
    else:
        loaded = load_result(result)
        span = span_of(shown, loaded.scene.window.end)
    given |= {name: value for name in ("frames", "device") if (value := getattr(shown, name)) is not None}
    with output.scene_errors(result, **FRAME_ARGUMENTS), output.progress_bar("simulating", shown=not json) as show:
        exported = export_result(loaded, target, to, cases=shown.case or (), span=span, progress=show, **given)
    answer = {"result": result, "to": to, **exported.contents}
    output.report(json, lambda: answer, lambda _: _print(to, exported.contents), write=lambda: (exported.files, None))


def _print(to: Format, record: Mapping[str, Any]) -> None:
    case = printable(str(record.get("case")))
    if to == "vtkhdf" and record["recorded"] and record["times"] < FEW_TIMES:
        print(f"It has the {record['times']} recorded times; --frames 60 writes a motion of 60 frames a period.")
    if "periods" in record:
        jump = f"with a phase jump of {record['seam_degrees']:.2g} degrees" if record["seam_degrees"] else "seamlessly"
        print(
            f"Drive {case}: {record['periods']} periods of {record['frequency']:g} Hz in "
            f"{record['samples']} samples at {record['rate']} Hz, which repeat {jump}. 1.0 stands for "
            f"{record['full_scale']:.6g} {record['unit']} in every channel."
        )
    elif "full_scale" in record:
        print(f"{case}: 1.0 stands for {record['full_scale']:.6g} {record['unit']} in every channel")
