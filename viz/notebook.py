"""HTML of scenes and results for notebooks: tables, and a picture as PNG or a sentence on why there is none."""

from __future__ import annotations

import base64
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from warp_plate.result.amplitudes import amplitude_column
from warp_plate.result.model import BOUND_DESCRIPTIONS, Result, only_actuator
from warp_plate.scene.model import Scene
from warp_plate.viz.availability import missing_plots, missing_renderer
from warp_plate.viz.captions import case_label, ordered_cases, percent
from warp_plate.viz.figures import draw_history, draw_surfaces
from warp_plate.viz.plots.plan import draw_layout
from warp_plate.viz.styles import EDGE_STYLES, edges_by_kind, size_text

# Headings and rows.
Table = tuple[Sequence[str], Sequence[Sequence[str]]]


def scene_html(scene: Scene) -> str:
    """Return the settings of a scene, its actuators, and a picture of its layout."""
    heading, amplitudes = amplitude_column(scene, [item.magnitude for item in scene.actuators], "g")
    headings = ("actuator", "x, y (m)", heading, "phase (rad)")
    rows = [
        (item.name, _area(item.area), amplitude, f"{item.phase:.4g}")
        for item, amplitude in zip(scene.actuators, amplitudes, strict=True)
    ]
    picture = _picture(lambda path: draw_layout(scene, path), missing_plots())
    tables = [((), _scene_rows(scene)), (headings, rows)]
    return _html(scene.title or "Scene", tables, [], picture, "Layout of the plate")


def result_html(result: Result) -> str:
    """Return localization factors, the best drive, notes on the error, and a picture of the plate."""
    scene = result.scene
    cases = ordered_cases(result).items()
    rows = [
        (case_label(name, scene, only_actuator(case, scene)), percent(case.localization_factor)) for name, case in cases
    ]
    if result.bound is not None:
        target = f", target {scene.targets[0].name}" if result.target_searches else ""
        rows.append((BOUND_DESCRIPTIONS[result.bound_kind] + target, percent(result.bound)))
    name, case = result.main_name, result.main_case
    label = case_label(name, scene)
    heading, amplitudes = amplitude_column(scene, case.magnitude, ".4f")
    actuators = [
        (actuator.name, amplitude, f"{phase:.4f}", f"{phase / math.pi:.4f}", *(f"{x:.5g}" for x in others))
        for actuator, amplitude, phase, *others in zip(
            scene.actuators, amplitudes, case.phase, *case.per_actuator.values(), strict=True
        )
    ]
    headings = (f"actuator, {label}", heading, "phase (rad)", "phase / π", *case.per_actuator)
    tables = [(("drive", "localization factor"), rows), (headings, actuators)]
    notes = [
        "Interrupted by Ctrl-C: the best so far is shown." if result.interrupted else "",
        result.accuracy.get("estimate", {}).get("line", ""),
        f"{result.node_steps:.3g} node-steps in {result.seconds.get('solve', math.nan):.2f} s on {result.device}.",
    ]
    title = scene.title or result.source or "Result"
    return _html(title, tables, notes, _result_picture(result), f"Plate under the {label}")


def _result_picture(result: Result) -> bytes | str:
    """Return a PNG of the displacements of the shown case, or of the search's history; or why there is none."""
    single = replace(result, cases={result.main_name: result.main_case})
    problem = missing_renderer() if result.times.size else "the result holds nothing to draw"
    if problem is not None and result.history:
        return _picture(lambda path: draw_history(single, path), missing_plots())
    return _picture(lambda path: draw_surfaces(single, path), problem)


def _picture(draw: Callable[[Path], object], problem: str | None) -> bytes | str:
    if problem is not None:
        return problem
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "picture.png")
            draw(path)
            return path.read_bytes()
    except OSError as error:
        return f"no picture: {error}"


def _html(title: str, tables: Sequence[Table], notes: Sequence[str], picture: bytes | str, alt: str) -> str:
    root = Element("div")
    SubElement(root, "strong").text = title
    columns = SubElement(root, "div", {"style": "display: flex; flex-wrap: wrap; gap: 2em; align-items: flex-start"})
    for headings, rows in tables:
        table = SubElement(columns, "table")
        for cell, texts in [("th", headings)] * bool(headings) + [("td", row) for row in rows]:
            line = SubElement(table, "tr")
            for index, text in enumerate(texts):
                align = "right" if index and headings else "left"
                SubElement(line, cell, {"style": f"text-align: {align}"}).text = text or "–"
    for note in filter(None, [*notes, picture] if isinstance(picture, str) else notes):
        SubElement(root, "p").text = note
    if isinstance(picture, bytes):
        source = f"data:image/png;base64,{base64.b64encode(picture).decode()}"
        SubElement(root, "img", {"src": source, "alt": alt, "style": "max-width: 100%"})
    return tostring(root, encoding="unicode")


def _scene_rows(scene: Scene) -> list[tuple[str, str]]:
    plate, grid = scene.plate, scene.grid
    edges = [f"{EDGE_STYLES[kind].label}: {', '.join(names)}" for kind, names in edges_by_kind(scene).items()]
    resolution = f"{grid.nodes[0]} × {grid.nodes[1]} nodes, order {grid.order}, load by {grid.load}, {grid.precision}"
    if grid.accuracy is not None:
        resolution = f"for a relative error of {100 * grid.accuracy:g} %"
    targets = {f"target {target.name}": target for target in scene.targets} or {"target": scene.target}
    return [
        ("plate", f"{size_text(plate.size)}, {1000 * plate.thickness:g} mm thick"),
        ("material", f"E = {plate.young_modulus:g} Pa, ν = {plate.poisson_ratio:g}, ρ = {plate.density:g} kg/m³"),
        ("edges", "; ".join(edges)),
        ("grid", resolution),
        ("drive", f"{scene.drive.frequency:g} Hz"),
        ("energy averaged", f"{scene.window.start:g} … {scene.window.end:g} s"),
        *((name, f"{_area(t.area)} m" if t.area is not None else t.description) for name, t in targets.items()),
        ("effects", ", ".join(name.replace("_", " ") for name, value in scene.effects if value)),
        ("search", f"{scene.search.particles} particles × {scene.search.iterations} iterations"),
    ]


def _area(area: Sequence[float]) -> str:
    x0, x1, y0, y1 = area
    return f"{x0:g} … {x1:g}, {y0:g} … {y1:g}"
