"""``warp-plate check SCENE``: the numerics and cost of a scene, without running it."""

from __future__ import annotations

from warp_plate.cli import options, output


def check(
    scene: options.SceneName,
    /,
    *,
    device: options.Device = "auto",
    accuracy: options.Accuracy | None = None,
    allow_unstable: options.AllowUnstable = False,
    json: options.Json = False,
) -> None:
    """Show the time step and its limit, points per wavelength, condition, memory and stepping path of a scene."""
    loaded = output.load_scene(scene, accuracy)
    from warp_plate.analysis.check import check as check_scene
    from warp_plate.studies.grid_choice import resolve_grid

    with output.scene_errors(scene):
        found = check_scene(resolve_grid(loaded, device).scene, device, allow_unstable)
    if json:
        output.print_json({"scene": scene, **found.as_json()})
        return
    console = output.console()
    console.print(f"{loaded.title or scene}\n")
    for sentence in found.sentences():
        console.print(sentence)
    console.print()
    for finding in found.findings:
        console.print(f"{'! ' if finding.exceeded else '  '}{finding.sentence}")
