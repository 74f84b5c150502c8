"""A plate in a PyVista plotter: its actors, and their updates from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Scene
from warp_plate.viz import annotations
from warp_plate.viz.annotations import lookup_table
from warp_plate.viz.fields import DrawingScale
from warp_plate.viz.meshes import SCALARS, PlateMeshes, SurfacePolylines, plate_meshes
from warp_plate.viz.styles import EDGE_STYLES, GRID, INK, TARGET

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
    from vtkmodules.vtkRenderingCore import vtkTextActor


@dataclass(frozen=True)
class LineLayer:
    """Lines on the surface and their style.

    Attributes:
        lines: the lines.
        colour: #rrggbb.
        width: line width [font sizes].
        depth_offset: steps of the depth buffer towards the viewer; without it the surface would hide half of a wide
            line on a slope.
        opacity: 0 … 1.
    """

    lines: SurfacePolylines
    colour: str
    width: float
    depth_offset: int
    opacity: float = 1.0


@dataclass
class PlateActors:
    """A plate in a plotter, updated in place without rendering.

    Attributes:
        meshes: the drawn meshes.
        scale: colours and heights.
        surface: actor of the surface.
        caption: text above the plate.
        bar: colour bar; None if another subplot has it.
        text: caption without the height factor.
    """

    meshes: PlateMeshes
    scale: DrawingScale
    surface: pyvista.Actor
    caption: vtkTextActor
    bar: vtkScalarBarActor | None
    text: str

    def update(self, displacement: np.ndarray, values: np.ndarray | None = None, text: str | None = None) -> None:
        """Move to another field.

        Args:
            displacement: (ny, nx) [m], on the grid of the first field.
            values: (ny, nx) of the scale's field in its SI unit (default: the displacement).
            text: caption (default: unchanged).
        """
        self.meshes.update(displacement, self.scale, values)
        if text is not None and text != self.text:
            self.text = text
            self.caption.SetInput(_with_heights(text, self.scale))

    def rescale(self, scale: DrawingScale) -> None:
        """Take another scale; a call of :meth:`update` must follow."""
        self.scale = scale
        _set_colours(self.surface, scale)
        if self.bar is not None:
            annotations.set_colour_bar(self.bar, scale)
        self.caption.SetInput(_with_heights(self.text, scale))


def add_plate(
    plotter: pyvista.Plotter,
    scene: Scene,
    displacement: np.ndarray,
    scale: DrawingScale,
    text: str = "",
    font_size: int = 20,
    bar: bool = True,
    values: np.ndarray | None = None,
) -> PlateActors:
    """Draw one field into the active subplot and point its camera at the plate.

    Args:
        displacement: (ny, nx) [m], edges included.
        scale: colours and heights; pictures that are to be compared share one.
        text: caption; the height factor is added to its last line.
        font_size: height of the text [pixels]; line widths are relative to it.
        bar: draw colour bar and legend in this subplot.
        values: (ny, nx) of the scale's field in its SI unit (default: the displacement).
    """
    # Lines are blended in the order in which they are added; order-independent transparency takes twice the time.
    plotter.renderer.SetUseOIT(False)
    meshes = plate_meshes(scene, displacement, scale, values)
    surface = plotter.add_mesh(meshes.surface, scalars=SCALARS, clim=scale.clim, lighting=False, show_scalar_bar=False)
    _set_colours(surface, scale)
    for layer in line_layers(meshes):
        look = {"color": layer.colour, "line_width": layer.width * font_size, "opacity": layer.opacity}
        actor = plotter.add_mesh(layer.lines.mesh, lighting=False, show_scalar_bar=False, **look)
        actor.mapper.resolve = "polygon_offset"  # a global switch of VTK that the next line depends on
        actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -layer.depth_offset)
    annotations.add_axis_labels(plotter, scene.plate.size, font_size)
    drawn_bar = annotations.add_legend(plotter, scene, scale, font_size) if bar else None
    above = annotations.add_text(plotter, _with_heights(text, scale), (0.03, 0.97), font_size)
    share = annotations.free_width(plotter, font_size) if bar else 1.0
    annotations.look_at_plate(plotter, scene.plate.size, font_size, share)
    return PlateActors(meshes, scale, surface, above, drawn_bar, text)


def line_layers(meshes: PlateMeshes) -> list[LineLayer]:
    """Return all lines of a plate in drawing order, with a target's line beside that of an edge."""
    layers = [LineLayer(meshes.grid_lines, GRID, 0.033, 300)]
    for kind, lines in meshes.edges.items():
        style = EDGE_STYLES[kind]
        layers.append(LineLayer(lines, style.colour, style.width / 18, 400 if kind == "clamped" else 560))
    for lines, colour, width, offset in ((meshes.target, TARGET, 0.125, 500), (meshes.actuators, INK, 0.1, 600)):
        if lines.mesh.n_points:
            # A light rim sets the line off against dark colours.
            layers.append(LineLayer(lines, "#ffffff", width + 0.1, offset - 20, 0.5))
            layers.append(LineLayer(lines, colour, width, offset))
    return layers


def _with_heights(text: str, scale: DrawingScale) -> str:
    return ", ".join(part for part in (text, scale.heights) if part)


def _set_colours(surface: pyvista.Actor, scale: DrawingScale) -> None:
    surface.mapper.lookup_table = lookup_table(scale)
    surface.mapper.scalar_range = scale.clim
    # Between 179° and −179° lies 180°, not 0°: interpolate colours of angles, not angles.
    surface.mapper.interpolate_before_map = scale.field.kind != "cyclic"
