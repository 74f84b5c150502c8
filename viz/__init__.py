"""Pictures of results. PyVista, VTK and Matplotlib are imported when something is drawn, not before."""

from warp_plate.viz.availability import DrawingUnavailable, missing_renderer, prepare
from warp_plate.viz.pictures import draw_all, draw_history, draw_surfaces

__all__ = ["DrawingUnavailable", "draw_all", "draw_history", "draw_surfaces", "missing_renderer", "prepare"]
