"""Pictures from results. PyVista, VTK and Matplotlib are imported when something is first drawn, not before."""

from warp_plate.viz.availability import DrawingUnavailable, missing
from warp_plate.viz.figures import Pictures, draw_all, draw_history, draw_surfaces

__all__ = ["DrawingUnavailable", "Pictures", "draw_all", "draw_history", "draw_surfaces", "missing"]
