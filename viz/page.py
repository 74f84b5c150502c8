"""A page of plates in motion: one HTML file that plays and turns them in any browser, without a network or a server.

The page draws with WebGL 2 what the other pictures show: the meshes, looks and scale of the builder, written into it.
Of a fine grid it shows every second, third, ... node, so that the file can still be sent and opened.
"""

from __future__ import annotations

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
from warp_plate.viz.camera import AZIMUTH, ELEVATION
from warp_plate.viz.comparison import common_scale, heading, quantity_of, rows_and_columns
from warp_plate.viz.lettering import TICK, key_of, lookup_table
from warp_plate.viz.quantity import DISPLACEMENT, MODE, Quantity
from warp_plate.viz.scene3d import Line, lines_of
from warp_plate.viz.surface import OnSurface, PlateMeshes, plate_meshes

# Fields are whole numbers up to PEAK in the page; STILL stands for what is no number.
PEAK, STILL = 32767, -32768
# What the fields of a page may take as text, about [bytes]; and one whole number, as base64.
MOST_BYTES, A_NUMBER = 20e6, 8 / 3
# Of the page's text, for the widths of lines.
FONT_SIZE = 16
# What one step of a depth buffer is in the page's depth, −1 ... 1.
DEPTH = 2e-6


def write_page(
    scene: Scene,
    motions: Sequence[Motion],
    path: Path,
    quantity: str = "displacement",
    rate: float = 30.0,
    heights: float | None = None,
) -> None:
    """Write the page.

    Args:
        quantity: in colour, a key of QUANTITIES; rate: frames a second at first; heights: see :class:`Look`.

    Raises:
        OSError: the file cannot be written.
    """
    data = page_data(scene, motions, quantity, rate, heights)
    # In JSON inside HTML only this could end the script.
    text = json.dumps(data).replace("<", "\\u003c")
    folder = files("warp_plate.viz")
    page, script = ((folder / name).read_text(encoding="utf-8") for name in ("page.html", "page.js"))
    path.write_text(page.replace("/*SCRIPT*/", script).replace("/*DATA*/", text), encoding="utf-8")


def page_data(
    scene: Scene, motions: Sequence[Motion], quantity: str, rate: float, heights: float | None
) -> dict[str, Any]:
    """All that the page's script reads, as JSON has it; arrays are base64 of little-endian numbers."""
    shown = quantity_of(motions, quantity)
    scale = common_scale(scene, motions, shown)
    same = shown in (DISPLACEMENT, MODE)
    fields = [motion.displacement for motion in motions]
    peak = scale.limit if same else max(float(np.abs(np.nan_to_num(field)).max()) for field in fields) or 1.0
    colours = [] if same else [shown.values(motion) for motion in motions]
    whole = fields[0].shape[1:]
    ny, nx = (thinned(nodes, sum(len(field) for field in [*fields, *colours]) * math.prod(whole)) for nodes in whole)
    fields, colours = ([_at_nodes(field, (ny, nx), shown) for field in of] for of in (fields, colours))
    meshes = plate_meshes(scene, fields[0][0], scale)
    low, high = scale.limits
    return {
        "name": scene.title or "Plates in motion",
        "size": list(scene.plate.size),
        "grid": [nx, ny],
        "thinned": "" if (ny, nx) == whole else f"Of {whole[1]} × {whole[0]} nodes {nx} × {ny} are shown.",
        "frames": len(fields[0]),
        "colourFrames": len(shown.values(motions[0])),
        "columns": rows_and_columns(len(motions))[1],
        "rate": rate,
        "peak": peak,
        "factor": scale.factor if heights is None else heights,
        "heightWords": bool(scale.heights),
        "azimuth": AZIMUTH,
        "elevation": ELEVATION,
        "title": scale.title,
        "limits": [low / high, 1.0],
        "ticks": [(TICK % tick).replace("-", "−") for tick in np.linspace(high, low, 5)],
        "cyclic": shown.kind == "cyclic",
        "none": _rgb(shown.no_number),
        "table": _base64(lookup_table(scale).values.astype(np.uint8)),
        "key": key_of(scene),
        "triangles": _base64(meshes.surface.faces.reshape(-1, 4)[:, 1:].astype("<u4")),
        "outlines": _outlines(meshes),
        "plates": [
            {
                "headings": [heading(motion, frame, scene) for frame in range(len(motion.times))],
                "heights": _whole(fields[index], peak),
                "colours": None if same else _whole(colours[index], scale.limit),
                # Where its actuators are elsewhere; null: as the others'.
                "outlines": _outlines(plate_meshes(motion.scene, fields[0][0], scale)) if motion.scene else None,
            }
            for index, motion in enumerate(motions)
        ],
    }


def thinned(nodes: int, numbers: int) -> int:
    """How many nodes along one side are shown of a grid whose fields are so many numbers.

    Every k-th of both sides, k as small as MOST_BYTES allows, and up to twice that where only then the last node is
    one of them.
    """
    least = math.ceil(math.sqrt(A_NUMBER * numbers / MOST_BYTES))
    step = next((step for step in range(least, 2 * least + 1) if (nodes - 1) % step == 0), least)
    return max(2, round((nodes - 1) / step) + 1)


def _at_nodes(field: np.ndarray, nodes: tuple[int, int], quantity: Quantity) -> np.ndarray:
    """(frames, *nodes) of a field: at nodes of its own, else between its neighbours; of angles, the nearest one's."""
    for axis, count in zip((1, 2), nodes, strict=True):
        at = np.linspace(0, field.shape[axis] - 1, count)
        near = np.rint(at).astype(int)
        if quantity.kind == "cyclic" or np.allclose(at, near):
            field = field.take(near, axis)
            continue
        low = np.minimum(at.astype(int), field.shape[axis] - 2)
        part = (at - low).reshape(-1, 1) if axis == 1 else at - low
        field = field.take(low, axis) * (1 - part) + field.take(low + 1, axis) * part
    return field


def _outlines(meshes: PlateMeshes) -> list[dict[str, Any]]:
    return [_outline(line) for line in sorted(lines_of(meshes), key=lambda line: line.nearer)]


def _outline(line: Line) -> dict[str, Any]:
    outline = line.outline
    return {
        "points": _base64(outline.mesh.points[:, :2].astype("<f4")),
        "nodes": _base64(outline.nodes.astype("<i4")),
        "shares": _base64(outline.shares.astype("<f4")),
        "pieces": _base64(_pieces(outline).astype("<i4")),
        "colour": [*_rgb(line.colour), line.opacity],
        "width": max(1.0, line.width * FONT_SIZE),
        "nearer": line.nearer * DEPTH,
    }


def _pieces(outline: OnSurface) -> np.ndarray:
    """(pieces, 2) indices of the ends of all straight pieces."""
    ways = outline.mesh.lines
    pieces, at = [], 0
    while at < len(ways):
        way = ways[at + 1 : at + 1 + ways[at]]
        pieces.append(np.column_stack([way[:-1], way[1:]]))
        at += 1 + ways[at]
    return np.concatenate(pieces)


def _whole(field: np.ndarray, limit: float) -> str:
    """A field as whole numbers of PEAK parts of the limit."""
    known = np.isfinite(field)
    parts = np.clip(np.where(known, field, 0) / limit, -1, 1)
    return _base64(np.where(known, np.rint(PEAK * parts), STILL).astype("<i2"))


def _rgb(colour: str) -> list[float]:
    """Red, green and blue, 0 ... 1, of #rrggbb."""
    return [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
