"""What is written beside and above a plate: colour bar, key of the outlines, texts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warp_plate.scene.model import Scene
from warp_plate.viz.camera import side_names
from warp_plate.viz.edges import SIDES, kinds_of
from warp_plate.viz.quantity import Scale

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
    from vtkmodules.vtkRenderingCore import vtkTextActor, vtkTextProperty

INK, TARGET = "#1a1a1a", "#1b7837"
# Of the colour bar and the key, in font sizes.
LEGEND_WIDTH = 8.2
# Ticks stand at quarters of a limit of two digits, which have four at most.
TICK = "%.4g"
# From line to line of the key, in font sizes.
LINE = 1.35


def beside_legend(plotter: pyvista.Plotter, font_size: int) -> float:
    """The share of the active subplot's width that a legend at its right leaves free."""
    return max(0.0, 1 - LEGEND_WIDTH * font_size / plotter.renderer.GetSize()[0])


def add_legend(plotter: pyvista.Plotter, scene: Scene, scale: Scale, font_size: int) -> vtkScalarBarActor:
    """A colour bar with its unit, and below it what the outlines mean, at the right of the active subplot.

    Returns the bar, for :func:`set_bar`.
    """
    # Not PyVista's own bar: that one is shared by title over all subplots and widens their limits.
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

    left = beside_legend(plotter, font_size)
    key = key_of(scene)
    line = LINE * font_size / plotter.renderer.GetSize()[1]
    top = 0.03 + line * len(key)
    for index, (words, colour) in enumerate(key):
        add_text(plotter, words, (left, top - line * index), font_size, colour)
    bar = vtkScalarBarActor()
    bar.SetNumberOfLabels(5)
    bar.SetLabelFormat(f" {TICK}")  # not by the bar's own padding, which moves the labels off their ticks
    bar.SetMaximumNumberOfColors(256)
    bar.UnconstrainedFontSizeOn()
    bar.SetVerticalTitleSeparation(font_size // 2)
    bar.SetPosition(left, top + line)
    bar.SetPosition2(0.95 * (1 - left), 0.84 - top - line)
    for style in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty()):
        style_text(style, font_size)
    set_bar(bar, scale)
    plotter.renderer.AddViewProp(bar)
    return bar


def key_of(scene: Scene) -> list[tuple[str, str]]:
    """What the outlines mean: sign and words, and their colour."""
    sides = [(f"{SIDES[kind].sign} {SIDES[kind].words}", SIDES[kind].colour) for kind in kinds_of(scene)]
    return [("□ target", TARGET), ("□ actuator", INK), *sides]


def set_bar(bar: vtkScalarBarActor, scale: Scale) -> None:
    """Show another scale."""
    bar.SetLookupTable(lookup_table(scale))
    bar.SetTitle(scale.title)


def lookup_table(scale: Scale) -> pyvista.LookupTable:
    """The scale's colours between its limits."""
    import pyvista

    return pyvista.LookupTable(
        cmap=scale.quantity.colours, scalar_range=scale.limits, nan_color=scale.quantity.no_number
    )


def add_text(
    plotter: pyvista.Plotter, text: str, at: tuple[float, float], font_size: int, colour: str = INK
) -> vtkTextActor:
    """Text whose upper left corner stands at these shares of the active subplot's width and height.

    Its ``SetInput`` takes another text.
    """
    from vtkmodules.vtkRenderingCore import vtkTextActor

    actor = vtkTextActor()
    actor.SetInput(text)
    style_text(actor.GetTextProperty(), font_size, colour)
    actor.GetTextProperty().SetVerticalJustificationToTop()
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.SetPosition(*at)
    plotter.renderer.AddViewProp(actor)
    return actor


def add_side_names(plotter: pyvista.Plotter, size: tuple[float, float], font_size: int) -> None:
    """Name and length of x and y beside the two sides that are nearest to the reader."""
    from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

    for name, at in side_names(size):
        actor = vtkBillboardTextActor3D()
        actor.SetInput(name)
        actor.SetPosition(*at)
        style = actor.GetTextProperty()
        style_text(style, font_size)
        style.SetVerticalJustificationToTop()
        if name.startswith("y"):
            style.SetJustificationToRight()
        plotter.renderer.AddViewProp(actor)


def style_text(text: vtkTextProperty, font_size: int, colour: str = INK, font: str = "DejaVuSans") -> None:
    """The font of the plots of curves, in pixels; VTK's own lack many signs."""
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
