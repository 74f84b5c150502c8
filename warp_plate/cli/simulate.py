"""``warp-plate simulate SCENE``: one plate under one drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.cli import options, output

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.model import Result


def simulate(
    scene: options.SceneName,
    /,
    *,
    drive: str = "scene",
    device: options.Device = "auto",
    path: options.Stepping = "auto",
    accuracy: options.Accuracy | None = None,
    estimate: options.Estimate = True,
    allow_unstable: options.AllowUnstable = False,
    out: Path | None = None,
    pictures: options.Pictures = True,
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
    target = output.output_file(out, scene, "simulate")
    loaded = output.load_scene(scene, accuracy)
    output.prepare_pictures(pictures)
    from warp_plate.studies.simulate import simulate as run

    with output.scene_errors(scene), output.progress_bar("simulating", shown=not json) as show:

        def on_progress(done: int, total: int) -> None:
            show(done, total, f"{done:.2g} node-steps")

        result = run(loaded, scene, drive, device, path, on_progress, estimate, allow_unstable)
    files, missing = output.write_result(result, target, pictures)
    if json:
        output.print_json(_as_json(result, files))
        return
    _print(result, output.console())
    output.print_files(files, missing)


def _as_json(result: Result, files: list[Path]) -> dict[str, object]:
    case = result.cases["drive"]
    return {
        "scene": result.source,
        "device": result.device,
        "status": case.status,
        "path": result.path,
        "localization_factor": case.localization_factor,
        "energy": dict(case.energy),
        "peak_displacement": result.peak_displacement,
        "node_steps": result.node_steps,
        "seconds": dict(result.seconds),
        "effects": list(result.effects),
        "accuracy": dict(result.accuracy),
        "warnings": output.warnings_of(result),
        "files": [str(file) for file in files],
    }


def _print(result: Result, console: Console) -> None:
    case = result.cases["drive"]
    console.print(result.scene.title or result.source)
    made = output.table("quantity", "value")
    if case.status != "ok":
        made.add_row("status", case.status)
    made.add_row("localization factor", output.number_text(case.localization_factor, ".4f"))
    for region, energy in case.energy.items():
        label = f"kinetic energy of the {region}, averaged over the window"
        made.add_row(label, output.number_text(energy, ".4g", " J"))
    made.add_row("largest displacement during the run", output.number_text(result.peak_displacement, ".4g", " m"))
    console.print(made)
    output.print_cost(result, console)
