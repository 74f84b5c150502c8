"""``warp-plate check SCENE``: the numerics and cost of a scene, without running it."""

from __future__ import annotations

from rich.console import Console

from warp_plate.cli import options, output


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
    """Show the time step and its limit, points per wavelength, condition, memory and stepping path of a scene."""
    loaded, scene = output.load_scene(scene, assignments, accuracy)
    from warp_plate.analysis.check import check as check_scene
    from warp_plate.modal.solver import MODAL
    from warp_plate.studies.grid_choice import resolve_search_grid

    with output.scene_errors(scene):
        resolved = resolve_search_grid(loaded, device)
        found = check_scene(resolved.scene, device, allow_unstable, resolved.evaluator == MODAL)

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n", *found.sentences(), "", sep="\n")
        output.print_findings(found.findings, console)

    output.report(json, lambda: {"scene": scene, **found.as_json()}, show)
