"""Pictures of a whole result: figure 2 of the source paper, and every plot that it holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warp_plate.result.atomic_io import atomic_path
from warp_plate.result.case import only_actuator
from warp_plate.result.model import Result
from warp_plate.viz.annotations import add_legend, at_frequency, caption, case_label, name_actuators, ordered_cases
from warp_plate.viz.availability import missing_plots, missing_renderer, prepare
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, drawing_scale
from warp_plate.viz.pictures import SUPERSAMPLING, off_screen_plotter
from warp_plate.viz.plots.plan import draw_crosstalk
from warp_plate.viz.plots.search import draw_history, draw_robust, draw_spectrum
from warp_plate.viz.scene3d import PlateActors

# Most plates in a row; of more recorded times, some are left out evenly.
MOST_COLUMNS = 6
# In pixels.
FONT_SIZE, ROW_HEIGHT, KEY_WIDTH = 20, 480, 180


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
