"""``warp-plate export RESULT``: a result in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.cli.moving import Choice, chosen_cases, chosen_motions
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from warp_plate.result.export.drive_signals import Encoding, Signal
    from warp_plate.result.model import Case, Result

Format = Literal["pvd", "vtkhdf", "traces-csv", "drive-wav", "drive-csv"]
# What is added to the result's name.
ENDINGS: dict[Format, str] = {
    "pvd": ".pvd",
    "vtkhdf": ".vtkhdf",
    "traces-csv": "-traces.csv",
    "drive-wav": "-drive.wav",
    "drive-csv": "-drive.csv",
}
# Samples a second, and seconds, when nothing is said.
RATE, DURATION = 48000, 1.0
# Of fewer times than this ParaView shows pictures, not a motion.
FEW_TIMES = 10


def export(
    result: Path,
    /,
    *,
    to: Format,
    case: list[str] | None = None,
    start: float | None = None,
    end: float | None = None,
    frames: int | None = None,
    device: str | None = None,
    rate: int | None = None,
    duration: float | None = None,
    full_scale: float | None = None,
    encoding: Literal["float32", "pcm16"] | None = None,
    out: Path | None = None,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Write a result for ParaView, a spreadsheet or the amplifier. (MATLAB reads the result file itself.)

    Parameters
    ----------
    result
        An .h5 file that localize or simulate wrote.
    to
        pvd: a time series for ParaView, a .pvd index with a .vti file for each time; vtkhdf: the same as one file;
        traces-csv: displacement at the scene's record.points; drive-wav, drive-csv: a channel for each actuator,
        over a whole number of periods.
    case
        equal, single, best or drive; give it again for more. Left out: all cases; for a drive the best one.
    start, end
        Of pvd and vtkhdf: run the scene again and take even times between these, in seconds, instead of those that it
        records; velocities are written too. When only frames are given, the last
        period of the drive, or of a drive that does not repeat the first burst, else the scene's window.
    frames
        How many between them; 60 a period, or as many as there are steps, when left out.
    device
        Where they run: cpu, cuda, cuda:1, ...; a CUDA device where there is one when left out.
    rate
        Of drive-wav and drive-csv: samples a second; 48000 when left out.
    duration
        Of the same: at most so many seconds; 1 when left out.
    full_scale
        Of the same: the pressure in N/m² (or the voltage) that 1.0 stands for; the drive's largest magnitude when left
        out.
    encoding
        Of drive-wav: float32 (when left out) or pcm16.
    out
        The file to write; RESULT with another ending, in this folder, when left out.
    json
        Print one JSON object instead of lines.
    """
    target = _target(out, result, to)
    again = {"start": start, "end": end, "frames": frames, "device": device}
    sound = {"rate": rate, "duration": duration, "full-scale": full_scale, "encoding": encoding}
    _refuse_unused(to, {**again, **sound})
    if device is not None and start is end is frames is None:
        raise SceneError(f"--device {device}: nothing is run without --frames, --start or --end; leave it out")
    from warp_plate.result import load_result

    loaded = load_result(result)
    cases = chosen_cases(loaded, result, case or [])
    told: dict[str, Any] = {}
    try:
        if to == "drive-wav" or to == "drive-csv":
            name = _one_drive(cases, case)
            signal = _signal(loaded, cases[name], rate, duration, full_scale)
            files = _write_signal(signal, to, target, encoding or "float32")
            told = {"case": name, **_signal_record(signal)}
        elif to == "traces-csv":
            from warp_plate.result.export.traces import write_traces

            files = write_traces(loaded, cases, target)
        else:
            # The best first: ParaView begins with the first field.
            names = sorted(cases, key=lambda name: name != "best")
            choice = Choice(names, 0, start, end, frames, device or "auto")
            files, told = _write_series(loaded, result, choice, to, target, json)
    except SceneError as error:
        # Options and files have their names in the line already.
        named = str(error).startswith(("--", f"{target}:", f"{result}:"))
        raise error if named else SceneError(f"{result}: {error}") from None
    if json:
        output.print_json({"result": str(result), "to": to, **told, "files": [str(file) for file in files]})
        return
    print(f"wrote {files[-1]}" + (f" and {len(files) - 1} .vti files beside it" if to == "pvd" else ""))
    for line in _lines(to, told):
        print(line)


def _target(out: Path | None, result: Path, to: Format) -> Path:
    path = out or Path(f"{result.stem}{ENDINGS[to]}")
    ending = Path(f"x{ENDINGS[to]}").suffix
    if path.suffix != ending:
        raise SceneError(f"--out {path}: must end in {ending}")
    output.refuse_place(path)
    return path


def _refuse_unused(to: Format, options: Mapping[str, object]) -> None:
    """Raise SceneError for an option that this format does not read."""
    series, signal = {"start", "end", "frames", "device"}, {"rate", "duration", "full-scale"}
    read = {"pvd": series, "vtkhdf": series, "drive-wav": {*signal, "encoding"}, "drive-csv": signal}.get(to, set())
    for name, value in options.items():
        if value is not None and name not in read:
            raise SceneError(f"--{name} {value}: --to {to} does not read it; leave it out")


def _write_series(
    result: Result, name: Path, choice: Choice, to: Format, target: Path, quiet: bool
) -> tuple[list[Path], dict[str, Any]]:
    """The files of the times that are recorded, or of another run where the options ask for one; and what is told."""
    from warp_plate.result.export.paraview import write_pvd, write_vtkhdf

    recorded = choice.start is None and choice.end is None and choice.frames is None
    if recorded:
        times, fields = result.times, {f"displacement_{case}": result.cases[case].displacement for case in choice.cases}
    else:
        motions = chosen_motions(result, name, choice, "displacement", quiet)
        times, fields = motions[0].times, {f"displacement_{motion.name}": motion.displacement for motion in motions}
        fields |= {f"velocity_{motion.name}": motion.velocity for motion in motions}
    # The actuators are shown where the first case has them.
    scene = result.case_scene(result.cases[choice.cases[0]])
    files = (write_pvd if to == "pvd" else write_vtkhdf)(scene, times, fields, target)
    return files, {"times": len(times), "recorded": recorded, "fields": list(fields)}


def _one_drive(cases: Mapping[str, Case], asked: list[str] | None) -> str:
    """The case to play."""
    if asked and len(cases) > 1:
        raise SceneError(f"--case {' '.join(asked)}: a file plays one drive; name one case")
    return "best" if "best" in cases else next(iter(cases))


def _signal(result: Result, case: Case, rate: int | None, duration: float | None, full_scale: float | None) -> Signal:
    from warp_plate.result.export.drive_signals import make_signal

    rate = RATE if rate is None else rate
    return make_signal(result.case_scene(case), case, rate, DURATION if duration is None else duration, full_scale)


def _write_signal(signal: Signal, to: Format, target: Path, encoding: Encoding) -> list[Path]:
    from warp_plate.result.export.drive_signals import write_drive_csv, write_wav

    return write_wav(signal, target, encoding) if to == "drive-wav" else write_drive_csv(signal, target)


def _signal_record(signal: Signal) -> dict[str, object]:
    return {
        "channels": list(signal.names),
        "frequency": signal.frequency,
        "rate": signal.rate,
        "samples": signal.samples,
        "periods": signal.periods,
        "seconds": signal.samples / signal.rate,
        "seam_degrees": signal.seam,
        "full_scale": signal.full_scale,
        "unit": signal.unit,
    }


def _lines(to: Format, told: Mapping[str, Any]) -> list[str]:
    """What is said below the files."""
    if to in ("pvd", "vtkhdf"):
        line = "It holds the {times} recorded times; --frames 60 takes so many of a period, for a motion."
        return [line.format_map(told)] if told["recorded"] and told["times"] < FEW_TIMES else []
    if to == "traces-csv":
        return []
    seam = "without a seam" if told["seam_degrees"] == 0 else f"with a phase jump of {told['seam_degrees']:.2g} degrees"
    return [
        f"Drive {told['case']}: {told['periods']} periods of {told['frequency']:g} Hz in {told['samples']} samples at "
        f"{told['rate']} Hz, which repeat {seam}. 1.0 stands for {told['full_scale']:.6g} {told['unit']} in "
        "every channel."
    ]
