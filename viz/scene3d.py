"""The one builder of 3-D scenes: it puts a plate into a PyVista plotter, or a part of one, and moves it.

What the picture shows is made in `surface`; here is only how it looks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Scene
from warp_plate.viz.camera import look_at_plate
from warp_plate.viz.edges import SIDES
from warp_plate.viz.lettering import (
    INK,
    TARGET,
    add_legend,
    add_side_names,
    add_text,
    beside_legend,
    lookup_table,
    set_bar,
)
from warp_plate.viz.quantity import Scale
from warp_plate.viz.surface import FIELD, OnSurface, PlateMeshes, plate_meshes

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
    from vtkmodules.vtkRenderingCore import vtkTextActor

GRID = "#8a8a8a"


@dataclass(frozen=True)
class Line:
    """How lines of a plate look.

    width: in font sizes; nearer: steps of the depth buffer by which they are shifted towards the reader: not shifted,
    half of a wide line on a slope would be hidden by the surface.
    """

    outline: OnSurface
    colour: str
    width: float
    nearer: int
    opacity: float = 1.0


@dataclass
class DrawnPlate:
    """A plate in a plotter, which moves and changes its colours in place; the plotter is not rendered by it.

    meshes: what is drawn; actor: of the surface; heading: the text above; bar: None where another subplot has it.
    """

    meshes: PlateMeshes
    scale: Scale
    actor: pyvista.Actor
    heading: vtkTextActor
    bar: vtkScalarBarActor | None
    text: str

    def update(self, displacement: np.ndarray, colours: np.ndarray | None = None, text: str | None = None) -> None:
        """Move to another field.

        Args:
            displacement: (ny, nx) [m], on the grid that the plate was added with.
            colours: (ny, nx) of the scale's quantity in its SI unit; left out: the displacement.
            text: above the plate; left out: as it is.
        """
        self.meshes.show(displacement, self.scale, colours)
        if text is not None and text != self.text:
            self.text = text
            self._write()

    def rescale(self, scale: Scale) -> None:
        """Take another quantity, other limits or another height factor; :meth:`update` must follow."""
        if (scale.quantity, scale.limits, scale.unit) != (self.scale.quantity, self.scale.limits, self.scale.unit):
            _colour(self.actor, scale)
            if self.bar is not None:
                set_bar(self.bar, scale)
        self.scale = scale
        self._write()

    def _write(self) -> None:
        self.heading.SetInput(heading(self.text, self.scale))


def add_plate(
    plotter: pyvista.Plotter,
    scene: Scene,
    displacement: np.ndarray,
    scale: Scale,
    text: str = "",
    font_size: int = 20,
    bar: bool = True,
    colours: np.ndarray | None = None,
) -> DrawnPlate:
    """Draw one field into the active subplot and point its camera at the plate.

    Args:
        displacement: (ny, nx) [m], edges included.
        scale: colour limits and height factor; share one between pictures that are to be compared.
        text: stands above the plate; the height factor is added to its last line.
        font_size: height of the text in pixels; lines are as thick as suits it.
        bar: draw the colour bar and the key of the outlines in this subplot.
        colours: (ny, nx) of the scale's quantity in its SI unit; left out: the displacement.
    """
    # Lines are blended in the order in which they are added; to find the order by itself takes VTK half of a picture.
    plotter.renderer.SetUseOIT(False)
    meshes = plate_meshes(scene, displacement, scale, colours)
    actor = plotter.add_mesh(meshes.surface, scalars=FIELD, clim=scale.limits, lighting=False, show_scalar_bar=False)
    _colour(actor, scale)
    for line in lines_of(meshes):
        _add_lines(plotter, line, font_size)
    add_side_names(plotter, scene.plate.size, font_size)
    drawn_bar = add_legend(plotter, scene, scale, font_size) if bar else None
    above = add_text(plotter, heading(text, scale), (0.03, 0.97), font_size)
    look_at_plate(plotter, scene.plate.size, font_size, share=beside_legend(plotter, font_size) if bar else 1.0)
    return DrawnPlate(meshes, scale, actor, above, drawn_bar, text)


def heading(text: str, scale: Scale) -> str:
    """The text above a plate, with the height factor at its end."""
    return ", ".join(part for part in (text, scale.heights) if part)


def _colour(actor: pyvista.Actor, scale: Scale) -> None:
    actor.mapper.lookup_table = lookup_table(scale)
    actor.mapper.scalar_range = scale.limits
    # Between 179° and −179° lies 180°, not 0°: there colours are mixed, not angles.
    actor.mapper.interpolate_before_map = scale.quantity.kind != "cyclic"


def lines_of(meshes: PlateMeshes) -> list[Line]:
    """All lines of a plate, in the order in which they are drawn.

    Where lines meet, the nearer one lies on top: of a target's line along a side, both can be seen.
    """
    lines = [Line(meshes.lines, GRID, 0.033, 300)]
    for kind, side in meshes.sides.items():
        lines.append(Line(side, SIDES[kind].colour, SIDES[kind].width / 18, 400 if kind == "clamped" else 560))
    drawn = [(meshes.target, TARGET, 0.125, 500), (meshes.actuators, INK, 0.1, 600)]
    for outline, colour, width, nearer in drawn if meshes.target.mesh.n_points else drawn[1:]:
        # A light rim, for dark colours.
        lines += [Line(outline, "#ffffff", width + 0.1, nearer - 20, 0.5), Line(outline, colour, width, nearer)]
    return lines


def _add_lines(plotter: pyvista.Plotter, line: Line, font_size: int) -> None:
    actor = plotter.add_mesh(
        line.outline.mesh,
        color=line.colour,
        line_width=line.width * font_size,
        opacity=line.opacity,
        lighting=False,
        show_scalar_bar=False,
    )
    # A switch of the whole process in VTK; without it the next line does nothing.
    actor.mapper.resolve = "polygon_offset"
    actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -line.nearer)
