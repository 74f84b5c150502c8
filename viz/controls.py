"""Sliders and buttons for a window, drawn by VTK in the active subplot of a plotter."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from warp_plate.viz.lettering import INK, add_text

if TYPE_CHECKING:
    import pyvista

QUIET, TRACK, KNOB = "#6a6a6a", "#c4c4c4", "#08519c"
# Before VTK's own, which would turn the camera.
FIRST = 10.0


class Slider:
    """A slider between two shares of the subplot's width, its name and its value above it.

    ``changed`` is called with the value while the slider is dragged; ``show`` moves it without calling.
    """

    def __init__(
        self,
        plotter: pyvista.Plotter,
        name: str,
        ends: tuple[float, float],
        value: float,
        at: tuple[float, float, float],
        font_size: int,
        changed: Callable[[float], object],
    ) -> None:
        """at: left, right and top as shares of the active subplot's width and height."""
        from vtkmodules.vtkInteractionWidgets import vtkSliderRepresentation2D, vtkSliderWidget

        left, right, top = at
        width, height = plotter.renderer.GetSize()
        self.name = name
        self._changed = changed
        self._text = add_text(plotter, "", (left, top), font_size)
        bar = self._bar = vtkSliderRepresentation2D()
        bar.SetMinimumValue(ends[0])
        bar.SetMaximumValue(ends[1])
        bar.ShowSliderLabelOff()
        # VTK takes these as shares of the window, but from the subplot's own corner.
        x0, y0, x1, y1 = plotter.renderer.GetViewport()
        middle = (y1 - y0) * (top - 1.9 * font_size / height)
        for point, share in ((bar.GetPoint1Coordinate(), left), (bar.GetPoint2Coordinate(), right)):
            point.SetCoordinateSystemToNormalizedDisplay()
            point.SetValue((x1 - x0) * share, middle)
        bar.SetTubeWidth(0.25 * font_size / height)
        bar.SetSliderWidth(1.0 * font_size / height)
        bar.SetSliderLength(0.6 * font_size / width)
        bar.SetEndCapLength(0.0)
        bar.SetEndCapWidth(0.0)
        for look, colour in (
            (bar.GetTubeProperty(), TRACK),
            (bar.GetCapProperty(), TRACK),
            (bar.GetSliderProperty(), KNOB),
            (bar.GetSelectedProperty(), "#d95f02"),
        ):
            look.SetColor(*_rgb(colour))
        self._widget = vtkSliderWidget()
        self._widget.SetInteractor(plotter.iren.interactor)
        self._widget.SetCurrentRenderer(plotter.renderer)
        self._widget.SetRepresentation(bar)
        self._widget.SetAnimationModeToJump()
        self._widget.On()
        self._widget.AddObserver("InteractionEvent", self._dragged)
        self.value = float("nan")
        self.show(value)

    def show(self, value: float) -> bool:
        """Move to a value, and tell whether it is another; beyond the slider's end it stays at the end and the text
        says what it is."""
        if value == self.value:
            return False
        self.value = value
        self._bar.SetValue(value)
        self._text.SetInput(f"{self.name}: {value:.4g}")
        return True

    def place(self, value: float) -> tuple[int, int]:
        """Where the knob stands for a value, in pixels from the lower left corner of the window."""
        bar, renderer = self._bar, self._widget.GetCurrentRenderer()
        ends = [point.GetValue() for point in (bar.GetPoint1Coordinate(), bar.GetPoint2Coordinate())]
        share = (value - bar.GetMinimumValue()) / (bar.GetMaximumValue() - bar.GetMinimumValue())
        width, height = renderer.GetRenderWindow().GetSize()
        x0, y0 = renderer.GetOrigin()
        # The knob's middle stays half a knob away from the ends.
        half = bar.GetSliderLength() * renderer.GetSize()[0] / 2
        first, last = width * ends[0][0] + half, width * ends[1][0] - half
        return round(x0 + first + share * (last - first)), round(y0 + height * ends[0][1])

    def _dragged(self, *_: object) -> None:
        self.value = self._bar.GetValue()
        self._text.SetInput(f"{self.name}: {self.value:.4g}")
        self._changed(self.value)


class Buttons:
    """Words that can be pressed, in rows; ``pressed`` is called with the key of the one that was."""

    def __init__(
        self,
        plotter: pyvista.Plotter,
        words: dict[str, str],
        at: tuple[float, float],
        columns: int,
        font_size: int,
        pressed: Callable[[str], object],
    ) -> None:
        """at: left and top as shares of the active subplot's width and height, which the rows fill to the right."""
        self._interactor = plotter.iren.interactor
        self._pressed = pressed
        self._texts = {}
        left, top = at
        line = 2.1 * font_size / plotter.renderer.GetSize()[1]
        for index, (key, word) in enumerate(words.items()):
            row, column = divmod(index, columns)
            where = (left + (1 - 2 * left) * column / columns, top - row * line)
            text = self._texts[key] = add_text(plotter, f" {word} ", where, font_size, INK)
            look = text.GetTextProperty()
            look.SetBackgroundColor(*_rgb("#e4ecf4"))
            look.SetBackgroundOpacity(1.0)
            look.FrameOn()
            look.SetFrameColor(*_rgb(QUIET))
        self._renderer = plotter.renderer
        self._observer = self._interactor.AddObserver("LeftButtonPressEvent", self._click, FIRST)

    def say(self, key: str, word: str) -> None:
        """Another word on a button."""
        self._texts[key].SetInput(f" {word} ")

    def mark(self, marked: str | None) -> None:
        """Show one button as the one whose choice holds."""
        for key, text in self._texts.items():
            text.GetTextProperty().SetBackgroundColor(*_rgb("#9ecae1" if key == marked else "#e4ecf4"))

    def centre(self, key: str) -> tuple[int, int]:
        """The middle of a button, in pixels from the lower left corner of the window."""
        left, right, bottom, top = self._box(key)
        return round((left + right) / 2), round((bottom + top) / 2)

    def _box(self, key: str) -> tuple[float, float, float, float]:
        text, box = self._texts[key], [0.0] * 4
        text.GetBoundingBox(self._renderer, box)
        x, y = text.GetPositionCoordinate().GetComputedViewportValue(self._renderer)
        x0, y0 = self._renderer.GetOrigin()
        return x0 + x + box[0], x0 + x + box[1], y0 + y + box[2], y0 + y + box[3]

    def _click(self, *_: object) -> None:
        x, y = self._interactor.GetEventPosition()
        for key in self._texts:
            left, right, bottom, top = self._box(key)
            if left <= x <= right and bottom <= y <= top:
                self._interactor.GetCommand(self._observer).AbortFlagOn()
                self._pressed(key)
                return


def _rgb(colour: str) -> tuple[float, float, float]:
    import pyvista

    return pyvista.Color(colour).float_rgb
