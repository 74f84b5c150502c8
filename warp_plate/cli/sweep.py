"""``warp-plate sweep SCENE --vary KEY=RANGE``: one command's results over many scenes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.sweep import Sweep

# Larger sweeps are summarised by the smallest and largest values.
MOST_ROWS, MOST_COLUMNS = 40, 7
MOST_REASONS = 3


@Parameter(name="*")
@dataclass(frozen=True)
class SweepOptions:
    """Options of a sweep.

    Attributes:
        vary: KEY=START:STOP:COUNT, KEY=log:START:STOP:COUNT or KEY=a,b,c. KEY is any number or text of the scene file,
            such as drive.frequency, target.area[1], actuators[0].phase, "actuators.lower left.phase" or edges.left; of
            a key that names a file, KEY=*.csv stands for all such files beside the scene. Several ranges form a grid.
        what: localize (localization factors of the equal drive, the best single actuator and the best drive, and the
            bound; the default), simulate (localization factor, energies and largest displacement under the scene's
            drive), frf (mean square velocity, localization factor and bound at each of --frequencies), sound (of the
            scene's drive, A-weighted, with its quietness and the bound of that), modes (natural frequencies) or check
            (time step and its limit, steps a period, nodes a wavelength).
        evaluator: modal (without time steps or a grid's error) or direct (time steps), with localize and simulate
            (default: modal for linear scenes, unless a key of the grid is varied or --path says how to step).
        frequencies: Frequencies of --what frf in hertz, as START:STOP:COUNT, log:START:STOP:COUNT or a,b,c.
        samples: Number of points of a Latin hypercube over the ranges in place of the grid; COUNT may then be left out.
            As many samples as a list has values take each once.
        seed: Random seed of the samples (default: 0).
        count: Number of modes, with --what modes (default: 6).
    """

    vary: Annotated[list[str] | None, Parameter(consume_multiple=True, negative="")] = None
    what: Literal["localize", "simulate", "frf", "sound", "modes", "check"] | None = None
    evaluator: Literal["modal", "direct"] | None = None
    frequencies: str | None = None
    samples: options.Integer | None = None
    seed: options.Integer | None = None
    count: options.Integer | None = None


def sweep(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    points: SweepOptions = SweepOptions(),
    workers: options.WorkerOptions = options.WorkerOptions(),
    checkpoint_every: options.CheckpointEvery = 30.0,
    files: options.FileOptions = options.FileOptions(),
    colormap: options.Colormap = None,
) -> None:
    """Compute the results of one command over many scenes that differ in the values of some keys.

    Points whose scene is invalid (an unstable time step, a patch off the plate) have no results; the reason is stored.
    All other points run.

    Ctrl-C leaves the finished points in a file beside the result, and so does a stop of the machine up to
    --checkpoint-every: the same command again runs the pending points to bit-identical results. The result replaces
    only an earlier result of the same sweep.
    """
    from warp_plate.studies.sweep import SweepRequest, open_sweep, run_sweep, save_finished
    from warp_plate.studies.unfinished import CheckpointFile
    from warp_plate.viz.plots.frame import save_plots
    from warp_plate.viz.plots.sweep import draw_sweep

    seed, samples = points.seed, points.samples
    if seed is not None and samples is None:
        raise SceneError(f"--seed {seed}: is the seed of samples; give --samples N as well, or leave it out")
    if colormap is not None:
        options.ColourChoice(colormap).chosen()
    if samples is not None and not points.vary:
        raise SceneError(f"--samples {samples}: are drawn from the ranges of --vary; give those too, or leave it out")
    target = files.target(scene, "-sweep.h5")
    loaded, scene = changes.load(scene)
    ways = (points.what, samples, seed, points.count, workers.path, points.evaluator, points.frequencies)
    request = SweepRequest(loaded, scene, points.vary or (), *ways)
    on_workers = workers.devices is not None or workers.cluster is not None
    with output.scene_errors(scene):
        start = open_sweep(request, target, workers.device, on_workers, output.log, files.force)
    file = CheckpointFile(target.with_suffix(".checkpoint.h5"), checkpoint_every)
    with output.resumable(file):
        with workers.open_pool() as pool, output.progress_bar("sweeping", not files.json, start.scene) as show:
            show(len(start.plan) - len(start.pending), len(start.plan), start.progress)
            note = "{} of {}: {}".format
            result = run_sweep(start, lambda *done: show(*done[:2], note(*done)), file, pool)
        draw = partial(save_plots, partial(draw_sweep, result, colormap=colormap), target)
        save = partial(save_finished, result, file=file, force=files.force)
        write = partial(output.write_files, {target: save}, draw if files.pictures else None)
        output.report(files.json, _as_json, _print, result, write=write)


def _as_json(result: Sweep) -> dict[str, object]:
    """Return the record for ``--json``: arrays in the shape of the grid or (samples,), then the output's own axis."""
    plan = result.plan
    return {
        "command": "sweep",
        "scene": result.source,
        **output.attributes(result, "what", "evaluator", "seconds", "versions"),
        **output.attributes(plan, "sampled", "shape"),
        "device": result.devices_used,
        "varied": dict(zip(plan.keys, plan.coordinates, strict=True)),
        "axes": {axis: result.along(axis) for axis in sorted({o.axis for o in result.outputs.values() if o.axis})},
        "outputs": {name: result.shaped(name) for name in result.outputs},
        "units": {name: declared.unit for name, declared in result.outputs.items()},
        "refused": [{"at": plan.values(point), "reason": reason} for point, reason in sorted(result.reasons.items())],
    }


def _with_unit(text: str, unit: str) -> str:
    return text if unit == "1" else f"{text} ({unit})"


def _columns(result: Sweep) -> dict[str, tuple[str, list[float]]]:
    """Return the unit and the values at all points of every column of the outputs, by its heading."""
    return {
        name.replace("_", " ") + end: (declared.unit, column.tolist())
        for name, declared in result.outputs.items()
        for end, column in result.columns(name).items()
    }


def _print(result: Sweep, console: Console) -> None:
    from warp_plate.scene.keys import label_of, unit_of
    from warp_plate.scene.vary import counted, value_text

    plan, scene, columns = result.plan, result.scene, _columns(result)
    way = "by modes" if result.evaluator == "modal" else "by time steps"
    head = f"{scene.title or result.source}: {result.what} {way}, {plan.description}, on {result.devices_used}\n"
    console.print(head, highlight=False)
    keys = [_with_unit(label_of(scene, key), unit_of(scene, key)) for key in plan.keys]
    if len(plan) <= MOST_ROWS and len(keys) + len(columns) <= MOST_COLUMNS:
        rows = [
            [*map(value_text, point), *(output.number_text(values[at], ".4g") for _, values in columns.values())]
            for at, point in enumerate(plan.points.tolist())
        ]
        output.print_rows(console, [*keys, *(_with_unit(name, unit) for name, (unit, _) in columns.items())], rows)
    else:
        rows = []
        for name, (unit, values) in columns.items():
            finite = [point for point, value in enumerate(values) if math.isfinite(value)]
            for word, choose in (("smallest", min), ("largest", max)) if finite else ():
                point = choose(finite, key=values.__getitem__)
                at = (value_text(value, 5) for value in plan.values(point).values())
                rows.append([f"{name}, {word}", f"{values[point]:.5g} {unit.removeprefix('1')}".strip(), *at])
        output.print_rows(console, ["quantity", "value", *(f"at {key}" for key in keys)], rows)
    if result.reasons:
        console.print(f"\n{len(result.reasons)} of {counted(len(plan), 'point')} refused:")
        for point in sorted(result.reasons)[:MOST_REASONS]:
            console.print(f"  {result.refusal(point)}")
        if len(result.reasons) > MOST_REASONS:
            console.print("  ... (all reasons are in the result file)")
    output.print_warnings(console, result.warnings)
    console.print(f"{result.seconds:.2f} s in all.")
