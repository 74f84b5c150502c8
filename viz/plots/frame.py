"""The parts shared by all Matplotlib plots: style, canvas, file, axis numbers."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.result.atomic_io import atomic_paths
from warp_plate.scene.errors import printable
from warp_plate.viz.availability import DrawingUnavailable, missing_plots
from warp_plate.viz.fields import SUPERSCRIPTS, unit_with_prefix

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure, FigureBase

# Powers of ten that tick labels may have; any other power is written once, with the unit.
PLAIN_POWERS = range(-1, 4)
# Matplotlib has one style for all threads.
_STYLING = threading.RLock()
STYLE = {"axes.linewidth": 0.8, "legend.frameon": False, "svg.hashsalt": "warp-plate"}


@contextmanager
def figure(
    paths: str | Path | Sequence[str | Path],
    size: tuple[float, float] | None = None,
    font_size: float = 9,
    dpi: float = 200,
    box: bool = False,
) -> Iterator[Figure]:
    """Yield an empty figure, and save it on leaving in the format of each path's ending, PNG, SVG or PDF.

    The size is in inches; ``box`` draws all four sides of every axes instead of the left and lower one.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    with _STYLING, rc_context({**STYLE, "font.size": font_size, "axes.spines.top": box, "axes.spines.right": box}):
        fig = Figure(figsize=size, dpi=dpi, layout="constrained")
        FigureCanvasAgg(fig)
        yield fig
        for text in fig.findobj(Text):  # names and titles may hold control characters and "$"
            text.set_text(printable(text.get_text()))
            if "$" in text.get_text():
                text.set_parse_math(False)
        engine = fig.get_layout_engine()
        assert engine is not None
        engine.execute(fig)
        fig.set_layout_engine(None)  # or each file would be drawn twice
        for path in [paths] if isinstance(paths, str | Path) else paths:
            # A PNG is compressed in half the time to a third more.
            options = {"pil_kwargs": {"compress_level": 2}} if Path(path).suffix == ".png" else {}
            fig.savefig(path, **options)


def add_panels(figure: FigureBase, count: int, columns: int, **options: Any) -> list[Axes]:
    """Add so many axes in rows of this many columns; the rest of the last row stays empty."""
    grid = figure.subplots(math.ceil(count / columns), columns, squeeze=False, **options).ravel()
    for axes in grid[count:]:
        axes.set_visible(False)
    return list(grid[:count])


def save_plots(
    draw: Callable[..., object], path: Path, endings: Sequence[str] = (".png", ".svg")
) -> tuple[list[Path], str | None]:
    """Draw a plot beside ``path`` with each ending, by a function of the paths; return the files, and why they are
    missing or None."""
    if (problem := missing_plots()) is not None:
        return [], problem
    targets = [path.with_suffix(ending) for ending in endings]
    try:
        with atomic_paths(*targets) as temporaries:
            draw(*temporaries)
    except (ValueError, OSError, DrawingUnavailable) as error:
        return [], f"no plot: {error}"
    return targets, None


def with_unit(label: str, unit: str) -> str:
    """Return the label of an axis with its unit, as "m^2/s^2" is stored; "1" is no unit."""
    unit = re.sub(r"\^(\d)", lambda power: power[1].translate(SUPERSCRIPTS), unit)
    return f"{label} [{unit}]".strip() if unit != "1" else label


def label_axis(axis: Axis, label: str, unit: str) -> None:
    """Label a linear axis, whose limits are set: lengths with a prefix, and the power of ten of other small and large
    numbers once, with the unit."""
    largest = float(np.abs(axis.get_view_interval()).max())
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    if unit == "m" and power < 0:
        unit, factor = unit_with_prefix(largest, unit)
        axis.set_major_formatter(lambda value, _: f"{value * factor:.6g}".replace("-", "−"))
    elif power not in PLAIN_POWERS:
        axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.6g}".replace("-", "−"))
        unit = f"10{str(power).translate(SUPERSCRIPTS)}" + (f" {unit}" if unit != "1" else "")
    axis.set_label_text(with_unit(label, unit))


def number_log_axis(axis: Axis, intervals: int = 5) -> None:
    """Label a logarithmic axis, whose limits are set, by numbers with at most so many intervals below one decade."""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, MaxNLocator, NullFormatter

    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    # Without powers of ten; to one decimal, so that frequencies of any range are plain.
    plain = low >= 1e-4 and high <= 1e6 if decades < 2 else low >= 0.1 and high <= 1e5
    # Below two decades, powers of ten alone are too few ticks; below one decade, so are 1, 2 and 5.
    powers = LogLocator(subs=(1, 2, 5) if decades < 2 + 0.5 * plain else (1,))
    axis.set_major_locator(MaxNLocator(intervals, steps=[1, 2, 5, 10]) if decades < 1 else powers)
    axis.set_major_formatter("{x:g}" if plain else LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    axis.set_minor_formatter(NullFormatter())
