"""``warp-plate check SCENE``: what a scene asks of numbers and machine, without running it."""

from __future__ import annotations

from typing import Annotated

import cyclopts

from warp_plate.cli import output


def check(
    scene: str,
    /,
    *,
    device: str = "auto",
    accuracy: str | None = None,
    allow_unstable: Annotated[bool, cyclopts.Parameter(negative="")] = False,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Show the time step and its limit, what sets it, points a wavelength, condition, memory and path, in words.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file.
    device
        cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.
    accuracy
        Such as 1% or 0.01: take the grid that keeps localization factors to it, instead of the scene's.
    allow_unstable
        Go on where the time step is above the stability limit.
    json
        Print one JSON object instead of sentences.
    """
    loaded = output.load_scene(scene, accuracy, allow_unstable)
    from warp_plate.analysis.check import check as look
    from warp_plate.studies.localize import resolve

    found = look(resolve(loaded, device)[0], device, allow_unstable)
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
