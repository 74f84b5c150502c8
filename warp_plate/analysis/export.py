"""Results in the formats of other programs: ParaView, spreadsheets, the amplifier."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from warp_plate.analysis.motion import motions
from warp_plate.result.case import Case
from warp_plate.result.export import (
    Encoding,
    Format,
    WaveformSignal,
    full_scale_of,
    make_drive_signal,
    write_drive_csv,
    write_traces,
    write_vtkhdf,
    write_wav,
)
from warp_plate.result.focus import FocusResult
from warp_plate.result.model import Result
from warp_plate.scene.errors import SceneError, check_type, printable
from warp_plate.solve.run import Progress

DRIVES: tuple[Format, ...] = ("drive-wav", "drive-csv")


@dataclass(frozen=True)
class Exported:
    """Files that were written.

    Attributes:
        files: Paths of the files.
        contents: Numbers and names of what the files hold, such as the full scale of drive signals.
    """

    files: list[Path]
    contents: dict[str, Any]


def export(
    result: Result | FocusResult,
    path: str | Path,
    to: Format,
    *,
    cases: Sequence[str] = (),
    span: tuple[float, float] | None = None,
    frames: int | None = None,
    device: str = "auto",
    rate: int | None = None,
    duration: float | None = None,
    full_scale: float | None = None,
    encoding: Encoding = "float32",
    progress: Progress | None = None,
) -> Exported:
    """Write a result for ParaView, a spreadsheet or the amplifier.

    Args:
        result: Result of ``localize`` or ``simulate``; or of ``focus``, whose waveforms are written, a file per point.
        path: File to write.
        to: "vtkhdf": fields for ParaView; "traces-csv": displacement at the recorded points; "drive-wav" or
            "drive-csv": the drive signals, a channel for each actuator.
        cases: Names of cases, or of a method of ``focus`` (default: all for fields and traces, the best drive).
        span: Start and end [s] of fields from another run (default: the recorded displacements; with ``frames`` the
            last period of the drive).
        frames: Number of frames of fields from another run.
        device: Device of that run.
        rate: Samples per second of a drive signal (default: 48000).
        duration: Longest duration of a drive signal [s] (default: 1); it holds a whole number of periods.
        full_scale: Drive that 1.0 stands for [``Scene.drive_unit``] (default: the largest magnitude).
        encoding: Sample format of WAV files.
        progress: See :meth:`PlateSolver.run`.

    Raises:
        SceneError: Unknown case, nothing recorded, a drive that does not repeat, or a file that cannot be written.
    """
    check_type("result", result, Result, FocusResult)
    check_type("path", path, str, Path)
    path = Path(path)
    if to not in get_args(Format):
        raise SceneError(f"to = {to!r}: must be one of {', '.join(get_args(Format))}")
    if encoding not in get_args(Encoding):
        raise SceneError(f"encoding = {encoding!r}: must be one of {', '.join(get_args(Encoding))}")
    if isinstance(result, FocusResult):
        if to not in DRIVES:
            raise SceneError(f"to = {to!r}: waveforms of focus are written as drive-wav or drive-csv")
        for name, value in {"rate": rate, "duration": duration}.items():
            if value is not None:
                raise SceneError(f"{name} = {value:g}: waveforms of focus have a rate and a duration; leave it out")
        return _export_waveforms(result, path, to, cases, full_scale, encoding)
    chosen = result.select_cases(cases or tuple(result.cases))
    if to in DRIVES:
        if len(cases) > 1:
            raise SceneError(f"case = {' '.join(cases)}: a file holds one drive; name one case")
        name = "best" if "best" in chosen else next(iter(chosen))
        rate, duration = 48000 if rate is None else rate, 1.0 if duration is None else duration
        signal = make_drive_signal(result.case_scene(chosen[name]), chosen[name], rate, duration, full_scale)
        files = write_wav(signal, path, encoding) if to == "drive-wav" else write_drive_csv(signal, path)
        names = ("frequency", "rate", "samples", "periods", "full_scale", "unit")
        contents = {"case": name, **{key: getattr(signal, key) for key in names}, "channels": signal.names}
        contents |= {"seconds": signal.samples / signal.rate, "seam_degrees": signal.seam}
        return Exported(files, contents)
    if to == "traces-csv":
        return Exported(write_traces(result, chosen, path), {})
    return _export_fields(result, chosen, path, to, span, frames, device, progress)


def _export_fields(
    result: Result, cases: Mapping[str, Case], path: Path, to: Format,
    span: tuple[float, float] | None, frames: int | None, device: str, progress: Progress | None,
) -> Exported:  # fmt: skip
    """Write the recorded displacements, or displacements and velocities of another run."""
    # ParaView begins with the first field, so the best case comes first.
    cases = {printable(name): cases[name] for name in sorted(cases, key=lambda name: name != "best")}
    recorded = span is None and frames is None
    if recorded:
        times, fields = result.times, {f"displacement_{name}": case.displacement for name, case in cases.items()}
    else:
        moving = motions(result.scene, cases, span, frames, device, progress)
        times = moving[0].times
        fields = {f"displacement_{motion.name}": motion.displacement for motion in moving}
        fields |= {f"velocity_{motion.name}": motion.velocity for motion in moving}
        fields |= {f"rms_velocity_{motion.name}": motion.rms_velocity[None] for motion in moving}
    # Actuators are drawn at their positions in the first case.
    scene = result.case_scene(next(iter(cases.values())))
    files = write_vtkhdf(scene, times, fields, path)
    return Exported(files, {"times": len(times), "recorded": recorded, "fields": list(fields)})


def _export_waveforms(
    result: FocusResult, path: Path, to: Format, methods: Sequence[str], full_scale: float | None, encoding: Encoding
) -> Exported:
    """Write the waveforms of a method for each point."""
    table, unit = result.scene.focus, result.scene.drive_unit
    assert table is not None
    name = methods[0] if methods else "optimum" if table.burst is None and result.wished is None else "inverse_filter"
    if len(methods) > 1 or name not in result.methods:
        raise SceneError(f"case = {' '.join(methods)}: name one of {', '.join(result.methods)}")
    waveforms = result.methods[name].waveforms
    largest = float(abs(waveforms).max())
    full_scale = full_scale_of(full_scale, largest, unit)
    names, files = tuple(actuator.name for actuator in result.scene.actuators), []
    for index, ((x, y), waveform) in enumerate(zip(table.points, waveforms, strict=True), 1):
        file = path if len(table.points) == 1 else path.with_name(f"{path.stem}-{index}{path.suffix}")
        signal = WaveformSignal(
            names, full_scale, unit, table.rate, waveform.shape[1], f"{name} at {x:g},{y:g} m", waveform
        )
        files += write_wav(signal, file, encoding) if to == "drive-wav" else write_drive_csv(signal, file)
    contents = {"case": name, "rate": table.rate, "full_scale": full_scale, "unit": unit, "channels": names}
    return Exported(files, contents)
