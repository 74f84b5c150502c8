"""``warp-plate export RESULT``: a result in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from warp_plate.result.model import Case, Result
    from warp_plate.result.signals import Encoding, Signal

Format = Literal["pvd", "vtkhdf", "traces-csv", "drive-wav", "drive-csv"]
# What is added to the result's name.
ENDINGS: dict[Format, str] = {
    "pvd": ".pvd",
    "vtkhdf": ".vtkhdf",
    "traces-csv": "-traces.csv",
    "drive-wav": "-drive.wav",
    "drive-csv": "-drive.csv",
}
# Of fewer times than this ParaView shows pictures, not a motion.
FEW_TIMES = 10


def export(
    result: Path,
    /,
    *,
    to: Format,
    case: str | None = None,
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
        pvd: displacements as a time series for ParaView, a .pvd index with a .vti file for each time; vtkhdf: the same
        as one file; traces-csv: displacement at the scene's record.points; drive-wav, drive-csv: a channel for each
        actuator, over a whole number of periods.
    case
        equal, single, best or drive. Left out: all cases; for a drive the best one.
    rate
        Of drive-wav and drive-csv: samples a second; 48000 when left out.
    duration
        Of the same: at most so many seconds; 1 when left out.
    full_scale
        Of the same: the pressure in N/m² that 1.0 stands for; the drive's largest magnitude when left out.
    encoding
        Of drive-wav: float32 (when left out) or pcm16.
    out
        The file to write; RESULT with another ending, in this folder, when left out.
    json
        Print one JSON object instead of lines.
    """
    target = _target(out, result, to)
    _refuse_unused(to, {"rate": rate, "duration": duration, "full-scale": full_scale, "encoding": encoding})
    from warp_plate.result import load_result

    loaded = load_result(result)
    told: dict[str, object] = {}
    try:
        cases = _cases(loaded, case)
        if to in ("pvd", "vtkhdf", "traces-csv"):
            files = _write_record(loaded, cases, to, target)
        else:
            name = case or ("best" if "best" in cases else next(iter(cases)))
            from warp_plate.result.signals import make_signal

            signal = make_signal(
                loaded.scene,
                cases[name],
                48000 if rate is None else rate,
                1.0 if duration is None else duration,
                full_scale,
            )
            files = _write_signal(signal, to, target, encoding or "float32")
            told = {"case": name, **_signal_record(signal)}
    except SceneError as error:
        # Options and files to be written are named by the line itself.
        line = str(error)
        raise error if line.startswith(("--", str(target))) else SceneError(f"{result}: {line}") from None
    if json:
        output.print_json({"result": str(result), "to": to, **told, "files": [str(file) for file in files]})
        return
    for file in (files[-1],) if to == "pvd" else files:
        print(f"wrote {file}" + (f" and {len(files) - 1} .vti files beside it" if to == "pvd" else ""))
    if told:
        print(_signal_line(told))
    elif to != "traces-csv" and loaded.times.size < FEW_TIMES:
        print(f"It holds {loaded.times.size} times; for a motion write more into record.times of the scene.")


def _target(out: Path | None, result: Path, to: Format) -> Path:
    path = out or Path(f"{result.stem}{ENDINGS[to]}")
    ending = Path(f"x{ENDINGS[to]}").suffix
    if path.suffix != ending:
        raise SceneError(f"--out {path}: must end in {ending}")
    if not path.parent.is_dir():
        raise SceneError(f"--out {path}: no such folder: {path.parent}")
    return path


def _refuse_unused(to: Format, options: Mapping[str, object]) -> None:
    """Raise SceneError for an option that this format does not read."""
    read = {"drive-wav": set(options), "drive-csv": set(options) - {"encoding"}}.get(to, set())
    for name, value in options.items():
        if value is not None and name not in read:
            raise SceneError(f"--{name} {value}: --to {to} does not read it; leave it out")


def _cases(result: Result, name: str | None) -> Mapping[str, Case]:
    if name is None:
        return result.cases
    if name not in result.cases:
        raise SceneError(f"--case {name}: must be one of {', '.join(result.cases)}")
    return {name: result.cases[name]}


def _write_record(result: Result, cases: Mapping[str, Case], to: Format, target: Path) -> list[Path]:
    from warp_plate.result.paraview import write_pvd, write_vtkhdf
    from warp_plate.result.table import write_traces

    if to == "traces-csv":
        return write_traces(result, cases, target)
    fields = {name: case.displacement for name, case in cases.items()}
    return (write_pvd if to == "pvd" else write_vtkhdf)(result.scene, result.times, fields, target)


def _write_signal(signal: Signal, to: Format, target: Path, encoding: Encoding) -> list[Path]:
    from warp_plate.result.signals import write_drive_csv, write_wav

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
    }


def _signal_line(told: Mapping[str, object]) -> str:
    seam = "without a seam" if told["seam_degrees"] == 0 else f"with a phase jump of {told['seam_degrees']:.2g} degrees"
    return (
        f"Drive {told['case']}: {told['periods']} periods of {told['frequency']:g} Hz in {told['samples']} samples at "
        f"{told['rate']} Hz, which repeat {seam}. 1.0 stands for {told['full_scale']:.6g} N/m² in every channel."
    )
