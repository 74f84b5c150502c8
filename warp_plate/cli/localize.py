"""``warp-plate localize SCENE``: the search, its table and its files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.cli.published import NOT_REPRODUCED, PUBLISHED

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.result.model import Result

TRIED = {"direct": "plates simulated for the swarm", "response": "drives tried by the swarm on the Gram matrices"}
MEANING = {
    "equal": "all actuators alike",
    "single": "best single actuator",
    "best": "found by the swarm",
    "bound": "bound: no drive passes it",
}


def localize(
    scene: str,
    /,
    *,
    device: str = "auto",
    seed: int | None = None,
    evaluator: Literal["direct", "response"] = "direct",
    path: Literal["auto", "resident", "streaming"] = "auto",
    accuracy: str | None = None,
    estimate: bool = True,
    out: Path | None = None,
    pictures: bool = True,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Search the drive that puts most of the plate's kinetic energy into the target.

    Every actuator's magnitude and phase is searched, with the first actuator's held at 1 and 0; those that the scene
    gives are for simulate.

    Parameters
    ----------
    scene
        A preset's name (paper, paper-supported) or a TOML file.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.
    seed
        Of the swarm; the scene's when left out.
    evaluator
        direct simulates a plate for each particle; response uses Gram matrices of unit responses instead.
    path
        How plates are stepped: resident (all steps in one launch) or streaming (one or a few steps a launch).
    accuracy
        Such as 1% or 0.01: the relative error that localization factors may have, instead of the scene's grid.
    estimate
        End with an estimate of the result's error.
    out
        The result file (.h5); SCENE-localize.h5 in this folder when left out. Pictures are written beside it.
    pictures
        Draw the displacements and the search's history (needs the extra viz).
    json
        Print one JSON object instead of tables.
    """
    target = output.output_file(out, scene, "localize")
    loaded = output.load_scene(scene, accuracy)
    output.prepare_pictures(pictures)
    from warp_plate.search.localize import localize as search

    with output.progress_bar("searching", shown=not json) as show:

        def told(done: int, total: int, best: float) -> None:
            show(done, total, f"best {best:.4f}")

        result = search(loaded, scene, device, seed, evaluator, path, told, estimate)
    files, missing = output.write_files(result, target, pictures)
    if json:
        output.print_json(as_json(result, files))
        return
    _print(result, output.console())
    for file in files:
        print(f"wrote {file}")
    if missing:
        print(missing)


def as_json(result: Result, files: list[Path]) -> dict[str, object]:
    """The object that ``--json`` prints."""
    best = result.cases["best"]
    factors = {name: case.localization_factor for name, case in result.cases.items()}
    history = {name: values.tolist() for name, values in result.history.items()}
    return {
        "scene": result.source,
        "device": result.device,
        "path": result.path,
        "seed": result.seed,
        "localization_factor": {**factors, "bound": result.bound},
        "drive": [
            {"actuator": actuator.name, "magnitude": magnitude, "phase": phase}
            for actuator, magnitude, phase in zip(
                result.scene.actuators, best.magnitude.tolist(), best.phase.tolist(), strict=True
            )
        ],
        "evaluations": result.evaluations,
        "node_steps": result.node_steps,
        "seconds": dict(result.seconds),
        "effects": list(result.effects),
        "history": [dict(zip(history, row, strict=True)) for row in zip(*history.values(), strict=True)],
        "evaluator": result.evaluator,
        "accuracy": dict(result.accuracy),
        "warnings": output.warnings_of(result),
        "interrupted": result.interrupted,
        "files": [str(file) for file in files],
    }


def _print(result: Result, console: Console) -> None:
    published = PUBLISHED if result.source == "paper" else {}
    factors = {name: case.localization_factor for name, case in result.cases.items()}
    headings = ("localization factor", "this run") + (("published",) if published else ())
    console.print(result.scene.title or result.source)
    made = output.table(*headings)
    for name, meaning in MEANING.items():
        value = result.bound if name == "bound" else factors[name]
        row = [meaning, "none claimed" if value is None else f"{value:.4f}"]
        made.add_row(*row, *([f"{published[name]:.4f}" if name in published else ""] if published else []))
    console.print(made)
    console.print()
    console.print(output.drive_table(result.cases["best"], result.scene))
    console.print()
    if result.interrupted:
        console.print("Interrupted by Ctrl-C: the best so far is shown.")
    if published:
        console.print(NOT_REPRODUCED)
    effects = ", ".join(result.effects) or "none"
    console.print(
        f"{result.evaluations} {TRIED[result.evaluator]}, {result.node_steps:.3g} node-steps in all on "
        f"{result.device}, {result.path}: {result.seconds['solve']:.2f} s solving after "
        f"{result.seconds['compile']:.2f} s compiling or loading kernels. Effects compiled in: {effects}."
    )
    output.print_accuracy(result, console)
    output.print_warnings(result, console)
