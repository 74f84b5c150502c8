"""``warp-plate simulate``: one plate under one drive, with its tables and files."""

from dataclasses import dataclass
from functools import partial

from cyclopts import Parameter
from rich.console import Console

import warp_plate
from warp_plate.cli import main, options, output


@Parameter(name="*")
@dataclass(frozen=True)
class RunOptions:
    """Options of a run."""

    device: options.Device = "auto"
    path: options.SteppingOrModes = "auto"
    estimate: options.EstimateSwitch = True
    allow_unstable: options.AllowUnstable = False


def simulate(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneOptions = options.SceneOptions(),
    drive: str = "scene",
    run: RunOptions = RunOptions(),
    files: options.FileOptions = options.FileOptions(),
    colours: options.ColourChoice = options.ColourChoice(),
) -> None:
    """Run one plate under one drive, and write the result as an .h5 file.

    Parameters
    ----------
    drive
        scene (the magnitudes and phases of the scene's actuators), equal, single (the best single actuator), or a
        result file (.h5) whose best drive is taken.
    """
    from warp_plate import viz

    chosen = colours.chosen()
    target = files.target(scene, "-simulate.h5", holds="a result of simulate")
    loaded, scene = changes.load(scene)
    if files.pictures:
        viz.prepare()  # while the plate is simulated
    last = "estimating the error" if run.estimate else ""
    with output.scene_errors(scene), output.progress_bar("simulating", not files.json, loaded, last) as show:

        def on_progress(done: int, total: int) -> None:
            show(done, total, f"{done:.2g} node-steps")

        result = warp_plate.simulate(loaded, source=scene, drive=drive, progress=on_progress, **vars(run))
    write = partial(output.write_result, result, target, files.pictures, chosen)
    output.report(files.json, _as_json, _print, result, write=write)


def _as_json(result: warp_plate.Result) -> dict[str, object]:
    from warp_plate.cli import tables

    case = result.cases["drive"]
    names = ("device", "evaluator", "path", "peak_displacement", "node_steps", "seconds", "effects", "accuracy")
    return {
        "scene": result.source,
        **output.attributes(result, *names),
        **output.attributes(case, "status", "localization_factor", "energy"),
        "motion": tables.motion_json(case),
        "warnings": result.warnings,
    }


def _print(result: warp_plate.Result, console: Console) -> None:
    from warp_plate.cli import tables
    from warp_plate.result.case import only_actuator

    case = result.cases["drive"]
    console.print(result.scene.title or result.source)
    rows = [] if case.status == "ok" else [("status", case.status)]
    if name := only_actuator(case, result.scene):
        rows.append(("only actuator driven", name))
    rows.append(("localization factor", output.number_text(case.localization_factor, ".4f")))
    for region, energy in case.energy.items():
        label = f"kinetic energy of the {region}, averaged over the window"
        rows.append((label, output.number_text(energy, ".4g", " J")))
    rows.append(("largest displacement during the run", output.number_text(result.peak_displacement, ".4g", " m")))
    output.print_rows(console, ("quantity", "value"), rows, "")
    tables.print_motion(result.cases, result.scene, console)
    tables.print_cost(result, console, elapsed=main.elapsed())
