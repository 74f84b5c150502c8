"""A single HTML file that plays and turns plates in motion in any browser, without a network or a server.

The page draws with WebGL 2 the meshes, styles and scale of the other pictures, which are written into it. Of a fine
grid it shows every second, third, … node, so that the file stays small enough to be sent and opened.
"""

import base64
import json
import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import (
    AZIMUTH,
    ELEVATION,
    LABEL_FORMAT,
    frame_caption,
    legend_entries,
    lookup_table,
    shortened,
)
from warp_plate.viz.fields import DISPLACEMENT, MODE, DrawingScale, PictureStyle, motion_scales
from warp_plate.viz.outlined import outlined_nodes
from warp_plate.viz.scene3d import PlateMeshes, line_layers, rows_and_columns

# Values are integers −PEAK … PEAK in the page; NAN stands for NaN.
PEAK, NAN = 32767, -32768
# Most bytes of all values as text, and bytes of one value in base64.
PAGE_BYTES, BYTES_PER_VALUE = 20e6, 8 / 3
# Font size of the page, for line widths [pixels]; one step of the depth buffer in the page's depth −1 … 1.
FONT_SIZE, DEPTH_STEP = 16, 2e-6


def write_page(scene: Scene, motions: Sequence[Motion], path: Path, style: PictureStyle) -> None:
    """Write the page, with the initial frame rate and height factor of the style."""
    # Inside HTML, only "<" in the JSON text could end the script.
    data = json.dumps(page_data(scene, motions, style)).replace("<", "\\u003c")
    page, script = (files("warp_plate.viz").joinpath(name).read_text("utf-8") for name in ("page.html", "page.js"))
    path.write_text(page.replace("/*SCRIPT*/", script).replace("/*DATA*/", data), encoding="utf-8")


def page_data(
    scene: Scene, motions: Sequence[Motion], style: PictureStyle, most_bytes: float = PAGE_BYTES
) -> dict[str, Any]:
    """Return all data of the page's script as JSON types; arrays are base64 of little-endian numbers."""
    separate = style.colours.separate
    scales, colours = motion_scales(scene, motions, style.quantity, style.colours)
    scale, heights = scales[0], [motion.displacement for motion in motions]
    field, frames = scale.field, len(colours[0])
    peak = max(float(np.abs(np.nan_to_num(array)).max()) for array in heights) or 1.0
    if field in (DISPLACEMENT, MODE) and not separate and peak <= scale.limit:
        peak, colours = scale.limit, []
    all_nodes = heights[0].shape[1:]
    values = sum(len(array) for array in [*heights, *colours]) * math.prod(all_nodes)
    rows, columns = (shown_nodes(nodes, values, most_bytes) for nodes in all_nodes)
    heights, colours = ([array[:, rows][..., columns] for array in arrays] for arrays in (heights, colours))
    ny, nx = rows.size, columns.size
    if (outlined := outlined_nodes(scene, (ny, nx))) is not None:
        straight = field.kind != "cyclic"
        heights = [outlined.continued(array, moved=True) for array in heights]
        colours = [outlined.continued(array, moved=True, straight=straight) for array in colours]
    meshes, (low, high) = PlateMeshes(scene, heights[0][0], scale), scale.clim
    legends = [_legend(one) for one in scales]
    return {
        "heightWords": bool(scale.heights_text),
        **({"title": "", "ticks": []} if separate else legends[0]),
        "limits": [end / max(-low, high) for end in (low, high)],
        "cyclic": scale.field.kind == "cyclic",
        "none": _rgb(scale.field.nan_colour),
        "table": _base64(lookup_table(scale).values, "u1"),
        "name": scene.title or "Plates in motion",
        "size": list(scene.plate.size),
        "grid": [nx, ny],
        "places": _base64(meshes.surface.points[:, :2], "<f4"),
        "thinned": "" if (ny, nx) == all_nodes else f"{nx} × {ny} of {all_nodes[1]} × {all_nodes[0]} nodes are shown.",
        "frames": len(heights[0]),
        "colourFrames": frames,
        "columns": rows_and_columns(len(motions))[1],
        "rate": style.rate,
        "peak": peak,
        "factor": scale.height_factor if style.heights is None else style.heights,
        "azimuth": AZIMUTH,
        "elevation": ELEVATION,
        "key": legend_entries(scene),
        "triangles": _base64(meshes.surface.faces.reshape(-1, 4)[:, 1:], "<u4"),
        "outlines": _outlines(meshes),
        "names": _names(scene),
        "plates": [
            {
                "headings": [frame_caption(motion, frame, scene) for frame in range(len(motion.times))],
                "heights": _integers(heights[index], peak),
                # null: the heights are the colours, and the outlines those of the scene.
                "colours": _integers(colours[index], scales[index].limit) if colours else None,
                "factor": scales[index].height_factor / scale.height_factor,  # relative to that of the page
                "legend": legends[index] if separate else None,
                "outlines": _outlines(PlateMeshes(motion.scene, heights[0][0], scale)) if motion.scene else None,
                "names": _names(motion.scene) if motion.scene else None,
            }
            for index, motion in enumerate(motions)
        ],
    }


def _names(scene: Scene) -> list[list[Any]]:
    """Return the name of each actuator and the corner of its patch nearest to the viewer [m]."""
    return [[shortened(actuator.name), actuator.box[0], actuator.box[2]] for actuator in scene.actuators]


def _legend(scale: DrawingScale) -> dict[str, Any]:
    """Return title and labels of a colour bar, from its upper end."""
    ticks = [(LABEL_FORMAT % tick).replace("-", "−") for tick in reversed(scale.ticks)]
    return {"title": scale.title, "ticks": ticks}


def shown_nodes(nodes: int, values: int, most_bytes: float = PAGE_BYTES) -> np.ndarray:
    """Return the indices of the nodes along one axis that are shown, about every second, third, … if that many values
    take too many bytes."""
    step = math.ceil(math.sqrt(BYTES_PER_VALUE * values / most_bytes))
    return np.linspace(0, nodes - 1, max(2, round((nodes - 1) / step) + 1)).round().astype(int)


def _outlines(meshes: PlateMeshes) -> list[dict[str, Any]]:
    return [
        {
            "points": _base64(layer.lines.mesh.points[:, :2], "<f4"),
            "nodes": _base64(layer.lines.nodes, "<i4"),
            "shares": _base64(layer.lines.weights, "<f4"),
            "pieces": _base64(layer.lines.mesh.lines.reshape(-1, 3)[:, 1:], "<i4"),
            "colour": [*_rgb(layer.colour), layer.opacity],
            "width": max(1.0, layer.width * FONT_SIZE),
            "nearer": layer.depth_offset * DEPTH_STEP,
        }
        for layer in sorted(line_layers(meshes), key=lambda layer: layer.depth_offset)
    ]


def _integers(array: np.ndarray, limit: float) -> str:
    """Return values as integers, with the limit at PEAK."""
    finite = np.isfinite(array)
    shares = np.clip(np.where(finite, array, 0) / limit, -1, 1)
    return _base64(np.where(finite, np.rint(PEAK * shares), NAN), "<i2")


def _rgb(colour: str) -> list[float]:
    return [part / 255 for part in bytes.fromhex(colour[1:])]


def _base64(array: np.ndarray, kind: str) -> str:
    return base64.b64encode(array.astype(kind).tobytes()).decode("ascii")
