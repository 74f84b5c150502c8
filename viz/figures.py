"""Pictures of a whole result: figure 2 of the source paper, every plot that it holds, and HTML for notebooks."""

from __future__ import annotations

import base64
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from warp_plate.result.atomic_io import atomic_path
from warp_plate.result.case import amplitude_column, only_actuator
from warp_plate.result.model import BOUND_DESCRIPTIONS, Result
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import (
    add_legend,
    at_frequency,
    caption,
    case_label,
    in_percent,
    name_actuators,
    ordered_cases,
)
from warp_plate.viz.availability import missing_plots, missing_renderer, prepare
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, drawing_scale
from warp_plate.viz.pictures import SUPERSAMPLING, off_screen_plotter
from warp_plate.viz.plots.plan import draw_crosstalk, draw_layout
from warp_plate.viz.plots.search import draw_history, draw_robust, draw_spectrum
from warp_plate.viz.scene3d import PlateActors
from warp_plate.viz.styles import EDGE_STYLES, edges_by_kind, size_text

# Most plates in a row; of more recorded times, some are left out evenly.
MOST_COLUMNS = 6
# In pixels.
FONT_SIZE, ROW_HEIGHT, KEY_WIDTH = 20, 480, 180
# Headings and rows.
TextTable = tuple[Sequence[str], Sequence[Sequence[str]]]


def draw_all(
    result: Result, stem: str | Path, colours: ColourOptions = DEFAULT_COLOURS
) -> tuple[list[Path], str | None]:
    """Draw all that the result holds, as ``<stem>-history.png``, ``<stem>-surfaces.png`` and so on.

    Colours are those of fields over the plate. Returns the files written, and None or a sentence for each missing one,
    joined by "; ".
    """
    compared = result.robust is not None and bool(np.isfinite(result.robust.validation).any())
    several = bool(result.scene.targets) and result.command == "localize"
    jobs = {
        draw_history: len(result.history.get("best", ())) > 1,
        draw_robust: compared,
        draw_spectrum: result.spectrum,
        draw_crosstalk: several,
        draw_surfaces: result.times.size,
    }
    if result.times.size:
        prepare()
    written, problems = [], []
    for draw in (draw for draw, held in jobs.items() if held):
        path = Path(f"{stem}-{draw.__name__.removeprefix('draw_')}.png")
        problem = missing_renderer() if draw is draw_surfaces else missing_plots()
        if problem is None:
            try:
                with atomic_path(path) as temporary:
                    draw(result, temporary, **({"colours": colours} if draw in (draw_crosstalk, draw_surfaces) else {}))
                written.append(path)
            except OSError as error:
                problem = f"{path}: cannot be written: {error}"
        if problem is not None:
            problems.append(problem)
    return written, "; ".join(problems) or None


def draw_surfaces(result: Result, path: str | Path, colours: ColourOptions = DEFAULT_COLOURS) -> None:
    """Draw figure 2 of the paper as a PNG: a row for each case, by default with limits of its own, a column for each
    recorded time.

    Raises ValueError if the result holds no displacement, and DrawingUnavailable if VTK cannot draw here.
    """
    if not result.times.size:
        raise ValueError("the result holds no displacement: record.times of its scene is empty")
    cases, scene = ordered_cases(result), result.scene
    times = result.times.size
    shown = np.linspace(0, times - 1, min(times, MOST_COLUMNS)).round().astype(int).tolist()
    width = min(730, max(520, (1600 - KEY_WIDTH) // len(shown)))
    size = (width * len(shown) + KEY_WIDTH, ROW_HEIGHT * len(cases))
    font_size = round(SUPERSAMPLING * FONT_SIZE)
    weights = [width] * len(shown) + [KEY_WIDTH]
    with off_screen_plotter(size, shape=(len(cases), len(shown) + 1), col_weights=weights) as (plotter, take_picture):
        for row, (name, case) in enumerate(cases.items()):
            letter = f"({chr(ord('a') + row)}) " if len(cases) > 1 else ""
            together = cases.values() if colours.limits == "common" else [case]
            scale = drawing_scale(
                [shown_case.displacement for shown_case in together], scene.plate.size, colours=colours
            )
            driven = result.case_scene(case)
            tone = at_frequency(scene, driven.drive.frequency)
            for column, index in enumerate(shown):
                plotter.subplot(row, column)
                label = letter + case_label(name, scene, only_actuator(case, scene))
                text = caption(label, float(result.times[index]), case.localization_factor, tone=tone)
                field = case.displacement[index]
                PlateActors(plotter, driven, field, scale, text, font_size, bar=False)
                name_actuators(plotter, driven, scale.warp_factor * field, round(0.75 * font_size))
            plotter.subplot(row, len(shown))
            add_legend(plotter, scene, scale, font_size)
        take_picture().save(path, format="PNG", compress_level=3)


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
        (case_label(name, scene, only_actuator(case, scene)), in_percent(case.localization_factor))
        for name, case in cases
    ]
    if result.bound is not None:
        target = f", target {scene.targets[0].name}" if result.target_searches else ""
        rows.append((BOUND_DESCRIPTIONS[result.bound_kind] + target, in_percent(result.bound)))
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
    seconds = result.seconds.get("solve", math.nan)
    notes = [
        "Interrupted by Ctrl-C: the best so far is shown." if result.interrupted else "",
        result.accuracy.get("estimate", {}).get("line", ""),
        "" if result.by_modes else f"{result.node_steps:.3g} node-steps in {seconds:.2f} s on {result.device}.",
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


def _html(title: str, tables: Sequence[TextTable], notes: Sequence[str], picture: bytes | str, alt: str) -> str:
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
