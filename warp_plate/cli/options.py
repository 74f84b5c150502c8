"""Arguments and options that several commands share, each with its help text, and the workers of ``--devices``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts
from cyclopts import Parameter

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.cluster.pool import WorkerPool


def _integer(kind: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Convert an option to an integer. The default converter would round 1.5, which is not a valid seed."""
    text = tokens[0].value
    if not re.fullmatch(r"[-+]?[0-9]{1,30}", text):
        raise ValueError(f"{text[:60]!r} is not an integer")
    return int(text)


Integer = Annotated[int, Parameter(converter=_integer)]
Flag = Annotated[bool, Parameter(negative="")]

SceneName = Annotated[
    str,
    Parameter(help="A preset (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file."),
]
ResultFile = Annotated[Path, Parameter(help="An .h5 file written by localize or simulate.")]
Device = Annotated[str, Parameter(help="cpu, cuda, cuda:1, ...; auto takes a CUDA device if there is one.")]
WorkersDevice = Annotated[
    str,
    Parameter(
        help="cpu, cuda, cuda:1, ...; auto takes a CUDA device if there is one. With --cluster, the device of its "
        "workers. A run that is resumed continues on the kind of device that it began on unless a device is named; "
        "another kind rounds differently, so that the result may differ."
    ),
]
Devices = Annotated[
    str,
    Parameter(
        help="Several devices of this machine that share the work, one process each, such as cuda:0,cuda:1, or cpu,cpu "
        "for two single-threaded processes. Results are bit-identical. See docs/scaling.md."
    ),
]
Cluster = Annotated[
    str,
    Parameter(
        help="Dask workers that share the work (needs the extra cluster): local:4 starts four on this machine; "
        "tcp://HOST:PORT or a scheduler's JSON file names a running scheduler."
    ),
]
Stepping = Annotated[
    Literal["auto", "resident", "streaming"],
    Parameter(
        help="How plates are stepped: resident (all steps in one launch), streaming (one or a few steps a launch) or "
        "auto (the faster of the two)."
    ),
]
Accuracy = Annotated[
    str,
    Parameter(
        help="Relative error allowed in localization factors, such as 1% or 0.01: a grid that keeps it replaces the "
        "scene's own."
    ),
]
Estimate = Annotated[bool, Parameter(help="Estimate the error of the result at the end.")]
AllowUnstable = Annotated[
    bool, Parameter(negative="", help="Accept a time step above the stability limit and report what becomes of it.")
]
CheckpointEvery = Annotated[
    float,
    Parameter(
        help="Seconds between two checkpoints, OUT.checkpoint.h5 for OUT.h5. 0 writes one after each iteration or "
        "point, inf only after Ctrl-C."
    ),
]
Pictures = Annotated[bool, Parameter(help="Draw pictures beside the file that is written (needs the extra viz).")]
Json = Annotated[bool, Parameter(negative="", help="Print one JSON object instead of text and tables.")]

CaseNames = Annotated[
    list[str],
    Parameter(
        negative="",
        help="A case of the result (equal, single, best, drive, ...); repeat the option for more (default: all).",
    ),
]
Start = Annotated[
    float,
    Parameter(
        help="First time of the frames in seconds. Without --start and --end frames cover the last period of the "
        "drive; for a drive that does not repeat, the first burst, or else the scene's window."
    ),
]
End = Annotated[float, Parameter(help="Last time of the frames in seconds (default: the end of the run).")]
Frames = Annotated[
    int,
    Parameter(help="Number of frames, 600 at most (default: 60 a period, or as many as there are time steps)."),
]
Heights = Annotated[float, Parameter(help="Factor by which displacements are exaggerated (default: automatic).")]
Rate = Annotated[
    float,
    Parameter(help="Frames a second (default: 30, or fewer so that a period takes at least 1.4 s)."),
]
Field = Annotated[
    Literal["displacement", "velocity", "energy", "rms-velocity", "phase"],
    Parameter(help="Quantity shown in colour (energy: kinetic energy density). Heights always show displacements."),
]
ShapeCount = Annotated[int, Parameter(help="Show this many natural mode shapes, 6 at most, instead of the cases.")]


def workers(devices: str | None, cluster: str | None, device: str | None) -> AbstractContextManager[WorkerPool | None]:
    """Open the pool of workers that the options ask for; see :func:`warp_plate.cluster.opening.open_pool`."""
    from warp_plate.cluster.opening import open_pool

    if devices is not None and device not in (None, "auto"):
        raise SceneError(f"--device {device}: --devices {devices} already says where plates run; give only one of them")
    return open_pool(devices, cluster, device, output.log)


def local_device(devices: str | None, cluster: str | None, device: str | None) -> str | None:
    """Return the device for what runs in this process: the first of ``--devices``, or ``--device``; None for the
    default, which is also used beside ``--cluster``, whose ``--device`` is that of its workers."""
    if devices is not None:
        return devices.split(",")[0].strip()
    return device if cluster is None else None


def failure_lines(failures: Mapping[str, int]) -> list[str]:
    """Return a line for each reason for which workers failed to simulate plates of a search."""
    from warp_plate.scene.vary import counted

    return [
        f"{counted(count, 'plate')} of the search failed on the workers and counted as worst: {reason}"
        for reason, count in failures.items()
    ]
