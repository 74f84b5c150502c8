"""``warp-plate compare SCENE``: several methods and seeds on one scene, with equal budgets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.cli.options import Whole
from warp_plate.cli.workers import lost_lines, own_device, workers
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.comparison import MethodComparison

# A trial has found the bound when its loss is this near, as a part of the bound's size.
NEAR = 1e-6
LEGEND = (
    "best, median, worst: of the seeds' results. gap: of the median from the bound. near: how many seeds came within "
    "1e-6 of {of}. tried, s: median evaluations and seconds of a trial."
)


def compare(
    scene: str,
    /,
    *,
    methods: str | None = None,
    seeds: Whole = 10,
    evaluations: Whole | None = None,
    evaluator: Literal["direct", "response"] | None = None,
    device: str = "auto",
    devices: str | None = None,
    cluster: str | None = None,
    path: Literal["auto", "resident", "streaming"] = "auto",
    out: Path | None = None,
    pictures: bool = True,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Compare search methods on a scene: each from several seeds, with the same number of evaluations.

    What they found is held against the bound that no drive passes, where one can be proved. Ctrl-C keeps the trials
    that are done.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file.
    methods
        Such as pso,ring,cma: of pso, constriction, ring, cma, gradient and exact; all that fit the scene when left
        out.
    seeds
        How many, from the scene's own on.
    evaluations
        That each trial may make, particles at a time and at least once; the scene's particles times iterations when
        left out.
    evaluator
        direct simulates a plate for each evaluation; response uses Gram matrices of unit responses instead. response
        when left out, where energies are quadratic forms of the drives, else direct.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one. With --cluster that of its workers.
    devices
        Several devices of this machine, such as cuda:0,cuda:1, or cpu,cpu for two single-threaded processes: the plates
        of a direct comparison are shared among them, a process each. Results are the same to the last bit. See
        docs/scaling.md.
    cluster
        Workers of Dask distributed that share the plates instead (needs the extra cluster): local:4 starts four on this
        machine, tcp://HOST:PORT or a scheduler's JSON file names a scheduler that runs.
    path
        How plates are stepped: resident (all steps in one launch) or streaming (one or a few steps a launch).
    out
        The file of results (.h5); SCENE-compare.h5 in this folder when left out. The picture is written beside it.
    pictures
        Plot what was found against evaluations and seconds (needs the extra viz).
    json
        Print one JSON object instead of a table.
    """
    target = output.output_file(out, scene, "compare")
    for option, value in (("--seeds", seeds), ("--evaluations", evaluations)):
        if value is not None and not 1 <= value <= 10**9:
            raise SceneError(f"{option} {value}: must be a whole number from 1 to 10^9")
    names = None if methods is None else [name.strip() for name in methods.split(",")]
    loaded = output.load_scene(scene)
    from warp_plate.studies.compare import compare as run

    own = own_device(devices, cluster, device)
    on = "auto" if own is None else own
    with workers(devices, cluster, device) as pool, output.progress_bar("comparing", shown=not json) as show:
        result = run(loaded, scene, names, seeds, on, path, evaluator, evaluations, show, pool)
    files, missing = _write(result, target, pictures)
    if json:
        output.print_json(as_json(result, files))
        return
    _print(result, output.console())
    output.print_files(files, missing)


def _write(result: MethodComparison, path: Path, pictures: bool) -> tuple[list[Path], str | None]:
    """The file and its picture; returns the files, and why a picture is missing."""
    from warp_plate.interrupts import deferred_interrupts
    from warp_plate.result.comparison import save_comparison

    with deferred_interrupts():
        save_comparison(result, path)
    if not pictures:
        return [path], None
    from warp_plate.viz.plots.compare import draw_comparison
    from warp_plate.viz.plots.frame import save_plots

    drawn, missing = save_plots(draw_comparison, result, path)
    return [path, *drawn], missing


def rows(result: MethodComparison) -> list[dict[str, object]]:
    """For each method what the table shows: losses, the gap, how many seeds came near the bound, and the cost."""
    import numpy as np

    from warp_plate.optimize.optimizer import tolerance_scale
    from warp_plate.problem.objectives import loss_scale

    near = NEAR * tolerance_scale(result.bound or 0.0, loss_scale(result.scene.search.objectives))
    made: list[dict[str, object]] = []
    for method in result.methods:
        trials = result.trials_of(method)
        found = np.array([trial.best_loss for trial in trials])
        best, median, worst = float(found.min()), float(np.median(found)), float(found.max())
        made.append(
            {
                "method": method,
                "seeds": len(trials),
                "best": best,
                "median": median,
                "worst": worst,
                "gap": None if result.bound is None else median - result.bound,
                "at_bound": None if result.bound is None else int((found - result.bound <= near).sum()),
                "evaluations": float(np.median([trial.evaluations[-1] for trial in trials])),
                "seconds": float(np.median([trial.seconds[-1] for trial in trials])),
            }
        )
    return made


def as_json(result: MethodComparison, files: list[Path]) -> dict[str, object]:
    """Losses throughout; 1 − loss is the localization factor where ``localization`` says so."""
    bound = {"loss": result.bound, "kind": result.bound_kind, "sentence": result.bound_sentence}
    return {
        "command": "compare",
        "scene": result.source,
        "device": result.device,
        "evaluator": result.evaluator,
        "budget": result.budget,
        "seconds": dict(result.seconds),
        "localization": result.localization,
        "bound": None if result.bound is None else bound,
        "methods": rows(result),
        "trials": [
            {
                "method": trial.method,
                "seed": trial.seed,
                "loss": trial.best_loss,
                "evaluations": int(trial.evaluations[-1]),
                "seconds": float(trial.seconds[-1]),
            }
            for trial in result.trials
        ],
        "skipped": dict(result.skipped),
        "interrupted": result.interrupted,
        "lost": dict(result.lost_plates),
        "versions": dict(result.versions),
        "files": [str(file) for file in files],
    }


def _print(result: MethodComparison, console: Console) -> None:
    title = "localization factor" if result.localization else "loss"
    console.print(f"{result.scene.title or result.source} on {result.device}, evaluator {result.evaluator}\n")
    made = output.table("method", "best", "median", "worst", "gap", "near", "tried", "s", title=title)
    made.collapse_padding = True  # losses in SI units have exponents, and eight columns of them meet in 80 characters
    for row in rows(result):
        losses = [float(str(row[name])) for name in ("best", "median", "worst")]
        shown = [f"{1 - loss if result.localization else loss:.6g}" for loss in losses]
        near = ["–", "–"] if row["gap"] is None else [f"{row['gap']:.1e}", f"{row['at_bound']}/{row['seeds']}"]
        made.add_row(str(row["method"]), *shown, *near, f"{row['evaluations']:.0f}", f"{row['seconds']:.2g}")
    output.print_whole(console, made)
    if result.bound is None:
        console.print("\nbound: none claimed")
    else:
        value = 1 - result.bound if result.localization else result.bound
        words = {"attained": "bound (no method can pass)", "bound only": "bound only (may not be reached)"}
        console.print(f"\n{words[result.bound_kind]}: {value:.6g}, {result.bound_sentence}")
    console.print(LEGEND.format(of="it" if result.localization else "its size"))
    if result.seconds["prepare"] > 0:
        console.print(f"before the clock: {result.seconds['prepare']:.2g} s for the plates that all methods share.")
    for method, reason in result.skipped.items():
        console.print(f"{method}: not tried: {reason}")
    for line in lost_lines(result.lost_plates):
        console.print(f"! {line}")
    if result.interrupted:
        console.print("Interrupted by Ctrl-C: the trials that were done are shown.")
