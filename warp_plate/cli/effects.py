"""``warp-plate effects SCENE``: what each effect costs and changes, and what the scene calls for."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import cyclopts

from warp_plate.cli import output

if TYPE_CHECKING:
    from warp_plate.analysis.influence import EffectToggle, Influence
    from warp_plate.analysis.warnings import Finding
    from warp_plate.scene.model import Scene


def effects(
    scene: str,
    /,
    *,
    device: str = "auto",
    accuracy: str | None = None,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Show every effect, on or off, its price and its influence, and what the scene calls for but does not name.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.
    accuracy
        Such as 1% or 0.01: take the grid that keeps localization factors to it, instead of the scene's.
    json
        Print one JSON object instead of tables.
    """
    loaded = output.load_scene(scene, accuracy)
    from warp_plate.analysis.influence import measure_influence
    from warp_plate.analysis.warnings import find_warnings
    from warp_plate.studies.localize import resolve

    loaded = resolve(loaded, device)[0]
    with output.progress_bar("switching", shown=not json) as show:
        found = measure_influence(loaded, device, show)
    numbers = find_warnings(loaded, found.peak)
    if json:
        output.print_json(
            {
                "scene": scene,
                "localization_factor": found.localization_factor,
                "peak_displacement": found.peak,
                "bare_step_seconds": found.bare_step,
                "effects": [asdict(switch) for switch in found.switches],
                "numbers": [asdict(number) for number in numbers],
                "warnings": [number.sentence for number in numbers if number.exceeded],
            }
        )
        return
    _print(scene, loaded, found, numbers)


def _print(name: str, scene: Scene, found: Influence, numbers: list[Finding]) -> None:
    console = output.console()
    console.print(f"{scene.title or name}\n")
    made = output.table("effect", "now", "price of a step", "steps", "factor", "largest displacement (m)")
    made.add_row("the scene as it is", "", "", "", f"{found.localization_factor:.4f}", f"{found.peak:.3g}")
    for switch in found.switches:
        made.add_row(*_row(switch))
    console.print(made)
    console.print(
        f"\nPrice: what the effect adds to a step, in % of the bare plate's ({found.bare_step:.2g} s), measured. "
        "Steps: how many times as many the run takes with it. Factor (localization) and displacement: with the effect "
        "switched to its other state, under the scene's own drive:\n"
    )
    for switch in found.switches:
        console.print(f"{'without' if switch.on else 'with'} {_words(switch.name)}: {switch.switched}")
    console.print()
    for number in numbers:
        console.print(f"{'! ' if number.exceeded else '  '}{number.sentence}")


def _row(switch: EffectToggle) -> list[str]:
    start = [_words(switch.name), "on" if switch.on else "off"]
    if switch.price is None:
        return [*start, "refused", "", "", ""]
    return [
        *start,
        f"{switch.price:+.0f} ± {switch.spread:.0f} %",
        f"× {switch.steps:.3g}",
        f"{switch.localization_factor:.4f}",
        f"{switch.peak:.3g}",
    ]


def _words(name: str) -> str:
    return "free or springy edges" if name == "edges" else name.replace("_", " ")
