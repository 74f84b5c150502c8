"""``warp-plate sweep SCENE --vary KEY=RANGE``: one command's figures over many scenes."""

from __future__ import annotations

import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.cli.options import Whole
from warp_plate.cli.resume import differences, refuse_changes
from warp_plate.cli.workers import workers
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.cluster.pool import Pool
    from warp_plate.result.sweep import Sweep
    from warp_plate.scene.model import Scene
    from warp_plate.studies.sweep import Elsewhere
    from warp_plate.studies.sweep_file import SweepFile

# So many points and columns are a table; of more, the smallest and largest figures are shown.
MOST_ROWS, MOST_COLUMNS = 40, 7
MOST_REASONS = 3
MODES = 6


def sweep(
    scene: str | None = None,
    /,
    *,
    vary: Annotated[list[str] | None, cyclopts.Parameter(consume_multiple=True, negative="")] = None,
    what: Literal["localize", "simulate", "modes", "check"] | None = None,
    samples: Whole | None = None,
    seed: Whole | None = None,
    count: Whole | None = None,
    device: str | None = None,
    devices: str | None = None,
    cluster: str | None = None,
    path: Literal["auto", "resident", "streaming"] | None = None,
    checkpoint_every: float = 30.0,
    resume: Path | None = None,
    out: Path | None = None,
    pictures: bool = True,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Find one command's figures over many scenes that differ in some of their numbers.

    A point whose scene is refused (a time step that is not stable, a patch off the plate) has no figures, and its
    reason is kept; the others run.

    Ctrl-C leaves what is done in a file beside the result, and so does a stop of the machine up to --checkpoint-every:
    the same command once more, or --resume, runs the points that are left, to the same figures to the last bit. The
    result is written at the end, in the place of one that the same command wrote before; any other file is left alone.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file. With
        --resume it may be left out.
    vary
        KEY=START:STOP:COUNT, KEY=log:START:STOP:COUNT or KEY=a,b,c. KEY is any number of the scene file, such as
        drive.frequency, effects.damping.viscous, target.area[1], actuators[0].phase, or with an actuator's name
        "actuators.lower left.phase". Several make the full grid.
    what
        localize (localization factors of equal drive, the best single actuator and the best drive, and the bound),
        simulate (of the scene's drive: localization factor, energies, largest displacement), modes (natural
        frequencies) or check (time step and its limit, steps a period, nodes a wavelength). localize when left out.
    samples
        Draw so many points from a Latin hypercube over the ranges instead of the full grid; COUNT may be left out then.
    seed
        Of the samples; 0 when left out.
    count
        How many modes, of --what modes; 6 when left out.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one. auto when left out, for a sweep that goes
        on the kind that it began on. With --cluster that of its workers.
    devices
        Several devices of this machine, such as cuda:0,cuda:1, or cpu,cpu for two single-threaded processes: the points
        are shared among them, a process each. Figures are the same to the last bit. See docs/scaling.md.
    cluster
        Workers of Dask distributed that share the points instead (needs the extra cluster): local:4 starts four on this
        machine, tcp://HOST:PORT or a scheduler's JSON file names a scheduler that runs.
    path
        How plates are stepped: resident (all steps in one launch) or streaming (one or a few steps a launch). auto,
        the faster one, when left out.
    checkpoint_every
        Seconds between two writings of what is done, OUT.checkpoint.h5 for OUT.h5. 0: after each point; inf: only
        after Ctrl-C.
    resume
        The unfinished sweep (.checkpoint.h5) to go on with, or the result that it is to be. What is given beside it
        must be the same.
    out
        The result file (.h5), which xarray opens; SCENE-sweep.h5 in this folder when left out, with --resume beside the
        unfinished one. The picture is written beside it.
    pictures
        Draw lines over one key, maps over two, small maps over three or more, points of samples (needs the extra viz).
    json
        Print one JSON object instead of a table.
    """
    if scene is None and resume is None:
        raise SceneError("sweep needs a SCENE (a preset's name or a TOML file) and --vary KEY=RANGE, or --resume FILE")
    if seed is not None and samples is None:
        raise SceneError(f"--seed {seed}: draws samples; write --samples N beside it, or leave it out")
    if samples is not None and not vary:
        raise SceneError(f"--samples {samples}: draws from the ranges of --vary; write those too, or leave it out")
    target = output.output_file(out or _result_of(resume), scene or "", "sweep")
    from warp_plate.result.checkpoint import ENDING
    from warp_plate.scene import Scene
    from warp_plate.scene.vary import make_plan, parse_vary
    from warp_plate.studies.sweep import begin_sweep
    from warp_plate.studies.sweep_file import SweepFile, refuse_to_replace

    loaded = None if scene is None else Scene.load(scene)
    unfinished = target.with_suffix(ENDING)
    file = _file_to_go_on_with(resume, target, unfinished)
    there = not (devices is None and cluster is None)
    if file is not None:
        given: dict[str, object] = {"what": what, "count": count, "path": path}
        begun = _loaded(file, resume is not None, loaded, scene, vary, samples, seed, given)
    else:
        assert loaded is not None
        plan = make_plan([parse_vary(loaded, one) for one in vary or ()], samples, seed or 0)
        modes = MODES if count is None else count
        here = "auto" if there or device is None else device
        begun = begin_sweep(loaded, plan, what or "localize", here, path or "auto", scene or "", modes)
    if count is not None and not any(one.axis for one in begun.outputs.values()):
        raise SceneError(f"--count {count}: --what {begun.what} has no modes to count; leave it out")
    refuse_to_replace(target, begun)
    if file is not None:
        begun = _going_on(file, begun, device, there)
    own = file is not None and unfinished.exists() and unfinished.samefile(file)
    kept = SweepFile(unfinished, checkpoint_every, output.tell, own)
    # Whoever names devices means them, as in other commands.
    elsewhere = None if devices is None and device is None else output.tell
    with workers(devices, cluster, device) as pool:
        result = _run(begun, kept, pool, elsewhere, shown=not json)
    files, missing = _write(result, target, pictures, kept)
    if json:
        output.print_json(as_json(result, files))
        return
    _print(result, output.console())
    output.print_files(files, missing)


def _result_of(resume: Path | None) -> Path | None:
    """Where the result of a sweep that goes on is written without --out: NAME.h5 for NAME.checkpoint.h5."""
    return None if resume is None else resume.parent / resume.name.replace(".checkpoint.h5", ".h5")


def _file_to_go_on_with(resume: Path | None, target: Path, unfinished: Path) -> Path | None:
    """What ``--resume`` means, an unfinished file or the result that it is to be; without, what the same command left.

    None: nothing is there.
    """
    from warp_plate.result.checkpoint import ENDING

    if resume is None:
        return unfinished if unfinished.exists() else None
    beside = resume.with_suffix(ENDING)
    return beside if beside.exists() else resume


def _loaded(
    file: Path,
    resumed: bool,
    scene: Scene | None,
    source: str | None,
    vary: list[str] | None,
    samples: int | None,
    seed: int | None,
    given: dict[str, object],
) -> Sweep:
    """The sweep in a file, which --resume names or the same command left; what is given beside it must be the same.

    Raises:
        SceneError: it cannot be read, or what was given is not what it began with.
    """
    from warp_plate.result.sweep import load_sweep
    from warp_plate.scene.vary import make_plan, parse_vary

    anew = "begin anew without --resume" if resumed else f"name another file by --out, or delete {file}"
    try:
        begun = load_sweep(file)
    except SceneError as error:
        raise error if resumed else SceneError(f"{error}; {anew}") from None
    if not resumed:  # the same command has the same defaults
        given = {"what": given["what"] or "localize", "count": given["count"] or MODES, "path": given["path"] or "auto"}
    refuse_changes(begun, f"sweep in {file}", begun.scene, scene, source or "", given, anew)
    if vary or not resumed:
        plan = make_plan([parse_vary(begun.scene, one) for one in vary or ()], samples, seed or 0)
        if not plan.same(begun.plan):
            raise SceneError(
                f"--vary: the sweep in {file} began with other points ({begun.plan.description}), and goes on with "
                f"nothing else; {'leave --vary out, or ' if resumed else ''}{anew}"
            )
    # The files that the scene names lie beside it, not beside the result.
    return begun if scene is None else replace(begun, scene=begun.scene.in_folder(scene.folder))


def _going_on(file: Path, begun: Sweep, device: str | None, there: bool) -> Sweep:
    """The sweep as it goes on; tells what a user should know of it.

    there: whether workers run its points, whose device is not known yet.

    Raises:
        SceneError: see ``continued``.
    """
    from warp_plate.studies.sweep_file import continued

    output.tell(f"{file}: {begun.progress} done; {'nothing is left' if begun.finished else 'going on'}")
    for line in differences(file, begun, None if there or not begun.processor else device):
        output.tell(line)
    return continued(begun, device, there)


def _run(begun: Sweep, kept: SweepFile, pool: Pool | None, elsewhere: Elsewhere | None, shown: bool) -> Sweep:
    """The sweep with its progress; Ctrl-C and workers that are gone say how to go on."""
    from warp_plate.cluster.pool import WorkersGone
    from warp_plate.studies.sweep import run_sweep

    total = len(begun.plan)
    try:
        with output.progress_bar("sweeping", shown) as show:
            show(total - len(begun.pending), total, begun.progress)

            def told(done: int, of: int, note: str) -> None:
                show(done, of, f"{done} of {of}: {note}")

            return run_sweep(begun, told, kept, pool, elsewhere)
    except (KeyboardInterrupt, WorkersGone) as reason:
        if kept.saved is None:
            raise
        if isinstance(reason, WorkersGone):
            raise SceneError(f"{reason}{_way_on(kept.saved, kept.path)}") from None
        raise KeyboardInterrupt(_way_on(kept.saved, kept.path)) from None


def _way_on(unfinished: Sweep, file: Path) -> str:
    """How far the sweep is, and the command that goes on with it."""
    return f" after {unfinished.progress}; go on with: warp-plate sweep --resume {shlex.quote(str(file))}"


def _write(result: Sweep, path: Path, pictures: bool, kept: SweepFile) -> tuple[list[Path], str | None]:
    """The file and its picture; returns the files, and why a picture is missing."""
    from warp_plate.interrupts import deferred_interrupts
    from warp_plate.result.sweep import save_sweep
    from warp_plate.studies.sweep_file import free_name, refuse_to_replace

    with deferred_interrupts():
        try:
            refuse_to_replace(path, result)
        except SceneError:
            taken, path = path, free_name(path)
            output.tell(f"{taken} is of another command by now; this sweep is written to {path}")
        try:
            save_sweep(result, path)
        except SceneError as error:
            kept(result, True)
            if kept.saved is None:
                raise
            raise SceneError(f"{error}; it is kept{_way_on(kept.saved, kept.path)}") from None
        kept.remove()
    if not pictures:
        return [path], None
    from warp_plate.viz.plots.frame import save_plots
    from warp_plate.viz.plots.sweep import draw_sweep

    drawn, missing = save_plots(draw_sweep, result, path)
    return [path, *drawn], missing


def as_json(result: Sweep, files: list[Path]) -> dict[str, object]:
    """Arrays in the shape of the grid, or (samples,); and after it of an output's own axis."""
    plan = result.plan
    return {
        "command": "sweep",
        "scene": result.source,
        "what": result.what,
        "device": result.devices_used,
        "sampled": plan.sampled,
        "shape": list(plan.shape),
        "varied": {key: values.tolist() for key, values in zip(plan.keys, plan.coordinates, strict=True)},
        "outputs": {name: result.shaped(name).tolist() for name in result.outputs},
        "units": {name: one.unit for name, one in result.outputs.items()},
        "refused": [{"at": plan.numbers(point), "reason": reason} for point, reason in sorted(result.reasons.items())],
        "seconds": result.seconds,
        "versions": dict(result.versions),
        "files": [str(file) for file in files],
    }


def _columns(result: Sweep) -> dict[str, tuple[str, list[float]]]:
    """Unit and values at all points of every number that the outputs have, by its heading."""
    made = {}
    for name, one in result.outputs.items():
        values = result.values[name]
        for index, column in enumerate(values.reshape(len(values), -1).T.tolist(), 1):
            heading = name.replace("_", " ")
            made[f"{heading} {index}" if one.axis else heading] = (one.unit, column)
    return made


def _headings(result: Sweep) -> list[str]:
    """Of the keys, with spaces at which they may be wrapped."""
    from warp_plate.scene.keys import label_of, unit_of

    units = [unit_of(result.scene, key) for key in result.plan.keys]
    words = [label_of(result.scene, key) for key in result.plan.keys]
    return [f"{word} ({unit})" if unit != "1" else word for word, unit in zip(words, units, strict=True)]


def _print(result: Sweep, console: Console) -> None:
    from warp_plate.scene.vary import counted

    plan = result.plan
    title = result.scene.title or result.source
    console.print(f"{title}: {result.what}, {plan.description}, on {result.devices_used}\n")
    columns, keys = _columns(result), _headings(result)
    if len(plan) <= MOST_ROWS and len(keys) + len(columns) <= MOST_COLUMNS:
        headings = [f"{name} ({unit})" if unit != "1" else name for name, (unit, _) in columns.items()]
        made = output.table(*keys, *headings)
        for point, numbers in enumerate(plan.points.tolist()):
            figures = (output.known(values[point], ".4g") for _, values in columns.values())
            made.add_row(*(f"{number:.4g}" for number in numbers), *figures)
    else:
        made = output.table("figure", "value", *(f"at {key}" for key in keys))
        for name, (unit, values) in columns.items():
            for word, point in _extremes(values).items():
                at = (f"{number:.5g}" for number in plan.numbers(point).values())
                made.add_row(f"{name}, {word}", f"{values[point]:.5g} {unit if unit != '1' else ''}".strip(), *at)
    console.print(made)
    if result.reasons:
        console.print(f"\n{len(result.reasons)} of {counted(len(plan), 'point')} refused:")
        for point in sorted(result.reasons)[:MOST_REASONS]:
            console.print(f"  {result.refusal(point)}")
        if len(result.reasons) > MOST_REASONS:
            console.print("  ... (all reasons are in the result file)")
    for key in result.keys_without_effect:
        console.print(f"! {key} changes no figure")
    console.print(f"{result.seconds:.2f} s in all.")


def _extremes(values: list[float]) -> dict[str, int]:
    """The points of the smallest and of the largest of some figures; nothing where none is a number."""
    known = [point for point, value in enumerate(values) if math.isfinite(value)]
    if not known:
        return {}
    return {"smallest": min(known, key=values.__getitem__), "largest": max(known, key=values.__getitem__)}
