"""``warp-plate check SCENE``: the numerics and cost of a scene, without running it."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from warp_plate.cli import options, output
from warp_plate.cli.tables import print_findings


def check(
    scene: options.SceneName,
    /,
    *,
    assignments: options.Assignments = None,
    device: options.Device = "auto",
    accuracy: options.Accuracy | None = None,
    allow_unstable: options.AllowUnstable = False,
    json: options.Json = False,
) -> None:
    """Show what a scene is, warnings about it, and the numerics of its run: time step and its limit, points per
    wavelength, condition, memory and stepping path."""
    loaded, scene = output.load_scene(scene, assignments, accuracy)
    from warp_plate.analysis.check import check as check_scene
    from warp_plate.modal.solver import MODAL
    from warp_plate.studies.grid_choice import resolve_search_grid

    with output.scene_errors(scene):
        resolved = resolve_search_grid(loaded, device)
        found = check_scene(resolved.scene, device, allow_unstable, resolved.evaluator == MODAL)

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        console.print(_lines(found.summary), "")
        print_findings(found.findings, console)
        if found.numerics:
            console.print("", _lines(found.numerics))

    output.report(json, lambda: {"scene": scene, **found.as_json()}, show)


def _lines(texts: Mapping[str, str]) -> Table:
    made = Table.grid(padding=(0, 2, 0, 0))
    for name, text in texts.items():
        made.add_row(name, text)
    return made
