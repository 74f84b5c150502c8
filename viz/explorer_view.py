"""The picture of the explorer: a plate in steady motion, and the search that is under way."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.result.motion import QUADRANTS, DriveResponse, SwarmSnapshot
from warp_plate.scene.specification import STANDARD_GRAVITY
from warp_plate.viz.annotations import add_text, in_percent, style_text
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, DrawingScale, drawing_scale
from warp_plate.viz.scene3d import PlateActors

if TYPE_CHECKING:
    import pyvista

    from warp_plate.explore.live_model import LiveModel

PERIOD = 1.5  # time in which a period of the drive is shown [s]
# The scale is kept while the largest displacement is between this share of its limit and the limit.
LEAST_SHARE = 0.3
# Relative heights of the plate and of the charts below it.
ROW_WEIGHTS = (0.7, 0.3)
HINT = (
    "“best found” starts the swarm and shows here\n"
    "its best so far, and the drives Z = w exp(−iφ) of the particles\n"
    "relative to the first actuator's, Z₁. The plate is that of the best."
)
# Colours of the particles' drives, by actuator.
PARTICLE_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#e377c2")
# Half-widths of the complex plane; steps, so that the picture rests while the swarm shrinks.
REACHES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


class ExplorerView:
    """The plate of a live model in subplot (0, 0) of a plotter, and its search in (1, 0).

    Attributes:
        angle: phase of the drive that is shown [rad].
        playing: True while the plate moves.
    """

    def __init__(
        self, plotter: pyvista.Plotter, model: LiveModel, font_size: int, colours: ColourOptions = DEFAULT_COLOURS
    ) -> None:
        self.colours = colours
        self.model, self.playing, self.angle = model, True, 0.0
        self._drawn_angle, self._reading = math.nan, model.read()
        plotter.subplot(0, 0)
        field, scale = self._reading.motion.at(0.0), _fitting_scale(self._reading, None, colours)
        self.plate = PlateActors(plotter, model.scene, field, scale, self._caption(), font_size)
        plotter.subplot(1, 0)
        self.search = SearchCharts(plotter, [actuator.name for actuator in model.scene.actuators], font_size)
        plotter.subplot(0, 0)

    def advance(self, seconds: float) -> bool:
        """Show the model after this time; return whether the picture has changed."""
        if self.playing:
            self.angle = (self.angle + 2 * math.pi * seconds / PERIOD) % (2 * math.pi)
        reading = self.model.read()
        searched = self.search.show(self.model.swarm(), reading.bound)
        if reading is self._reading and self.angle == self._drawn_angle:
            return searched
        if reading is not self._reading:
            scale = _fitting_scale(reading, self.plate.scale, self.colours)
            if scale is not self.plate.scale:
                self.plate.rescale(scale)
        self._drawn_angle, self._reading = self.angle, reading
        self.plate.update(reading.motion.at(self.angle), text=self._caption())
        return True

    def _caption(self) -> str:
        """Return a text without the time, as changing texts take longer to draw than the plate."""
        reading, frequency = self._reading, self._reading.scene.drive.frequency
        bound = "" if reading.bound is None else f", bound {in_percent(reading.bound)}"
        factor = f"localization factor {in_percent(reading.localization_factor)}{bound}"
        return f"{frequency:.4g} Hz, shown {frequency * PERIOD:.3g} times slower\n{factor}"


class SearchCharts:
    """Two charts of a search in the active subplot: localization factor against iteration, and particles."""

    def __init__(self, plotter: pyvista.Plotter, actuators: list[str], font_size: int) -> None:
        import pyvista
        from vtkmodules.vtkChartsCore import vtkChartLegend

        self.hint = add_text(plotter, HINT, (0.03, 0.6), font_size, "#6a6a6a")
        self.history = pyvista.Chart2D(size=(0.5, 1), loc=(0, 0), x_label="iteration", y_label="localization factor")
        self.plane = pyvista.Chart2D(size=(0.5, 1), loc=(0.5, 0), x_label="Re Z / Z₁", y_label="Im Z / Z₁")
        self._bound = self.history.line([0, 1], [0, 0], color="#b2182b", width=1.5, style="--", label="bound")
        self._best = self.history.line([0], [0], color="#08519c", width=2.5, label="best so far")
        self._factors = self.history.scatter([0], [0], color="#6baed6", size=5, style="o", label="particles now")
        self._particles, self._marks = [], []
        for name, colour in zip(actuators[1:], PARTICLE_COLOURS * len(actuators), strict=False):
            self._particles.append(self.plane.scatter([0], [0], color=colour, size=5, style="o", label=name))
            self._marks.append(self.plane.scatter([0], [0], color=colour, size=14, style="x"))
            self._marks[-1].pen.color = colour  # PyVista leaves outlines black, and a cross is all outline
        for chart, vertical in ((self.history, vtkChartLegend.BOTTOM), (self.plane, vtkChartLegend.TOP)):
            chart.border_style, chart.legend_visible = None, True
            chart.GetLegend().SetVerticalAlignment(vertical)
            for part in (chart.GetLegend(), chart.x_axis, chart.y_axis):
                style_text(part.GetLabelProperties(), round(0.75 * font_size))
            for axis in (chart.x_axis, chart.y_axis):
                style_text(axis.GetTitleProperties(), round(0.8 * font_size))
            plotter.add_chart(chart)
        self._shown: SwarmSnapshot | bool | None = True
        self.show(None, None)

    def show(self, swarm: SwarmSnapshot | None, bound: float | None) -> bool:
        """Show the state of a search, or the hint if there is none; return whether it has changed."""
        if swarm is self._shown:
            return False
        self._shown = swarm
        self.history.visible = self.plane.visible = swarm is not None
        self.hint.SetVisibility(swarm is None)
        if swarm is None:
            return True
        iterations = np.arange(1, swarm.best.size + 1)
        self._best.update(iterations, swarm.best)
        self._factors.update(np.full(swarm.factors.size, iterations[-1]), swarm.factors)
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
        # Fit most particles, not the last stray one, at about the same scale along both axes.
        size = float(np.quantile(np.abs(swarm.phasors[:, 1:]), 0.9)) if self._particles else 0.0
        reach = next((step for step in REACHES if 1.1 * size < step), REACHES[-1])
        self.plane.x_range, self.plane.y_range = [-2 * reach, 2 * reach], [-reach, reach]
        return True


def share_texts(reading: DriveResponse) -> dict[str, str]:
    """Return the quadrants' shares of the kinetic energy in percent."""
    shares = {name: reading.share(name) for name in QUADRANTS}
    return {name: in_percent(share, 1) if math.isfinite(share) else "—" for name, share in shares.items()}


def level_texts(reading: DriveResponse) -> list[list[str]]:
    """Return a row for each region: its name, and the peaks at its weakest and worst point, both in g and µm."""
    units = (STANDARD_GRAVITY, reading.scene.drive.angular_frequency**2 / 1e6)
    return [
        [name, *(f"{peak / unit:.3g}" for peak in peaks for unit in units)] for name, peaks in reading.levels.items()
    ]


def _fitting_scale(reading: DriveResponse, before: DrawingScale | None, colours: ColourOptions) -> DrawingScale:
    """Return the previous scale if it still suits the reading, else a new one."""
    peak = reading.motion.peak()
    if before is not None and (not math.isfinite(peak) or LEAST_SHARE * before.limit <= peak <= before.limit):
        return before
    return drawing_scale([np.array([peak])], reading.scene.plate.size, colours=colours)
