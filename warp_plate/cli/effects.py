"""``warp-plate effects SCENE``: cost and influence of each effect, and effects that the scene calls for."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from warp_plate.cli import options, output
from warp_plate.cli.tables import print_findings

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.analysis.influence import Influence


def effects(
    scene: options.SceneName,
    /,
    *,
    assignments: options.Assignments = None,
    device: options.Device = "auto",
    accuracy: options.Accuracy | None = None,
    json: options.Json = False,
) -> None:
    """Show the cost and influence of every effect, on or off, and suggest effects that the scene lacks."""
    loaded, scene = output.load_scene(scene, assignments, accuracy)
    from warp_plate.analysis.influence import measure_influence
    from warp_plate.analysis.warnings import find_warnings
    from warp_plate.studies.grid_choice import resolve_grid

    with output.scene_errors(scene):
        loaded = resolve_grid(loaded, device, engine="steps" if loaded.modal_only_key is None else "modes").scene
        with output.progress_bar("switching effects", shown=not json) as progress:
            found = measure_influence(loaded, device, progress)
    findings = find_warnings(loaded, found.peak)
    record = {
        "scene": scene,
        "localization_factor": found.localization_factor,
        "peak_displacement": found.peak,
        "bare_step_seconds": found.bare_step,
        "effects": [asdict(switch) for switch in found.toggles],
        "numbers": [asdict(finding) for finding in findings],
        "warnings": [finding.sentence for finding in findings if finding.exceeded],
    }

    def show(console: Console) -> None:
        console.print(f"{loaded.title or scene}\n")
        _print(found, console)
        print_findings(findings, console)

    output.report(json, lambda: record, show)


def _print(found: Influence, console: Console) -> None:
    costs = () if found.bare_step is None else ("price of a step", "steps")
    made = output.table("effect", "now", *costs, "factor", "largest displacement (m)")
    blank = [""] * len(costs)
    made.add_row("the scene as it is", "", *blank, *_moved(found.localization_factor, found.peak))
    for switch in found.toggles:
        cells = ["refused"]
        if switch.localization_factor is not None:
            cells = _moved(switch.localization_factor, switch.peak)
        if switch.price is not None:
            cells = [f"{switch.price:+.0f} ± {switch.deviation:.0f} %", f"× {switch.steps:.3g}", *cells]
        made.add_row(_words(switch.name), "on" if switch.on else "off", *cells)
    console.print(made)
    price = "\nThe scene is solved by modes, without steps, so no cost is measured. "
    if found.bare_step is not None:
        price = (
            "\nPrice: time that the effect adds to a step, in % of the bare plate's step "
            f"({found.bare_step:.2g} s), measured. Steps: factor by which it changes the number of steps. "
        )
    console.print(
        price + "Factor (localization) and displacement: with the effect switched on or off, under the scene's own "
        "drive:\n"
    )
    for switch in found.toggles:
        console.print(f"{'without' if switch.on else 'with'} {_words(switch.name)}: {switch.alternative}")
    console.print()


def _moved(localization_factor: float, peak: float | None) -> list[str]:
    return [output.number_text(localization_factor, ".4f"), output.number_text(peak, ".3g")]


def _words(name: str) -> str:
    return "free or springy edges" if name == "edges" else name.replace("_", " ")
