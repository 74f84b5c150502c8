"""The paper's figures from a result: displacement surfaces (figure 2), loss against iteration (figure 3)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.atomic_io import atomic_path
from warp_plate.result.model import Case, Result
from warp_plate.viz.availability import missing, missing_plots, off_screen, prepare
from warp_plate.viz.comparison import drive_words, ordered
from warp_plate.viz.lettering import add_legend
from warp_plate.viz.plots.axes import first_of_several
from warp_plate.viz.plots.crosstalk import draw_crosstalk
from warp_plate.viz.plots.robust import draw_robust
from warp_plate.viz.plots.spectrum import draw_spectrum
from warp_plate.viz.quantity import scale_over
from warp_plate.viz.scene3d import add_plate
from warp_plate.viz.surface import caption

if TYPE_CHECKING:
    import pyvista
    from matplotlib.axes import Axes

# A row has at most this many pictures; of more times, some that lie evenly between first and last are drawn.
COLUMNS = 6
# Drawn so many times larger and shrunk, for VTK's own smoothing (SSAA) garbles subplots in VTK 9.4. Twice looks hardly
# better and takes a second longer where a processor draws.
SMOOTHING = 1.25
# In pixels.
FONT_SIZE = 20
ROW_HEIGHT = 480
BAR_WIDTH = 180
# What the mean of an iteration's losses is of, by method; "exact" tries one drive alone.
MEANS = dict.fromkeys(("pso", "constriction", "ring"), "swarm mean")
MEANS |= {"cma": "mean of the generation", "gradient": "mean of the descents"}
# The localization factor that the paper reports for its swarm, as a loss.
PUBLISHED_LOSS = 0.28


def draw_all(result: Result, stem: str | Path) -> tuple[list[Path], str | None]:
    """Draw what the result holds: ``<stem>-history.png``, ``-robust``, ``-crosstalk``, ``-spectrum`` and ``-surfaces``.

    Nothing that is wrong with a library or a file ends the run.

    Returns:
        The files written, and None or why others are missing: a sentence for each, joined by "; ".
    """
    jobs: list[tuple[Callable[[Result, Path], Path], str, Callable[[], str | None]]] = []
    if result.history:
        jobs.append((draw_history, "history", missing_plots))
    if result.robust is not None and np.isfinite(result.robust.validation).any():
        jobs.append((draw_robust, "robust", missing_plots))
    if result.spectrum:
        jobs.append((draw_spectrum, "spectrum", missing_plots))
    if result.scene.targets and result.command == "localize":
        jobs.append((draw_crosstalk, "crosstalk", missing_plots))
    if result.times.size:
        prepare()
        jobs.append((draw_surfaces, "surfaces", missing))
    written, problems = [], []
    for draw, name, lacking in jobs:
        path = Path(f"{stem}-{name}.png")
        problem = lacking()
        if problem is None:
            try:
                with atomic_path(path) as temporary:
                    draw(result, temporary)
                written.append(path)
            except OSError as error:
                problem = f"{path}: cannot be written: {error}"
        if problem is not None:
            problems.append(problem)
    return written, "; ".join(problems) or None


def draw_surfaces(result: Result, path: str | Path) -> Path:
    """Figure 2 of the paper as a PNG: a row for each drive, a column for each recorded time.

    A row has its own colour limits and height factor, the same at all its times; the camera is everywhere
    the same.

    Raises:
        ValueError: the result holds no displacement.
        DrawingUnavailable: VTK cannot draw here; says what to install.
        OSError: the file cannot be written.
    """
    if not result.times.size:
        raise ValueError("the result holds no displacement: record.times of its scene is empty")
    with off_screen():
        return _draw_surfaces(result, Path(path))


def draw_history(result: Result, path: str | Path, form: str | None = None) -> Path:
    """Figure 3 of the paper: loss against iteration; PNG, SVG or PDF by ``form`` or ending.

    The loss is 1 − localization factor, or less the weighted sum of what else is sought.

    Of several targets it is the first one's. The bound is a line where the result claims one; the published final loss
    stands beside it for the preset "paper" only.

    Raises:
        ValueError: the result holds no history of a search, or Matplotlib does not know the ending.
        OSError: the file cannot be written.
    """
    if not result.history:
        raise ValueError("the result holds no history: only a search leaves one")
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context({"font.size": 9, "axes.linewidth": 0.8, "svg.hashsalt": "warp-plate"}):
        figure = Figure(figsize=(5, 3.2), layout="constrained")
        FigureCanvasAgg(figure)
        _plot_history(figure.add_subplot(), result)
        figure.savefig(path, dpi=320, format=form)
    return Path(path)


def _plot_history(axes: Axes, result: Result) -> None:
    from matplotlib.ticker import MaxNLocator

    localization = result.only_localization
    top = 1 if localization else 0
    best = top - np.fmax.accumulate(_finite(result.history["best"]))
    iteration = np.arange(1, best.size + 1)
    marker = "." if best.size < 10 else None
    words = MEANS.get(result.scene.search.method)
    if "mean" in result.history and words is not None:
        mean = top - _finite(result.history["mean"])
        axes.plot(iteration, mean, color="#9ecae1", linewidth=1.0, marker=marker, label=words)
    axes.plot(iteration, best, color="#08519c", linewidth=1.6, marker=marker, label="best so far")
    # Of a robust search the history is of its measure, which has a bound of its own.
    bound, kind = result.bound if localization else result.objective_values.get("bound"), result.bound_kind
    if result.scene.search.robust is not None:
        bound, kind = getattr(result.robust, "bound", None), "bound only"
    if bound is not None:
        loss, only = top - bound, " only" if kind == "bound only" else ""
        label = f"bound{only}: {loss:.4f}".replace("-", "−")
        axes.axhline(loss, color="#b2182b", linewidth=1.0, linestyle="--", label=label)
    if result.source == "paper":
        label = f"published: {PUBLISHED_LOSS:g}"
        axes.axhline(PUBLISHED_LOSS, color="#8a8a8a", linewidth=1.0, linestyle=":", label=label)
    axes.set_title(first_of_several(result.scene), fontsize=9, wrap=True)
    axes.set_xlabel("iteration")
    axes.set_ylabel("loss (1 − localization factor)" if localization else "loss (− weighted sum of objectives)")
    axes.set_xlim((1, best.size) if best.size > 1 else (0, 2))
    axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)


def _finite(values: np.ndarray) -> np.ndarray:
    """Gaps where a value is not finite: Matplotlib cannot scale an axis to infinity."""
    return np.where(np.isfinite(values), values, np.nan)


def _draw_surfaces(result: Result, path: Path) -> Path:
    import pyvista
    from PIL import Image

    cases = list(ordered(result).items())
    shown = _evenly(result.times.size, COLUMNS)
    cell = min(730, max(520, (1600 - BAR_WIDTH) // len(shown)))
    width, height = cell * len(shown) + BAR_WIDTH, ROW_HEIGHT * len(cases)
    plotter = pyvista.Plotter(
        off_screen=True,
        shape=(len(cases), len(shown) + 1),
        col_weights=[cell] * len(shown) + [BAR_WIDTH],
        border=False,
        window_size=[round(SMOOTHING * width), round(SMOOTHING * height)],
        theme=pyvista.themes.DocumentTheme(),
        lighting="none",
    )
    try:
        for row, (name, case) in enumerate(cases):
            letter = f"({chr(ord('a') + row)}) " if len(cases) > 1 else ""
            _draw_row(plotter, row, result, letter + drive_words(name, result.scene), case, shown)
        # With VTK's smoothing, wide lines are broken here and there.
        plotter.disable_anti_aliasing()
        large = plotter.screenshot(return_img=True)
    finally:
        plotter.close()
    picture = Image.fromarray(np.asarray(large)).resize((width, height), Image.Resampling.LANCZOS)
    picture.save(path, format="PNG", compress_level=3)
    return path


def _draw_row(
    plotter: pyvista.Plotter, row: int, result: Result, drive: str, case: Case, shown: list[int]
) -> None:
    font_size = round(SMOOTHING * FONT_SIZE)
    scale = scale_over([case.displacement], result.scene.plate.size)
    for column, index in enumerate(shown):
        plotter.subplot(row, column)
        text = caption(drive, float(result.times[index]), case.localization_factor)
        add_plate(plotter, result.case_scene(case), case.displacement[index], scale, text, font_size, bar=False)
    plotter.subplot(row, len(shown))
    add_legend(plotter, result.scene, scale, font_size)


def _evenly(size: int, largest: int) -> list[int]:
    """Indices of at most ``largest`` of ``size`` things, first and last among them, evenly between."""
    return np.unique(np.linspace(0, size - 1, min(size, largest)).round().astype(int)).tolist()
