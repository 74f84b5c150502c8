"""``warp-plate compare SCENE``: several methods and seeds on one scene, with equal budgets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output

if TYPE_CHECKING:
    from warp_plate.result.comparison import MethodComparison

# A trial has reached the bound if its loss is this close, relative to the bound.
NEAR = 1e-6
LEGEND = (
    "best, median, worst: over the seeds. gap: between median and bound. near: seeds that came within 1e-6 of {of}. "
    "tried, s: median evaluations and seconds of a trial."
)
BOUNDS = {"attained": "bound of these searches", "bound only": "upper bound (may be out of reach)"}


@Parameter(name="*")
@dataclass(frozen=True)
class TrialOptions:
    """Options of the trials.

    Attributes:
        methods: Comma-separated, such as pso,ring,cma: pso, constriction, ring, cma, gradient, exact (default: all that
            fit the scene).
        seeds: Number of seeds, from the scene's own on.
        evaluations: Evaluations of each trial, rounded down to whole iterations (default: the scene's particles times
            iterations).
    """

    methods: str | None = None
    seeds: options.PositiveInteger = 10
    evaluations: options.PositiveInteger | None = None
    evaluator: options.Evaluator = None


def compare(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    trials: TrialOptions = TrialOptions(),
    workers: options.WorkerOptions = options.WorkerOptions(),
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Compare search methods on a scene: each from several seeds, with the same number of evaluations.

    Results are compared with the upper bound, if one is known. Ctrl-C keeps the finished trials. The results are
    written to an .h5 file.
    """
    from warp_plate.result.comparison import save_comparison
    from warp_plate.studies.compare import compare as run
    from warp_plate.viz.plots.frame import save_plots
    from warp_plate.viz.plots.search import draw_comparison

    target = files.target(scene, "-compare.h5", holds="a comparison")
    names = None if trials.methods is None else [name.strip() for name in trials.methods.split(",")]
    loaded, scene = changes.load(scene)
    with (
        output.scene_errors(scene),
        workers.open_pool() as pool,
        output.progress_bar("comparing", not files.json, loaded) as show,
    ):
        result = run(
            loaded,
            source=scene,
            methods=names,
            seeds=trials.seeds,
            device="auto" if workers.local_device is None else workers.local_device,
            path=workers.path or "auto",
            evaluator=trials.evaluator,
            evaluations=trials.evaluations,
            on_progress=show,
            pool=pool,
        )
    draw = partial(save_plots, partial(draw_comparison, result))
    written = output.write_files(target, partial(save_comparison, result), draw, files.pictures)
    output.report(files.json, _as_json, _print, result, written=written)


def rows(result: MethodComparison) -> list[dict[str, Any]]:
    """Return a record for each method: losses, gap, number of seeds near the bound, and cost."""
    import numpy as np

    from warp_plate.optimize.optimizer import tolerance_scale
    from warp_plate.problem.objectives import loss_scale

    bound = result.bound
    near = NEAR * tolerance_scale(bound or 0.0, loss_scale(result.scene.search.objectives))
    records = []
    for method in result.methods:
        trials = result.trials_of(method)
        losses = np.array([trial.best_loss for trial in trials])
        records.append(
            {
                "method": method,
                "seeds": len(trials),
                "best": losses.min(),
                "median": np.median(losses),
                "worst": losses.max(),
                "gap": None if bound is None else np.median(losses) - bound,
                "at_bound": None if bound is None else int((losses - bound <= near).sum()),
                "evaluations": np.median([trial.evaluations[-1] for trial in trials]),
                "seconds": np.median([trial.seconds[-1] for trial in trials]),
            }
        )
    return records


def _as_json(result: MethodComparison) -> dict[str, object]:
    """Return the record for ``--json``: losses, which are 1 − localization factor if ``localization`` is true."""
    bound = {"loss": result.bound, "kind": result.bound_kind, "sentence": result.bound_sentence}
    names = ("device", "evaluator", "budget", "seconds", "localization", "skipped", "interrupted", "versions")
    return {
        "command": "compare",
        "scene": result.source,
        **output.attributes(result, *names),
        "bound": None if result.bound is None else bound,
        "methods": rows(result),
        "trials": [
            {
                **output.attributes(trial, "method", "seed"),
                "loss": trial.best_loss,
                "evaluations": trial.evaluations[-1],
                "seconds": trial.seconds[-1],
            }
            for trial in result.trials
        ],
        "lost": result.lost_plates,
    }


def _print(result: MethodComparison, console: Console) -> None:
    from warp_plate.cli import tables

    title = "localization factor" if result.localization else "loss"
    console.print(f"{result.scene.title or result.source} on {result.device}, evaluator {result.evaluator}\n")
    records, bounded = rows(result), result.bound is not None
    if result.localization:
        records = [{**row, **{name: 1 - row[name] for name in ("best", "median", "worst")}} for row in records]
    headings = f"method | best | median | worst | {'gap | near | ' * bounded}tried | s"
    gap = "{gap:.1e} | {at_bound}/{seeds} | " * bounded
    cells = "{method} | {best:.6g} | {median:.6g} | {worst:.6g} | " + gap + "{evaluations:.0f} | {seconds:.2g}"
    output.print_table(console, headings, cells, records, title=title)
    if result.bound is None:
        console.print("\nbound: none")
    else:
        value = 1 - result.bound if result.localization else result.bound
        console.print(f"\n{BOUNDS[result.bound_kind]}: {value:.6g}, {result.bound_sentence}")
    console.print(LEGEND.format(of="it" if result.localization else "its size"))
    if result.seconds["prepare"] > 0:
        console.print(f"not timed: {result.seconds['prepare']:.2g} s for the plates that all methods share.")
    for method, reason in result.skipped.items():
        console.print(f"{method}: left out: {reason}")
    tables.print_failures(result, console, "the finished trials are shown")
