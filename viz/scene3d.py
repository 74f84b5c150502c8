"""The one builder of 3-D scenes: it puts a displacement field into a PyVista plotter, or a part of one.

What the picture shows is made in `surface`; here is only how it looks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from warp_plate.scene.model import Scene
from warp_plate.viz.surface import FIELD, TALLEST, PlateMeshes, Scale, plate_meshes

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkTextProperty

COLOURS: Final = "coolwarm"
INK, GRID, TARGET = "#1a1a1a", "#8a8a8a", "#1b7837"
# From in front of the lower left corner, 40 degrees above the plate: that corner is nearest to the reader.
AZIMUTH, ELEVATION = -127.5, 40.0
# Where a colour bar in the plate's own subplot begins, as a share of the width.
BAR_LEFT = 0.85


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
        font_size: height of the text in pixels; lines are as thick as suits it.
        bar: draw the colour bar and the key of the outlines in this subplot.

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
    # Where lines meet, the later one lies on top.
    _add_lines(plotter, meshes.lines, GRID, font_size / 30, nearer=300)
    _add_lines(plotter, meshes.rim, INK, font_size / 13, nearer=400)
    _add_lines(plotter, meshes.target, TARGET, font_size / 8, nearer=500)
    _add_lines(plotter, meshes.actuators, INK, font_size / 10, nearer=600)
    _add_sides(plotter, scene.plate.size, font_size)
    if bar:
        add_colour_bar(plotter, scale, font_size)
        add_key(plotter, font_size)
    add_text(plotter, f"{text}, {scale.heights}" if text else scale.heights, (0.03, 0.97), font_size)
    look_at_plate(plotter, scene.plate.size, font_size, share=BAR_LEFT if bar else 1.0)
    return meshes


def add_colour_bar(plotter: pyvista.Plotter, scale: Scale, font_size: int, left: float = BAR_LEFT) -> None:
    """A colour bar with its unit in the active subplot, its left side at this share of the width.

    Not PyVista's own: that one is shared by title over all subplots and widens their limits.
    """
    import pyvista
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

    bar = vtkScalarBarActor()
    bar.SetLookupTable(pyvista.LookupTable(cmap=COLOURS, scalar_range=scale.limits))
    bar.SetTitle(f"displacement\n[{scale.unit}]")
    bar.SetNumberOfLabels(5)
    bar.SetLabelFormat("%.3g")
    bar.SetMaximumNumberOfColors(256)
    bar.UnconstrainedFontSizeOn()
    bar.SetVerticalTitleSeparation(font_size // 2)
    bar.SetPosition(left, 0.2)
    bar.SetPosition2(0.98 - left, 0.6)
    for style in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty()):
        _style(style, font_size)
    plotter.renderer.AddViewProp(bar)


def add_key(plotter: pyvista.Plotter, font_size: int, left: float = BAR_LEFT) -> None:
    """What the outlines mean, below the colour bar, in their own colours."""
    line = 1.2 * font_size / plotter.renderer.GetSize()[1]
    add_text(plotter, "— target", (left, 0.14), font_size, TARGET)
    add_text(plotter, "— actuator", (left, 0.14 - line), font_size)


def add_text(
    plotter: pyvista.Plotter, text: str, at: tuple[float, float], font_size: int, colour: str = INK
) -> None:
    """Text whose upper left corner stands at these shares of the active subplot's width and height."""
    from vtkmodules.vtkRenderingCore import vtkTextActor

    actor = vtkTextActor()
    actor.SetInput(text)
    _style(actor.GetTextProperty(), font_size, colour)
    actor.GetTextProperty().SetVerticalJustificationToTop()
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.SetPosition(*at)
    plotter.renderer.AddViewProp(actor)


def look_at_plate(
    plotter: pyvista.Plotter, size: tuple[float, float], font_size: int, share: float = 1.0
) -> None:
    """The same camera for every field on a plate of this size [m], whatever its heights are.

    The plate with its tallest allowed heights, and the names of its sides, fill the subplot below two lines
    of text, on this share of its width from the left.
    """
    pixels_wide, pixels_high = plotter.renderer.GetSize()
    along, up, towards = _axes()
    tall = TALLEST * min(size)
    corners = np.array([(x, y, z) for x in (0, size[0]) for y in (0, size[1]) for z in (-tall, tall)])
    horizontal, vertical = corners @ along, corners @ up
    # What reaches how far to the left and to the right: position [m] and the pixels that it takes beside it.
    name_x, name_y = _side_names(size)
    pixels = [0.6 * font_size * len(name) for name, _ in (name_x, name_y)]
    left = [(horizontal.min(), 0.0), (name_y[1] @ along, pixels[1])]
    right = [(horizontal.max(), 0.0), (name_x[1] @ along, pixels[0])]
    margin = 0.02 * pixels_wide
    free = max(pixels_high * 0.96 - 3.4 * font_size, pixels_high / 4)
    width = share * pixels_wide - 2 * margin
    scale = max(  # metres in a pixel
        np.ptp(vertical) / free,
        *((b - a) / (width - more_a - more_b) for a, more_a in left for b, more_b in right),
    )
    first = max(margin + more - a / scale for a, more in left)
    last = min(share * pixels_wide - margin - more - b / scale for b, more in right)
    centre_horizontal = scale * (pixels_wide - first - last) / 2
    centre_vertical = (vertical.max() + vertical.min()) / 2 + scale * 3.4 * font_size / 2
    focus = centre_horizontal * along + centre_vertical * up
    camera = plotter.camera
    camera.focal_point = tuple(focus)
    camera.position = tuple(focus + 8 * max(size) * towards)
    camera.up = (0.0, 0.0, 1.0)
    camera.parallel_projection = True
    camera.parallel_scale = float(scale * pixels_high / 2)
    plotter.renderer.reset_camera_clipping_range()


def _axes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors of the picture: to its right, to its top, and towards the reader."""
    azimuth, elevation = np.radians([AZIMUTH, ELEVATION])
    along = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array([np.cos(elevation) * along[1], -np.cos(elevation) * along[0], np.sin(elevation)])
    return along, np.cross(towards, along), towards


def _side_names(size: tuple[float, float]) -> tuple[tuple[str, np.ndarray], tuple[str, np.ndarray]]:
    """Names and lengths of the axes, and where they stand beside the two sides nearest to the reader [m]."""
    away = 0.06 * min(size)
    return (
        (f"x: 0 … {size[0]:g} m", np.array([size[0] / 2, -away, 0.0])),
        (f"y: 0 … {size[1]:g} m", np.array([-away, size[1] / 2, 0.0])),
    )


def _add_lines(
    plotter: pyvista.Plotter, lines: pyvista.PolyData, colour: str, width: float, nearer: int
) -> None:
    """Lines of this width in pixels, shifted towards the reader by this many steps of the depth buffer.

    Not shifted, half of a wide line on a slope would be hidden by the surface.
    """
    actor = plotter.add_mesh(lines, color=colour, line_width=width, lighting=False, show_scalar_bar=False)
    # A switch of the whole process in VTK; without it the next line does nothing.
    actor.mapper.resolve = "polygon_offset"
    actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -nearer)


def _add_sides(plotter: pyvista.Plotter, size: tuple[float, float], font_size: int) -> None:
    from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

    for name, at in _side_names(size):
        actor = vtkBillboardTextActor3D()
        actor.SetInput(name)
        actor.SetPosition(*at)
        style = actor.GetTextProperty()
        _style(style, font_size)
        style.SetVerticalJustificationToTop()
        if name.startswith("y"):
            style.SetJustificationToRight()
        plotter.renderer.AddViewProp(actor)


def _style(text: vtkTextProperty, font_size: int, colour: str = INK) -> None:
    import pyvista
    from matplotlib import get_data_path
    from vtkmodules.vtkCommonCore import VTK_FONT_FILE

    # The font of the plots of curves; VTK's own lack many signs.
    text.SetFontFamily(VTK_FONT_FILE)
    text.SetFontFile(f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf")
    text.SetFontSize(font_size)
    text.SetColor(*pyvista.Color(colour).float_rgb)
    text.BoldOff()
    text.ItalicOff()
    text.ShadowOff()
    text.SetLineSpacing(1.2)
