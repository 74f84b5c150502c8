"""Outlines for cutters: DXF files of closed loops in millimetres, each kind on a layer of its own."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from warp_plate.outline.pieces import Arc, Piece

# Millimetres in a metre, and the code of millimetres in $INSUNITS.
SCALE, MILLIMETRES = 1e3, 4
# Relative difference of the half axes of an arc of a circle.
ROUND = 1e-9

Loop = Sequence[Piece] | np.ndarray


def dxf_of(layers: Mapping[str, Iterable[Loop]]) -> bytes:
    """Return a DXF file of closed loops by layer: pieces, or (corners, 2) x, y [m] of polygons.

    Straight lines and arcs of circles are written as polylines with bulges, discs as circles, and arcs of ellipses as
    such. Equal loops have equal files.

    Raises:
        ValueError: ezdxf is not installed.
    """
    try:
        import ezdxf
    except ImportError:
        raise ValueError("DXF files need ezdxf: pip install 'warp-plate[cad]'") from None
    text, fixed = io.StringIO(), ezdxf.options.write_fixed_meta_data_for_testing
    try:
        ezdxf.options.write_fixed_meta_data_for_testing = True  # no time, and no random identifier
        document = ezdxf.new("R2010", units=MILLIMETRES)
        space = document.modelspace()
        for index, (name, loops) in enumerate(layers.items()):
            document.layers.add(name, color=1 + index % 7)
            for loop in loops:
                _add(space, loop, {"layer": name})
        document.write(text)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = fixed
    return text.getvalue().encode()


def _add(space: Any, loop: Loop, attributes: dict[str, Any]) -> None:
    if isinstance(loop, np.ndarray):
        space.add_lwpolyline((SCALE * loop).tolist(), close=True, dxfattribs=attributes)
    elif len(loop) == 1 and isinstance(loop[0], Arc) and _is_round(loop[0]):
        radius = float(np.linalg.norm(loop[0].axes[:, 0]))
        space.add_circle((SCALE * loop[0].centre).tolist(), SCALE * radius, dxfattribs=attributes)
    elif any(isinstance(piece, Arc) and not _is_round(piece) for piece in loop):
        for piece in loop:
            if isinstance(piece, Arc) and not _is_round(piece):
                _add_ellipse(space, piece, attributes)
            else:
                corners = [_corner(piece), (*(SCALE * piece.end).tolist(), 0.0)]
                space.add_lwpolyline(corners, format="xyb", dxfattribs=attributes)
    else:
        space.add_lwpolyline([_corner(piece) for piece in loop], format="xyb", close=True, dxfattribs=attributes)


def _is_round(arc: Arc) -> bool:
    least, most = sorted(np.linalg.svd(arc.axes, compute_uv=False).tolist())
    return bool(most - least <= ROUND * most)


def _corner(piece: Piece) -> tuple[float, ...]:
    """Return x, y [mm] of the start of a piece, and its bulge, the tangent of a quarter of the angle of an arc."""
    bulge = 0.0
    if isinstance(piece, Arc):
        turn = piece.angles[1] - piece.angles[0]
        bulge = math.copysign(math.tan(abs(turn) / 4), turn * float(np.linalg.det(piece.axes)))
    x, y = (SCALE * piece.start).tolist()
    return x, y, bulge


def _add_ellipse(space: Any, arc: Arc, attributes: dict[str, Any]) -> None:
    """Add an arc of an ellipse, which files have counterclockwise from its longer half axis."""
    left, halves, right = np.linalg.svd(arc.axes)
    cosine, sine = right @ [math.cos(arc.angles[0]), math.sin(arc.angles[0])]
    first = math.atan2(sine, cosine)
    last = first + (arc.angles[1] - arc.angles[0]) * float(np.linalg.det(right))
    if np.linalg.det(left) < 0:
        first, last = -first, -last
    low, high = sorted((first, last))
    major = SCALE * halves[0] * left[:, 0]
    space.add_ellipse(
        (*(SCALE * arc.centre).tolist(), 0.0), (*major.tolist(), 0.0), float(halves[1] / halves[0]),
        low, high, dxfattribs=attributes,
    )  # fmt: skip
