"""The one camera: every plate is seen from the same place, whatever its heights are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warp_plate.viz.quantity import TALLEST

if TYPE_CHECKING:
    import pyvista

# From in front of the lower left corner, 40 degrees above the plate: that corner is nearest to the reader.
AZIMUTH, ELEVATION = -127.5, 40.0


def look_at_plate(plotter: pyvista.Plotter, size: tuple[float, float], font_size: int, share: float = 1.0) -> None:
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
    name_x, name_y = side_names(size)
    pixels = [0.56 * font_size * len(name) for name, _ in (name_x, name_y)]
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
    # Of all heights that may come, not of those that stand now.
    far = 2 * tall
    plotter.renderer.ResetCameraClippingRange(-far, size[0] + far, -far, size[1] + far, -far, far)


def _axes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors of the picture: to its right, to its top, and towards the reader."""
    azimuth, elevation = np.radians([AZIMUTH, ELEVATION])
    along = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array([np.cos(elevation) * along[1], -np.cos(elevation) * along[0], np.sin(elevation)])
    return along, np.cross(towards, along), towards


def side_names(size: tuple[float, float]) -> tuple[tuple[str, np.ndarray], tuple[str, np.ndarray]]:
    """Names and lengths of the axes, and where they stand beside the two sides nearest to the reader [m]."""
    away = 0.06 * min(size)
    return (
        (f"x: 0 … {size[0]:g} m", np.array([size[0] / 2, -away, 0.0])),
        (f"y: 0 … {size[1]:g} m", np.array([-away, size[1] / 2, 0.0])),
    )
