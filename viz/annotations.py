"""Colour bar, legend and text of 3-D pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warp_plate.scene.model import Scene
from warp_plate.viz.camera import axis_labels
from warp_plate.viz.edge_styles import EDGE_STYLES, edges_by_kind
from warp_plate.viz.fields import DrawingScale

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
    from vtkmodules.vtkRenderingCore import vtkTextActor, vtkTextProperty

INK, TARGET = "#1a1a1a", "#1b7837"
# Width of colour bar and legend, and height of a line of the legend [font sizes].
LEGEND_WIDTH, LINE_HEIGHT = 8.2, 1.35
# Labels stand at quarters of a limit of two digits, which have at most four digits.
LABEL_FORMAT = "%.4g"


def free_width(plotter: pyvista.Plotter, font_size: int) -> float:
    """Return the share of the active subplot's width left of a legend."""
    return max(0.0, 1 - LEGEND_WIDTH * font_size / plotter.renderer.GetSize()[0])


def add_legend(plotter: pyvista.Plotter, scene: Scene, scale: DrawingScale, font_size: int) -> vtkScalarBarActor:
    """Add a colour bar, and below it the legend of the outlines, at the right of the active subplot.

    Returns:
        The colour bar, for :func:`set_colour_bar`.
    """
    # PyVista's own bar is shared by title over all subplots and widens their limits.
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

    left = free_width(plotter, font_size)
    entries = legend_entries(scene)
    line = LINE_HEIGHT * font_size / plotter.renderer.GetSize()[1]
    top = 0.03 + line * len(entries)
    for index, (text, colour) in enumerate(entries):
        add_text(plotter, text, (left, top - line * index), font_size, colour)
    bar = vtkScalarBarActor()
    bar.SetNumberOfLabels(5)
    bar.SetLabelFormat(f" {LABEL_FORMAT}")  # a space, for the bar's own padding moves labels off their ticks
    bar.SetMaximumNumberOfColors(256)
    bar.UnconstrainedFontSizeOn()
    bar.SetVerticalTitleSeparation(font_size // 2)
    bar.SetPosition(left, top + line)
    bar.SetPosition2(0.95 * (1 - left), 0.84 - top - line)
    for style in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty()):
        style_text(style, font_size)
    set_colour_bar(bar, scale)
    plotter.renderer.AddViewProp(bar)
    return bar


def legend_entries(scene: Scene) -> list[tuple[str, str]]:
    """Return text and colour of every kind of outline."""
    styles = [EDGE_STYLES[kind] for kind in edges_by_kind(scene)]
    edges = [(f"{style.symbol} {style.label}", style.colour) for style in styles]
    return [("□ target", TARGET), ("□ actuator", INK), *edges]


def set_colour_bar(bar: vtkScalarBarActor, scale: DrawingScale) -> None:
    """Show another scale."""
    bar.SetLookupTable(lookup_table(scale))
    bar.SetTitle(scale.title)


def lookup_table(scale: DrawingScale) -> pyvista.LookupTable:
    """Return the colours of a scale between its limits."""
    import pyvista

    return pyvista.LookupTable(cmap=scale.field.cmap, scalar_range=scale.clim, nan_color=scale.field.nan_colour)


def add_text(
    plotter: pyvista.Plotter, text: str, position: tuple[float, float], font_size: int, colour: str = INK
) -> vtkTextActor:
    """Add text with its upper left corner at these shares of the active subplot's width and height."""
    from vtkmodules.vtkRenderingCore import vtkTextActor

    actor = vtkTextActor()
    actor.SetInput(text)
    style_text(actor.GetTextProperty(), font_size, colour)
    actor.GetTextProperty().SetVerticalJustificationToTop()
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.SetPosition(*position)
    plotter.renderer.AddViewProp(actor)
    return actor


def add_axis_labels(plotter: pyvista.Plotter, size: tuple[float, float], font_size: int) -> None:
    """Add name and length of x and y beside the two edges nearest to the viewer."""
    from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

    for text, position in axis_labels(size):
        actor = vtkBillboardTextActor3D()
        actor.SetInput(text)
        actor.SetPosition(*position)
        style = actor.GetTextProperty()
        style_text(style, font_size)
        style.SetVerticalJustificationToTop()
        if text.startswith("y"):
            style.SetJustificationToRight()
        plotter.renderer.AddViewProp(actor)


def style_text(text: vtkTextProperty, font_size: int, colour: str = INK, font: str = "DejaVuSans") -> None:
    """Set Matplotlib's font, as VTK's own fonts lack many characters; the size is in pixels."""
    import pyvista
    from matplotlib import get_data_path
    from vtkmodules.vtkCommonCore import VTK_FONT_FILE

    text.SetFontFamily(VTK_FONT_FILE)
    text.SetFontFile(f"{get_data_path()}/fonts/ttf/{font}.ttf")
    text.SetFontSize(font_size)
    text.SetColor(*pyvista.Color(colour).float_rgb)
    text.BoldOff()
    text.ItalicOff()
    text.ShadowOff()
    text.SetLineSpacing(1.2)
