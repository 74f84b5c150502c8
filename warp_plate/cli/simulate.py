"""``warp-plate simulate SCENE``: one plate under one drive."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import cyclopts

from warp_plate.cli import output


def simulate(
    scene: str,
    /,
    *,
    drive: str = "scene",
    device: str = "auto",
    path: Literal["auto", "resident", "streaming"] = "auto",
    accuracy: str | None = None,
    estimate: bool = True,
    allow_unstable: Annotated[bool, cyclopts.Parameter(negative="")] = False,
    out: Path | None = None,
    pictures: bool = True,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Run one plate under one drive.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file.
    drive
        scene (the magnitudes and phases in the scene), equal, single (the best single actuator), or a result file
        (.h5), whose best drive is taken.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.
    path
        How plates are stepped: resident (all steps in one launch) or streaming (one or a few steps a launch).
    accuracy
        Such as 1% or 0.01: the relative error that localization factors may have, instead of the scene's grid.
    estimate
        End with an estimate of the result's error.
    allow_unstable
        Run a time step above the stability limit too, until its growth is seen and told as the plate's status.
    out
        The result file (.h5); SCENE-simulate.h5 in this folder when left out. Pictures are written beside it.
    pictures
        Draw the displacement at the recorded times (needs the extra viz).
    json
        Print one JSON object instead of tables.
    """
    target = output.output_file(out, scene, "simulate")
    loaded = output.load_scene(scene, accuracy, allow_unstable)
    output.prepare_pictures(pictures)
    from warp_plate.studies.simulate import simulate as run

    with output.progress_bar("simulating", shown=not json) as show:

        def told(done: int, total: int) -> None:
            show(done, total, f"{done:.2g} node-steps")

        result = run(loaded, scene, drive, device, path, told, estimate, allow_unstable)
    case = result.cases["drive"]
    files, missing = output.write_files(result, target, pictures)
    if json:
        output.print_json(
            {
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
        )
        return
    console = output.console()
    console.print(result.scene.title or result.source)
    made = output.table("quantity", "value")
    if case.status != "ok":
        made.add_row("status", case.status)
    made.add_row("localization factor", output.known(case.localization_factor, ".4f"))
    for region, energy in case.energy.items():
        made.add_row(f"kinetic energy of the {region}, averaged over the window", output.known(energy, ".4g", " J"))
    made.add_row("largest displacement seen over the run", output.known(result.peak_displacement, ".4g", " m"))
    console.print(made)
    console.print(
        f"{result.node_steps:.3g} node-steps on {result.device}, {result.path}: {result.seconds['solve']:.2f} s "
        f"solving after {result.seconds['compile']:.2f} s compiling or loading kernels. Effects compiled in: "
        f"{', '.join(result.effects) or 'none'}."
    )
    output.print_accuracy(result, console)
    output.print_warnings(result, console)
    output.print_files(files, missing)
