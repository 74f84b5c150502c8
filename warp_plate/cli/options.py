"""Options that several commands share, each with its help text."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts
from cyclopts import Parameter, validators

from warp_plate.cli import collect_garbage, output
from warp_plate.scene.errors import SceneError, plain_number

if TYPE_CHECKING:
    from warp_plate.cluster.pool import WorkerPool
    from warp_plate.scene.model import Scene
    from warp_plate.viz.fields import ColourOptions


def _integer(kind: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Convert an option to an integer. The default converter would round 1.5, which is not a valid seed."""
    text = tokens[0].value
    if not re.fullmatch(r"[-+]?[0-9]{1,30}", text):
        raise ValueError(f"{text[:60]!r} is not an integer")
    return int(text)


Integer = Annotated[int, Parameter(converter=_integer)]
PositiveInteger = Annotated[int, Parameter(converter=_integer, validator=validators.Number(gte=1, lte=10**9))]
Switch = Annotated[bool, Parameter(negative="")]

_PRESETS = "paper, touch-panel, ...; warp-plate init --help lists them"
SceneName = Annotated[str, Parameter(help=f"A preset ({_PRESETS}) or a TOML file.")]
ResultFile = Annotated[Path, Parameter(help="An .h5 file written by localize or simulate.")]
Device = Annotated[str, Parameter(help="cpu, cuda, cuda:1, ...; auto takes a CUDA device if there is one.")]
_STEPPING = (
    "How plates are stepped: resident (all steps in one launch), streaming (one or a few steps a launch; on a CPU "
    "only for clamped or supported plates whose one effect is viscous damping) or auto (the faster of the two)"
)
Stepping = Annotated[Literal["auto", "resident", "streaming"], Parameter(help=f"{_STEPPING}.")]
SteppingOrModes = Annotated[
    Literal["auto", "resident", "streaming", "modal"],
    Parameter(
        help=f"{_STEPPING}; or modal, without time steps or a grid's error, for linear scenes. auto takes modal for "
        "scenes whose damping cannot be stepped."
    ),
]
Evaluator = Annotated[
    Literal["direct", "response", "modal"] | None,
    Parameter(
        help="direct simulates a plate for each evaluation; response uses Gram matrices of simulated unit responses; "
        "modal computes energies from the modes of the plate, for tones and linear scenes (default: direct, but in "
        "robust searches response where it applies)."
    ),
]
EstimateSwitch = Annotated[bool, Parameter(help="Estimate the error of the result at the end.")]
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
Force = Annotated[
    bool, Parameter(negative="", help="Overwrite files that another command, or another program, has written.")
]
Colormap = Annotated[str | None, Parameter(help="Colour map of Matplotlib, such as viridis or PuOr.")]
Json = Annotated[bool, Parameter(negative="", help="Print one JSON object instead of text and tables.")]


@Parameter(name="*")
@dataclass(frozen=True)
class SceneChanges:
    """Options that change keys of a scene."""

    assignments: Annotated[
        list[str] | None,
        Parameter(
            name="--set",
            negative="",
            help="KEY=VALUE: a value in place of the scene file's; may be repeated. KEY is any key of a scene, such as "
            "drive.frequency, plate.size[0], effects.damping.viscous or 'actuators.lower left.phase'; VALUE is TOML, "
            "or a text without quotes.",
        ),
    ] = None

    def load(self, source: str) -> tuple[Scene, str]:
        """Return the scene, and its name with the options that changed it, for use in output."""
        from warp_plate.scene.model import Scene  # imports NumPy and pydantic

        changed = self.assignments or []
        name = " ".join([source, *(f"--set {shlex.quote(assignment)}" for assignment in changed)])
        scene = Scene.load(source, changed)
        collect_garbage()
        return scene, name


@Parameter(name="*")
@dataclass(frozen=True)
class SceneOptions(SceneChanges):
    """Options that change keys of a scene or choose its grid.

    Attributes:
        accuracy: Relative error allowed in localization factors, such as 1% or 0.01: a grid that keeps it replaces the
            scene's own.
    """

    accuracy: str | None = None

    def load(self, source: str) -> tuple[Scene, str]:
        """Return the scene with its grid, and its name as of :meth:`SceneChanges.load`."""
        scene, name = super().load(source)
        return self.with_accuracy(scene), name

    def with_accuracy(self, scene: Scene) -> Scene:
        """Return the scene with ``--accuracy`` in place of its grid, if it is given."""
        if self.accuracy is None:
            return scene
        text = self.accuracy.strip()
        try:
            return scene.with_accuracy(plain_number(text.removesuffix("%")) / (100 if text.endswith("%") else 1))
        except ValueError:
            raise SceneError(f"--accuracy {self.accuracy}: must be from 0.01% to 50%, such as 1% or 0.01") from None


@Parameter(name="*")
@dataclass(frozen=True)
class FileOptions:
    """Options of commands that write a file and print what it holds.

    Attributes:
        out: File to write; others are written beside it under the same name. Default: SCENE-COMMAND in this folder
            (beside the file of --resume), with the ending that the command writes.
    """

    out: Path | None = None
    force: Force = False
    pictures: Annotated[
        bool, Parameter(help="Draw pictures beside the file that is written (needs the extra viz).")
    ] = True
    json: Json = False

    def target(self, scene: str | None, ending: str, holds: str = "", endings: Sequence[str] = ()) -> Path:
        """Return the path to write to, by default the scene's name with an ending.

        See :func:`output.output_file`, and for ``holds`` :func:`output.check_overwriting`.
        """
        path = output.output_file(self.out, f"{Path(scene or '').stem}{ending}", endings)
        if holds:
            output.check_overwriting(path, holds, self.force)
        return path

    def check_drawn(self, path: Path, drawn: output.Drawn) -> output.Drawn:
        """Return what was drawn, or raise a SceneError if that lacks the picture ``path`` that ``--out`` names; a
        KeyboardInterrupt if Ctrl-C left it out."""
        if self.out is not None and self.pictures and path not in drawn[0]:
            if drawn[1] == output.INTERRUPTED:
                raise KeyboardInterrupt(f"; wrote only {', '.join(map(str, drawn[0]))}")
            raise SceneError(f"--out {path}: {str(drawn[1]).removeprefix(f'no plot: {path}: ')}")
        return drawn


@Parameter(name="*")
@dataclass(frozen=True)
class WorkerOptions:
    """Options of commands whose plates workers can simulate.

    Attributes:
        device: cpu, cuda, cuda:1, ...; auto (the default) takes a CUDA device if there is one. With --cluster, the
            device of its workers. A run that is resumed continues on the kind of device that it began on, if there
            is one; another kind rounds differently, so that the result may differ.
        devices: Several devices of this machine that share the work, one process each, such as cuda:0,cuda:1, or
            cpu,cpu for two single-threaded processes (needs the extra cluster). Results are bit-identical. See
            docs/scaling.md.
        cluster: A running Dask scheduler whose workers share the work: tcp://HOST:PORT or its JSON file (needs the
            extra cluster).
    """

    device: str | None = None
    devices: str | None = None
    cluster: str | None = None
    path: Stepping | None = None

    @property
    def local_device(self) -> str | None:
        """Device for computations in this process: the first of ``devices``, or ``device``. None for the default, also
        with ``cluster``, whose workers use ``device``."""
        if self.devices is not None:
            return self.devices.split(",")[0].strip()
        return self.device if self.cluster is None else None

    def open_pool(self) -> AbstractContextManager[WorkerPool | None]:
        """Open the pool of workers; see :func:`warp_plate.cluster.opening.open_pool`."""
        if self.devices is not None and self.device not in (None, "auto"):
            asked = f"--device {self.device}: --devices {self.devices}"
            raise SceneError(f"{asked} already says where plates run; give only one of them")
        from warp_plate.cluster.opening import open_pool

        return open_pool(self.devices, self.cluster, self.device, output.log)


@Parameter(name="*")
@dataclass(frozen=True)
class ColourChoice:
    """Options of the colours of fields over the plate.

    Attributes:
        colormap: Colour map of Matplotlib, such as viridis, for the field over the plate (default: one that suits it).
        limits: Ends of the colours: common (all plates alike), each (every plate its own, so that weak motion shows) or
            the largest value shown, in the field's SI unit, such as 3e-7. Default: common; in the pictures of localize,
            simulate and focus each.
    """

    colormap: str | None = None
    limits: str | None = None

    def chosen(self) -> ColourOptions:
        """Return the options; raise a SceneError if there is no such colour map, or no such limits."""
        from warp_plate.viz.fields import colour_options

        return colour_options(self.colormap, self.limits)
