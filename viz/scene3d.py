"""The one builder of 3-D scenes: it puts a displacement field into a PyVista plotter, or a part of one.

What the picture shows is made in `surface`; here is only how it looks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Scene
from warp_plate.viz.surface import FIELD, PlateMeshes, Scale, plate_meshes

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkTextProperty

COLOURS = "coolwarm"
INK, GRID, TARGET = "#1a1a1a", "#8a8a8a", "#1b7837"
# From in front of the lower left corner, 30 degrees above the plate: that corner is nearest to the reader.
AZIMUTH, ELEVATION = -127.5, 30.0


def add_plate(
    plotter: pyvista.Plotter,
    scene: Scene,
    displacement: np.ndarray,
    scale: Scale,
    text: str = "",
    font_size: int = 20,
    bar: bool = True,
) -> PlateMeshes:
    """Draw one field into the active subplot and point its camera at the plate.

    Args:
        displacement: (ny, nx) [m], edges included.
        scale: colour limits and height factor; share one between pictures that are to be compared.
        text: stands above the plate; the height factor is added to its last line.
        font_size: height of the text in pixels.
        bar: draw the colour bar in this subplot.

    Returns:
        The meshes drawn; a moving picture copies new ones into them.
    """
    meshes = plate_meshes(scene, displacement, scale)
    plotter.add_mesh(
        meshes.surface,
        scalars=FIELD,
        cmap=COLOURS,
        clim=scale.limits,
        lighting=False,
        nan_color="black",
        show_scalar_bar=False,
    )
    _add_lines(plotter, meshes.lines, GRID, 1.0)
    _add_lines(plotter, meshes.rim, INK, 1.5)
    _add_lines(plotter, meshes.target, TARGET, 4.0)
    _add_lines(plotter, meshes.actuators, INK, 3.0)
    _add_sides(plotter, scene, font_size)
    if bar:
        add_colour_bar(plotter, scale, font_size)
    add_text(plotter, f"{text}, {scale.heights}" if text else scale.heights, (0.03, 0.97), font_size)
    look_at_plate(plotter, scene.plate.size)
    return meshes


def add_colour_bar(plotter: pyvista.Plotter, scale: Scale, font_size: int, left: float = 0.85) -> None:
    """A colour bar with its unit in the active subplot, its left side at this share of the width.

    Not PyVista's own: that one is shared by title over all subplots and widens their limits.
    """
    import pyvista
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

    bar = vtkScalarBarActor()
    bar.SetLookupTable(pyvista.LookupTable(cmap=COLOURS, scalar_range=scale.limits))
    bar.SetTitle(f"u [{scale.unit}]")
    bar.SetNumberOfLabels(5)
    bar.SetLabelFormat("%.3g")
    bar.SetMaximumNumberOfColors(256)
    bar.UnconstrainedFontSizeOn()
    bar.SetPosition(left, 0.2)
    bar.SetPosition2(0.98 - left, 0.6)
    for style in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty()):
        _style(style, font_size)
    plotter.renderer.AddViewProp(bar)


def add_text(plotter: pyvista.Plotter, text: str, at: tuple[float, float], font_size: int) -> None:
    """Text whose upper left corner stands at these shares of the active subplot's width and height."""
    from vtkmodules.vtkRenderingCore import vtkTextActor

    actor = vtkTextActor()
    actor.SetInput(text)
    _style(actor.GetTextProperty(), font_size)
    actor.GetTextProperty().SetVerticalJustificationToTop()
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.SetPosition(*at)
    plotter.renderer.AddViewProp(actor)


def look_at_plate(plotter: pyvista.Plotter, size: tuple[float, float]) -> None:
    """The same camera for every field on a plate of this size [m], whatever the heights are."""
    azimuth, elevation = np.radians([AZIMUTH, ELEVATION])
    towards = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    centre = np.array([size[0] / 2, size[1] / 2, 0.0])
    camera = plotter.camera
    camera.focal_point = tuple(centre)
    camera.position = tuple(centre + 4 * max(size) * towards)
    camera.up = (0.0, 0.0, 1.0)
    camera.parallel_projection = True
    camera.parallel_scale = 0.46 * float(np.hypot(*size))
    plotter.renderer.reset_camera_clipping_range()


def _add_lines(plotter: pyvista.Plotter, lines: pyvista.PolyData, colour: str, width: float) -> None:
    plotter.add_mesh(lines, color=colour, line_width=width, lighting=False, show_scalar_bar=False)


def _add_sides(plotter: pyvista.Plotter, scene: Scene, font_size: int) -> None:
    """Names the axes and how long they are, beside the two sides nearest to the reader."""
    from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

    width, height = scene.plate.size
    away = 0.06 * min(width, height)
    labels = (
        (f"x: 0 … {width:g} m", (width / 2, -away, 0.0), "left"),
        (f"y: 0 … {height:g} m", (-away, height / 2, 0.0), "right"),
    )
    for text, at, side in labels:
        actor = vtkBillboardTextActor3D()
        actor.SetInput(text)
        actor.SetPosition(*at)
        style = actor.GetTextProperty()
        _style(style, font_size)
        style.SetVerticalJustificationToTop()
        style.SetJustificationToLeft() if side == "left" else style.SetJustificationToRight()
        plotter.renderer.AddViewProp(actor)


def _style(text: vtkTextProperty, font_size: int) -> None:
    text.SetFontFamilyToArial()
    text.SetFontSize(font_size)
    text.SetColor(0.1, 0.1, 0.1)
    text.BoldOff()
    text.ItalicOff()
    text.ShadowOff()
