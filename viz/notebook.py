"""How scenes and results show themselves in a notebook: a table and a picture, as HTML that needs nothing else.

This is what ``_repr_html_`` of the two returns. PyVista and Matplotlib are imported only for a result's picture, and a
sentence stands in its place where they are missing.
"""

from __future__ import annotations

import base64
import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from warp_plate.result.model import Case, Result
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target
from warp_plate.viz.availability import missing, missing_plots
from warp_plate.viz.comparison import drive_words, ordered
from warp_plate.viz.edges import NAMES, SIDES, edge_kind
from warp_plate.viz.figures import draw_history, draw_surfaces
from warp_plate.viz.plots.scene_plan import scene_plan

SIDE_BY_SIDE = "display: flex; flex-wrap: wrap; gap: 2em; align-items: flex-start"


def scene_html(scene: Scene) -> str:
    """What the scene says, its actuators, and its plan from above."""
    card = _card(scene.title or "Scene")
    body = SubElement(card, "div", {"style": SIDE_BY_SIDE})
    tables = SubElement(body, "div")
    _add_table(tables, (), _scene_rows(scene))
    rows = [
        (actuator.name, _area(actuator.area), f"{actuator.magnitude:g}", f"{actuator.phase:.4g}")
        for actuator in scene.actuators
    ]
    _add_table(tables, ("actuator", "x, y (m)", f"magnitude ({scene.drive_unit})", "phase (rad)"), rows)
    body.append(scene_plan(scene))
    return tostring(card, encoding="unicode")


def result_html(result: Result) -> str:
    """Localization factors, the drive found or given, what is known of the error, and a picture of the plate."""
    card = _card(result.scene.title or result.source or "Result")
    cases = ordered(result)
    rows = [(drive_words(name, result.scene), _share(case.localization_factor)) for name, case in cases.items()]
    if result.bound is not None:
        of = f", target {result.scene.targets[0].name}" if result.target_searches else ""
        rows.append((result.bound_description + of, _share(result.bound)))
    tables = SubElement(card, "div", {"style": SIDE_BY_SIDE})
    _add_table(tables, ("drive", "localization factor"), rows)
    name, case = shown_case(result)
    drive = [
        (actuator.name, f"{magnitude:.4f}", f"{phase:.4f}", f"{phase / math.pi:.4f}", *(f"{one:.5g}" for one in own))
        for actuator, magnitude, phase, *own in zip(
            result.scene.actuators, case.magnitude, case.phase, *case.per_actuator.values(), strict=True
        )
    ]
    words = drive_words(name, result.scene)
    magnitude = f"magnitude ({result.scene.drive_unit})"
    _add_table(tables, (f"actuator, {words}", magnitude, "phase (rad)", "phase / π", *case.per_actuator), drive)
    for line in _notes(result):
        SubElement(card, "p").text = line
    _add_picture(card, result, f"Displacement of the plate under the {words}")
    return tostring(card, encoding="unicode")


def shown_case(result: Result) -> tuple[str, Case]:
    """The best drive found, or else the first case."""
    return next((name, result.cases[name]) for name in ("best", *result.cases) if name in result.cases)


def picture(result: Result) -> tuple[bytes | None, str | None]:
    """A PNG of the best drive's displacements at the recorded times, else of the search's history; or why not.

    Nothing that is wrong with a library or a file raises.
    """
    name, case = shown_case(result)
    one = replace(result, cases={name: case})
    if result.times.size and (problem := missing()) is None:
        draw = draw_surfaces
    elif result.history and (problem := missing_plots()) is None:
        draw = draw_history
    else:
        return None, problem if result.times.size or result.history else "the result holds nothing to draw"
    try:
        with tempfile.TemporaryDirectory() as folder:
            return draw(one, Path(folder) / "picture.png").read_bytes(), None
    except OSError as error:
        return None, f"no picture: {error}"


def _card(title: str) -> Element:
    card = Element("div")
    SubElement(card, "strong").text = title
    return card


def _add_table(parent: Element, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table whose first column is text, left, and whose other columns are right where there are headings."""
    table = SubElement(parent, "table")
    if headings:
        line = SubElement(SubElement(table, "thead"), "tr")
        for heading in headings:
            SubElement(line, "th").text = heading
    body = SubElement(table, "tbody")
    for row in rows:
        line = SubElement(body, "tr")
        for index, text in enumerate(row):
            side = "right" if index and headings else "left"
            SubElement(line, "td", {"style": f"text-align: {side}"}).text = text or "–"


def _add_picture(card: Element, result: Result, words: str) -> None:
    drawn, problem = picture(result)
    if drawn is None:
        SubElement(card, "p").text = problem
        return
    source = f"data:image/png;base64,{base64.b64encode(drawn).decode()}"
    SubElement(card, "img", {"src": source, "alt": words, "style": "max-width: 100%"})


def _scene_rows(scene: Scene) -> list[tuple[str, str]]:
    plate, grid = scene.plate, scene.grid
    effects = [name.replace("_", " ") for name, value in scene.effects if value]
    chosen = (
        f"for a relative error of {100 * grid.accuracy:g} %"
        if grid.accuracy is not None
        else f"{grid.nodes[0]} × {grid.nodes[1]} nodes, order {grid.order}, load by {grid.load}, {grid.precision}"
    )
    return [
        ("plate", f"{plate.size[0]:g} m × {plate.size[1]:g} m, {1000 * plate.thickness:g} mm thick"),
        ("material", f"E = {plate.young_modulus:g} Pa, ν = {plate.poisson_ratio:g}, ρ = {plate.density:g} kg/m³"),
        ("edges", _edges(scene)),
        ("grid", chosen),
        ("drive", f"{scene.drive.frequency:g} Hz"),
        ("energy averaged", f"{scene.window.start:g} … {scene.window.end:g} s"),
        *_target_rows(scene),
        ("effects", ", ".join(effects)),
        ("search", f"{scene.search.particles} particles × {scene.search.iterations} iterations"),
    ]


def _target_rows(scene: Scene) -> list[tuple[str, str]]:
    named: dict[str, Target] = {f"target {target.name}": target for target in scene.targets}
    rows = named or {"target": scene.target}
    return [(name, f"{_area(one.area)} m" if one.area is not None else one.description) for name, one in rows.items()]


def _edges(scene: Scene) -> str:
    held = {name: SIDES[edge_kind(getattr(scene.edges, name))].words for name in NAMES}
    alike = set(held.values())
    return f"all {alike.pop()}" if len(alike) == 1 else ", ".join(f"{name} {words}" for name, words in held.items())


def _area(area: Sequence[float]) -> str:
    x0, x1, y0, y1 = area
    return f"{x0:g} … {x1:g}, {y0:g} … {y1:g}"


def _share(factor: float) -> str:
    return f"{100 * factor:.2f} %" if math.isfinite(factor) else "not defined"


def _notes(result: Result) -> list[str]:
    """What stands below the tables."""
    estimate = result.accuracy.get("estimate", {}).get("line")
    solved = f"{result.node_steps:.3g} node-steps in {result.seconds.get('solve', math.nan):.2f} s on {result.device}."
    early = "Interrupted by Ctrl-C: the best so far is shown." if result.interrupted else None
    return [line for line in (early, estimate, solved) if line]
