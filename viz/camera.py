"""The default camera: every plate is seen from the same direction, whatever its heights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warp_plate.viz.fields import TALLEST

if TYPE_CHECKING:
    import pyvista

# Azimuth and elevation [°]: the viewer stands in front of the lower left corner.
AZIMUTH, ELEVATION = -127.5, 40.0


def look_at_plate(plotter: pyvista.Plotter, size: tuple[float, float], font_size: int, share: float = 1.0) -> None:
    """Point the camera of the active subplot at a plate, the same for every field on it.

    The plate with its largest heights and its axis labels fills the subplot below two lines of text.

    Args:
        size: lengths of the plate along x and y [m].
        font_size: height of the text [pixels].
        share: share of the subplot's width that is used, from the left.
    """
    pixels_wide, pixels_high = plotter.renderer.GetSize()
    right, up, towards = _view_axes()
    tall = TALLEST * min(size)
    corners = np.array([(x, y, z) for x in (0, size[0]) for y in (0, size[1]) for z in (-tall, tall)])
    horizontal, vertical = corners @ right, corners @ up
    # Extents to the left and to the right: position [m], and pixels that are needed beyond it.
    label_x, label_y = axis_labels(size)
    label_pixels = [0.56 * font_size * len(text) for text, _ in (label_x, label_y)]
    lefts = [(horizontal.min(), 0.0), (label_y[1] @ right, label_pixels[1])]
    rights = [(horizontal.max(), 0.0), (label_x[1] @ right, label_pixels[0])]
    margin = 0.02 * pixels_wide
    free_height = max(pixels_high * 0.96 - 3.4 * font_size, pixels_high / 4)
    free_width = share * pixels_wide - 2 * margin
    scale = max(  # metres per pixel
        np.ptp(vertical) / free_height,
        *((b - a) / (free_width - pixels_a - pixels_b) for a, pixels_a in lefts for b, pixels_b in rights),
    )
    first = max(margin + pixels - position / scale for position, pixels in lefts)
    last = min(share * pixels_wide - margin - pixels - position / scale for position, pixels in rights)
    centre_right = scale * (pixels_wide - first - last) / 2
    centre_up = (vertical.max() + vertical.min()) / 2 + scale * 3.4 * font_size / 2
    focus = centre_right * right + centre_up * up
    camera = plotter.camera
    camera.focal_point = tuple(focus)
    camera.position = tuple(focus + 8 * max(size) * towards)
    camera.up = (0.0, 0.0, 1.0)
    camera.parallel_projection = True
    camera.parallel_scale = float(scale * pixels_high / 2)
    # The clipping range must hold for all heights to come, not only for the present ones.
    far = 2 * tall
    plotter.renderer.ResetCameraClippingRange(-far, size[0] + far, -far, size[1] + far, -far, far)


def _view_axes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors of the picture: to its right, to its top, and towards the viewer."""
    azimuth, elevation = np.radians([AZIMUTH, ELEVATION])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array([np.cos(elevation) * right[1], -np.cos(elevation) * right[0], np.sin(elevation)])
    return right, np.cross(towards, right), towards


def axis_labels(size: tuple[float, float]) -> tuple[tuple[str, np.ndarray], tuple[str, np.ndarray]]:
    """Return the labels of x and y and their positions [m] beside the two edges nearest to the viewer."""
    away = 0.06 * min(size)
    return (
        (f"x: 0 … {size[0]:g} m", np.array([size[0] / 2, -away, 0.0])),
        (f"y: 0 … {size[1]:g} m", np.array([-away, size[1] / 2, 0.0])),
    )
