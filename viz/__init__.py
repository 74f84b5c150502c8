"""Pictures of results. PyVista, VTK and Matplotlib are imported when something is drawn, not before."""

import lazy_loader

_NAMES = {
    "availability": ["DrawingUnavailable", "missing_renderer", "prepare"],
    "pictures": ["draw_all", "draw_history", "draw_surfaces"],
}
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submod_attrs=_NAMES)
