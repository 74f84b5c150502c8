"""``warp-plate export RESULT``: a result in the formats of other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from warp_plate.cli import motion_options, options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.export.time_series import Encoding
    from warp_plate.result.model import Case, Result

Format = Literal["pvd", "vtkhdf", "traces-csv", "drive-wav", "drive-csv"]
# Ending that is added to the result's name, and options beside --case.
SERIES, SIGNAL = ("start", "end", "frames", "device"), ("rate", "duration", "full-scale")
FORMATS: dict[Format, tuple[str, tuple[str, ...]]] = {
    "pvd": (".pvd", SERIES),
    "vtkhdf": (".vtkhdf", SERIES),
    "traces-csv": ("-traces.csv", ()),
    "drive-wav": ("-drive.wav", (*SIGNAL, "encoding")),
    "drive-csv": ("-drive.csv", SIGNAL),
}
# With fewer times than this ParaView shows pictures rather than a motion.
FEW_TIMES = 10


def export(
    result: options.ResultFile,
    /,
    *,
    to: Format,
    shown: motion_options.FrameOptions = motion_options.DEFAULT_FRAMES,
    rate: int | None = None,
    duration: float | None = None,
    full_scale: float | None = None,
    encoding: Literal["float32", "pcm16", "pcm24"] | None = None,
    out: Path | None = None,
    json: options.Json = False,
) -> None:
    """Write a result for ParaView, a spreadsheet or the amplifier. (MATLAB can read the result file directly.)

    For a file written by focus, drive-wav and drive-csv write the waveforms of --case METHOD, one file per point.

    --start, --end, --frames and --device are for pvd and vtkhdf: they run the scene again and write displacements and
    velocities at evenly spaced times instead of the recorded displacements.

    Parameters
    ----------
    to
        pvd: a time series for ParaView, a .pvd index with a .vti file for each time; vtkhdf: the same as one file;
        traces-csv: displacement at the scene's record.points; drive-wav, drive-csv: a channel for each actuator over a
        whole number of periods, of the best drive unless --case names another.
    rate
        drive-wav and drive-csv: samples a second (default: 48000).
    duration
        drive-wav and drive-csv: longest duration in seconds (default: 1).
    full_scale
        drive-wav and drive-csv: pressure in N/m² (or voltage) that 1.0 stands for (default: the drive's largest
        magnitude).
    encoding
        drive-wav: float32 (default), pcm16 or pcm24.
    out
        The file to write (default: RESULT with another ending, in this folder).
    """
    ending, known = FORMATS[to]
    target = output.output_file(out, f"{result.stem}{ending}")
    series = {name: getattr(shown, name) for name in SERIES}
    signal = {"rate": rate, "duration": duration, "full-scale": full_scale, "encoding": encoding}
    for name, value in {**series, **signal}.items():
        if value is not None and name not in known:
            raise SceneError(f"--{name} {value}: has no effect with --to {to}; leave it out")
    if shown.device is not None and shown.start is shown.end is shown.frames is None:
        raise SceneError(f"--device {shown.device}: nothing is run without --frames, --start or --end; leave it out")
    from warp_plate.result.hdf5 import describe_file
    from warp_plate.result.model import load_result

    if describe_file(result) == "a focus":
        if to not in ("drive-wav", "drive-csv") or (name := next((key for key in SIGNAL[:2] if signal[key]), "")):
            what = f"--to {to}" if to not in ("drive-wav", "drive-csv") else f"--{name} {signal[name]}"
            raise SceneError(
                f"{what}: {result} has waveforms of a given rate and duration, for drive-wav and drive-csv"
            )
        files, record = _write_waveforms(result, shown.case or [], target, full_scale, encoding)
        answer = {"result": result, "to": to, **record, "files": files}
        line = f"{record['case']}: 1.0 stands for {record['full_scale']:.6g} {record['unit']} in every channel"
        return output.report(json, lambda: answer, lambda console: console.print(line), (files, None))
    loaded = load_result(result)
    cases = motion_options.select_cases(loaded, result, shown.case)
    try:
        if to == "drive-wav" or to == "drive-csv":
            if shown.case and len(cases) > 1:
                raise SceneError(f"--case {' '.join(shown.case)}: a file holds one drive; name one case")
            name = "best" if "best" in cases else next(iter(cases))
            files, record = _write_drive(loaded, cases[name], to, target, signal)
            record = {"case": name, **record}
        elif to == "traces-csv":
            from warp_plate.result.export.time_series import write_traces

            files, record = write_traces(loaded, cases, target), {}
        else:
            # ParaView begins with the first field, so the best case comes first.
            names = sorted(cases, key=lambda name: name != "best")
            files, record = _write_series(loaded, result, replace(shown, case=names), to, target, json)
    except SceneError as error:
        named = str(error).startswith(("--", f"{target}:", f"{result}:"))
        raise error if named else SceneError(f"{result}: {error}") from None
    answer = {"result": result, "to": to, **record, "files": files}
    output.report(json, lambda: answer, lambda _: _print(files, to, record))


def _write_series(
    result: Result, file: Path, options: motion_options.FrameOptions, to: Format, target: Path, quiet: bool
) -> tuple[list[Path], dict[str, Any]]:
    """Write the recorded displacements, or those of another run if the options ask for one; return files and record."""
    from warp_plate.result.export.paraview import write_pvd, write_vtkhdf

    names = options.case or []
    recorded = options.start is None and options.end is None and options.frames is None
    if recorded:
        times = result.times
        fields = {f"displacement_{case}": result.cases[case].displacement for case in names}
    else:
        motions = motion_options.select_motions(result, file, options, motion_options.DEFAULT_PLAYBACK, quiet)
        times, fields = motions[0].times, {f"displacement_{motion.name}": motion.displacement for motion in motions}
        fields |= {f"velocity_{motion.name}": motion.velocity for motion in motions}
    # Actuators are drawn at their positions in the first case.
    scene = result.case_scene(result.cases[names[0]])
    files = (write_pvd if to == "pvd" else write_vtkhdf)(scene, times, fields, target)
    return files, {"times": len(times), "recorded": recorded, "fields": list(fields)}


def _write_drive(
    result: Result, case: Case, to: Format, target: Path, options: Mapping[str, Any]
) -> tuple[list[Path], dict[str, Any]]:
    """Write the drive of a case as audio or text; return files and record."""
    from warp_plate.result.export.time_series import make_drive_signal, write_drive_csv, write_wav

    rate, duration, full_scale = (options[name] for name in SIGNAL)
    duration = 1.0 if duration is None else duration
    signal = make_drive_signal(result.case_scene(case), case, 48000 if rate is None else rate, duration, full_scale)
    if to == "drive-wav":
        files = write_wav(signal, target, options["encoding"] or "float32")
    else:
        files = write_drive_csv(signal, target)
    return files, {
        **output.attributes(signal, "frequency", "rate", "samples", "periods", "full_scale", "unit"),
        "channels": signal.names,
        "seconds": signal.samples / signal.rate,
        "seam_degrees": signal.seam,
    }


def _write_waveforms(
    file: Path, methods: list[str], target: Path, full_scale: float | None, encoding: Encoding | None
) -> tuple[list[Path], dict[str, Any]]:
    """Write the waveforms of a method for each point of a file of ``focus``; return files and record."""
    from warp_plate.result.export.time_series import WaveformSignal, write_drive_csv, write_wav
    from warp_plate.result.focus import load_focus

    found = load_focus(file)
    table, unit = found.scene.focus, found.scene.drive_unit
    assert table is not None
    name = methods[0] if methods else "optimum" if table.burst is None else "inverse_filter"
    if len(methods) > 1 or name not in found.methods:
        raise SceneError(f"--case {' '.join(methods)}: name one of {', '.join(found.methods)}")
    waveforms = found.methods[name].waveforms
    largest = float(abs(waveforms).max())
    full_scale = largest if full_scale is None else full_scale
    if not 0 < largest <= full_scale < float("inf"):
        raise SceneError(f"--full-scale {full_scale:g}: must be at least the largest drive, {largest!r} {unit}")
    names, files = tuple(actuator.name for actuator in found.scene.actuators), []
    for index, ((x, y), each) in enumerate(zip(table.points, waveforms, strict=True), 1):
        path = target if len(table.points) == 1 else target.with_name(f"{target.stem}-{index}{target.suffix}")
        signal = WaveformSignal(names, each, full_scale, table.rate, f"{name} at {x:g},{y:g} m")
        wav = target.suffix.lower() == ".wav"
        files += write_wav(signal, path, encoding or "float32") if wav else write_drive_csv(signal, path)
    return files, {"case": name, "rate": table.rate, "full_scale": full_scale, "unit": unit, "channels": names}


def _print(files: list[Path], to: Format, record: Mapping[str, Any]) -> None:
    print(f"wrote {files[-1]}" + (f" and {len(files) - 1} .vti files beside it" if to == "pvd" else ""))
    if to in ("pvd", "vtkhdf") and record["recorded"] and record["times"] < FEW_TIMES:
        print(f"It holds the {record['times']} recorded times; --frames 60 writes a motion of 60 frames a period.")
    if to in ("drive-wav", "drive-csv"):
        jump = f"with a phase jump of {record['seam_degrees']:.2g} degrees" if record["seam_degrees"] else "seamlessly"
        print(
            f"Drive {record['case']}: {record['periods']} periods of {record['frequency']:g} Hz in "
            f"{record['samples']} samples at {record['rate']} Hz, which repeat {jump}. 1.0 stands for "
            f"{record['full_scale']:.6g} {record['unit']} in every channel."
        )
