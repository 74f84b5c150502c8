"""``warp-plate simulate SCENE``: one plate under one drive."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.cli import clock, options, output, tables

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.model import Result


def simulate(
    scene: options.SceneName,
    /,
    *,
    assignments: options.Assignments = None,
    drive: str = "scene",
    device: options.Device = "auto",
    path: options.SteppingOrModes = "auto",
    accuracy: options.Accuracy | None = None,
    estimate: options.Estimate = True,
    allow_unstable: options.AllowUnstable = False,
    out: Path | None = None,
    force: options.Force = False,
    pictures: options.Pictures = True,
    colours: options.ColourChoice = options.DEFAULT_COLOURS,
    json: options.Json = False,
) -> None:
    """Run one plate under one drive.

    Parameters
    ----------
    drive
        scene (the magnitudes and phases of the scene's actuators), equal, single (the best single actuator), or a
        result file (.h5) whose best drive is taken.
    out
        The result file (.h5; default: SCENE-simulate.h5 in this folder).
    """
    chosen = colours.chosen()
    target = output.output_file(out, f"{Path(scene).stem}-simulate.h5", holds="a result of simulate", force=force)
    loaded, scene = output.load_scene(scene, assignments, accuracy)
    output.prepare_pictures(pictures)
    from warp_plate.studies.simulate import simulate as run

    last = "estimating the error" if estimate else ""
    with output.scene_errors(scene), output.progress_bar("simulating", not json, loaded, last) as show:

        def on_progress(done: int, total: int) -> None:
            show(done, total, f"{done:.2g} node-steps")

        result = run(
            loaded,
            source=scene,
            drive=drive,
            device=device,
            path=path,
            progress=on_progress,
            estimate=estimate,
            allow_unstable=allow_unstable,
        )
    written = output.write_result(result, target, pictures, chosen)
    output.report(json, partial(_as_json, result), partial(_print, result), written)


def _as_json(result: Result) -> dict[str, object]:
    case = result.cases["drive"]
    names = ("device", "evaluator", "path", "peak_displacement", "node_steps", "seconds", "effects", "accuracy")
    return {
        "scene": result.source,
        **output.attributes(result, *names),
        **output.attributes(case, "status", "localization_factor", "energy"),
        "motion": tables.motion_json(case),
        "warnings": output.warnings_of(result),
    }


def _print(result: Result, console: Console) -> None:
    from warp_plate.result.model import only_actuator

    case = result.cases["drive"]
    console.print(result.scene.title or result.source)
    made = output.table("quantity", "value")
    if case.status != "ok":
        made.add_row("status", case.status)
    if name := only_actuator(case, result.scene):
        made.add_row("only actuator driven", name)
    made.add_row("localization factor", output.number_text(case.localization_factor, ".4f"))
    for region, energy in case.energy.items():
        label = f"kinetic energy of the {region}, averaged over the window"
        made.add_row(label, output.number_text(energy, ".4g", " J"))
    made.add_row("largest displacement during the run", output.number_text(result.peak_displacement, ".4g", " m"))
    console.print(made)
    if (moved := tables.motion_table(result.cases, result.scene)) is not None:
        console.print()
        output.print_uncropped(console, moved)
    output.print_cost(result, console, elapsed=clock.elapsed())
