"""What the explorer draws, in its window and for its page: the plate as it moves, and the swarm that searches."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from warp_plate.result.live import QUADRANTS, DriveResponse, SwarmSnapshot
from warp_plate.scene.model import Scene
from warp_plate.viz.lettering import add_text, style_text
from warp_plate.viz.quantity import Scale, scale_over
from warp_plate.viz.scene3d import add_plate

if TYPE_CHECKING:
    import pyvista

# A period of the drive is shown in so many seconds.
PERIOD = 1.5
# An iteration of a search takes at least this long, so that it can be seen.
SEARCH_SECONDS = 0.1
# The scale stays while the largest displacement is between this part of its limit and the limit, so that a plate that
# is driven harder is seen to move more.
LOWEST = 0.3
# Rows of the stage: the plate, and the search below it.
ROWS = (0.7, 0.3)
# The button, the words and what the choice is.
CHOICES = {
    "scene": "scene's own",
    "equal": "equal",
    "single": "best single",
    "found": "best found",
    "exact": "exact best",
    "random": "random",
}
HINT = (
    "“best found” lets the swarm search and shows here\n"
    "its best so far, and each particle's drives Z = w exp(−iφ)\n"
    "as parts of the first actuator's, Z₁. The plate is the best one's."
)
# Of the particles' drives, an actuator each.
COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#e377c2")
# The plane shows drives up to one of these sizes.
REACHES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


class Ranges(Protocol):
    """Ends of the sliders: magnitude [N/m²] and damping [N·s/m³] start at 0; frequencies [Hz]."""

    @property
    def magnitude(self) -> float: ...
    @property
    def damping(self) -> float: ...
    @property
    def frequency(self) -> tuple[float, float]: ...


class Settings(Protocol):
    """What is asked for: frequency [Hz], damping [N·s/m³], (actuators,) magnitudes [N/m²] and phase lags [rad]."""

    @property
    def frequency(self) -> float: ...
    @property
    def damping(self) -> float: ...
    @property
    def magnitude(self) -> tuple[float, ...]: ...
    @property
    def phase(self) -> tuple[float, ...]: ...


class Live(Protocol):
    """What the explorer is handed: a scene that answers at once. ``search.live.LiveModel`` is one."""

    @property
    def scene(self) -> Scene: ...
    @property
    def ranges(self) -> Ranges: ...
    @property
    def settings(self) -> Settings: ...
    def read(self) -> DriveResponse: ...

    def swarm(self) -> SwarmSnapshot | None: ...
    def status(self) -> str: ...
    def set_frequency(self, frequency: float) -> None: ...
    def set_damping(self, damping: float) -> None: ...
    def set_actuator(self, index: int, magnitude: float | None = None, phase: float | None = None) -> None: ...
    def choose(self, choice: str, seconds: float = 0.0) -> None: ...


class Stage:
    """The plate of a live model in subplot (0, 0) of a plotter and its search in (1, 0); ``advance`` moves both."""

    def __init__(self, plotter: pyvista.Plotter, model: Live, font_size: int) -> None:
        self.plotter = plotter
        self.model = model
        self.playing = True
        self.turn = 0.0
        self._reading = model.read()
        self._turn = math.nan  # nothing has been shown yet
        self._scale = _scale_of(self._reading, None)
        plotter.subplot(0, 0)
        field = self._reading.motion.at(0.0)
        self.plate = add_plate(plotter, model.scene, field, self._scale, self._text(), font_size)
        plotter.subplot(1, 0)
        self.search = SearchCharts(plotter, [actuator.name for actuator in model.scene.actuators], font_size)
        plotter.subplot(0, 0)

    def advance(self, seconds: float) -> bool:
        """Show the model as it is now, so many seconds later; whether that is another picture."""
        if self.playing:
            self.turn = (self.turn + 2 * math.pi * seconds / PERIOD) % (2 * math.pi)
        reading = self.model.read()
        searched = self.search.show(self.model.swarm(), reading.bound)
        if reading is self._reading and self.turn == self._turn:
            return searched
        self._turn = self.turn
        if reading is not self._reading:
            self._reading = reading
            scale = _scale_of(reading, self._scale)
            if scale is not self._scale:
                self._scale = scale
                self.plate.rescale(scale)
        self.plate.update(reading.motion.at(self.turn), text=self._text())
        return True

    def _text(self) -> str:
        reading = self._reading
        frequency = reading.scene.drive.frequency
        # Without the time: a text that changes takes longer to draw than the plate.
        return f"{frequency:.4g} Hz, shown {frequency * PERIOD:.3g} times slower\n{factor_text(reading)}"


class SearchCharts:
    """Two charts of a search in the active subplot: best so far against iteration, and where the particles are."""

    def __init__(self, plotter: pyvista.Plotter, actuators: list[str], font_size: int) -> None:
        import pyvista
        from vtkmodules.vtkChartsCore import vtkChartLegend

        self.hint = add_text(plotter, HINT, (0.03, 0.6), font_size, "#6a6a6a")
        self.history = pyvista.Chart2D(size=(0.5, 1), loc=(0, 0), x_label="iteration", y_label="localization factor")
        self.plane = pyvista.Chart2D(size=(0.5, 1), loc=(0.5, 0), x_label="Re Z / Z₁", y_label="Im Z / Z₁")
        self._bound = self.history.line([0, 1], [0, 0], color="#b2182b", width=1.5, style="--", label="bound")
        self._best = self.history.line([0], [0], color="#08519c", width=2.5, label="best so far")
        self._factors = self.history.scatter([0], [0], color="#6baed6", size=5, style="o", label="particles now")
        others = list(zip(actuators[1:], COLOURS * len(actuators), strict=False))
        self._particles = [
            self.plane.scatter([0], [0], color=colour, size=5, style="o", label=name) for name, colour in others
        ]
        self._marks = [self.plane.scatter([0], [0], color=colour, size=14, style="x") for _, colour in others]
        for mark, (_, colour) in zip(self._marks, others, strict=True):
            mark.pen.color = colour  # a cross is all outline, which PyVista leaves black
        for chart, vertical in ((self.history, vtkChartLegend.BOTTOM), (self.plane, vtkChartLegend.TOP)):
            chart.border_style = None
            chart.legend_visible = True
            chart.GetLegend().SetVerticalAlignment(vertical)
            style_text(chart.GetLegend().GetLabelProperties(), round(0.75 * font_size))
            for axis in (chart.x_axis, chart.y_axis):
                style_text(axis.GetTitleProperties(), round(0.8 * font_size))
                style_text(axis.GetLabelProperties(), round(0.75 * font_size))
            plotter.add_chart(chart)
        self._shown: SwarmSnapshot | None = None
        self._visible(False)

    def show(self, swarm: SwarmSnapshot | None, bound: float | None) -> bool:
        """The state of a search; None: there is none. Whether it is another one than before."""
        if swarm is self._shown:
            return False
        self._shown = swarm
        self._visible(swarm is not None)
        if swarm is not None:
            self._plot(swarm, bound)
        return True

    def _plot(self, swarm: SwarmSnapshot, bound: float | None) -> None:
        done = np.arange(1, swarm.best.size + 1)
        self._best.update(done, swarm.best)
        self._factors.update(np.full(swarm.factors.size, done[-1]), swarm.factors)
        top = float(np.nanmax([swarm.best[-1], 0.1])) if bound is None else bound
        self._bound.update([1, swarm.iterations], [top, top])
        self._bound.visible = bound is not None
        self.history.x_range = [0, swarm.iterations]
        self.history.y_range = [0, min(1.0, math.ceil(10.5 * top) / 10)]
        best = swarm.best_phasors
        for index, (particles, mark) in enumerate(zip(self._particles, self._marks, strict=True), start=1):
            particles.update(swarm.phasors[:, index].real, swarm.phasors[:, index].imag)
            mark.visible = best is not None
            if best is not None:
                mark.update([best[index].real], [best[index].imag])
        # Of most particles, not of the last stray one; in steps, so that the picture rests while the swarm shrinks.
        size = float(np.quantile(np.abs(swarm.phasors[:, 1:]), 0.9)) if self._particles else 0.0
        reach = next((step for step in REACHES if 1.1 * size < step), REACHES[-1])
        # About the same scale along both axes.
        self.plane.x_range, self.plane.y_range = [-2 * reach, 2 * reach], [-reach, reach]

    def _visible(self, shown: bool) -> None:
        self.history.visible = self.plane.visible = shown
        self.hint.SetVisibility(not shown)


def factor_text(reading: DriveResponse) -> str:
    """Localization factor and bound, in percent."""
    factor = reading.localization_factor
    text = f"localization factor {100 * factor:.2f} %" if math.isfinite(factor) else "localization factor not defined"
    return text + (f", bound {100 * reading.bound:.2f} %" if reading.bound is not None else "")


def share_texts(reading: DriveResponse) -> dict[str, str]:
    """The quadrants' shares of the kinetic energy, in percent."""
    shares = {name: reading.share(name) for name in QUADRANTS}
    return {name: f"{100 * share:.1f} %" if math.isfinite(share) else "—" for name, share in shares.items()}


def _scale_of(reading: DriveResponse, before: Scale | None) -> Scale:
    """The scale for a reading: the one before while it suits."""
    peak = reading.motion.peak()
    if before is not None and (not math.isfinite(peak) or LOWEST * before.limit <= peak <= before.limit):
        return before
    return scale_over([np.array([peak])], reading.scene.plate.size)
