"""Outlines drawn by other programs: SVG and DXF files, read into closed contours."""

import cmath
import io
import logging
import math
import re
from collections.abc import Iterator
from itertools import dropwhile, islice, pairwise, takewhile
from typing import Any
from xml.etree import ElementTree

import numpy as np

from warp_plate.outline.contours import LEAST_TURN, Curve, arcs_of_curve, chord, joined, mapped, rows_of_loop
from warp_plate.outline.outline import bounds, make_outline
from warp_plate.outline.pieces import Arc, Piece, Straight
from warp_plate.outline.svg_trees import LONGEST_NAME, make_plain

# SVG files are read at some 10 s for a megabyte, DXF files at some seconds.
MOST_BYTES, MOST_PIECES = {".svg": 2 * 10**6, ".dxf": 10**7}, 2000
# Metres in each unit; those of SVG sizes, pixels as CSS has them; those of $INSUNITS in DXF files.
UNITS = {"m": 1.0, "mm": 1e-3, "inch": 0.0254}
SVG_UNITS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6, "Q": 2.5e-4}
PIXEL = 0.0254 / 96
DXF_UNITS = {1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8, 9: 2.54e-5, 10: 0.9144}
DXF_UNITS |= {11: 1e-10, 12: 1e-9, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 17: 1e9, 21: 1200 / 3937, 22: 100 / 3937}
# Flattened curves are this part of the drawing's longer side off, unless a tolerance is given.
TOLERANCE = 1e-5
# Entities of DXF files that draw no contour.
SILENT = {"TEXT", "MTEXT", "DIMENSION", "POINT", "LEADER", "MLEADER", "MULTILEADER", "HATCH", "ATTDEF", "ATTRIB",
          "VIEWPORT", "IMAGE", "TOLERANCE", "XLINE", "RAY"}  # fmt: skip
DRAWN = {"LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE"}
# A straight, circular or elliptic piece, or a smooth curve between two parameters with its name.
Drawn = Piece | tuple[str, Curve, float, float]
# Largest coordinate, and what the libraries raise on files that are not as they expect.
FARTHEST = 1e12
BROKEN = (ArithmeticError, AttributeError, LookupError, TypeError, RecursionError)
LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
# Arcs that turn by less [rad] are straight.
STRAIGHT = 1e-6


@np.errstate(all="ignore")
def read_drawing(
    data: bytes, suffix: str, unit: str | None = None, tolerance: float | None = None, layer: str | None = None
) -> list[list[list[float]]]:
    """Return the contours of a drawing as rows of numbers [m] of :func:`rows_of_loop`, the outline first, then holes.

    The lower left corner of the outline is the origin. ``suffix`` is ".svg" or ".dxf", ``unit`` one of ``UNITS``,
    ``tolerance`` the largest distance [m] of arcs from curves, ``layer`` the layer, or the id or label in an SVG file.

    Raises:
        ValueError: The file is broken or has no unit, or its contours are open, touch or cross.
    """
    if len(data) > MOST_BYTES[suffix]:
        raise ValueError(f"{len(data)} bytes; at most {MOST_BYTES[suffix]} are read")
    reader = _read_svg if suffix == ".svg" else _read_dxf
    try:
        # DXF files before 2007 have code pages; letters beyond ASCII are in names and texts alone.
        text = data.decode("utf-8-sig", "replace" if suffix == ".dxf" else "strict")
        scale, drawn = reader(text, None if unit is None else UNITS[unit], layer)
    except UnicodeDecodeError:
        raise ValueError("not UTF-8 text") from None
    except BROKEN as error:
        raise ValueError(f"cannot be read: {_line(error)}") from None
    rough = [part if isinstance(part, Piece) else _chord(*part) for part in drawn]
    if not rough:
        raise ValueError("holds no contours" + (f" in {layer!r}" if layer else ""))
    for piece in rough:
        _check(piece)
    x0, x1, y0, y1 = bounds(rough)
    within = TOLERANCE * max(x1 - x0, y1 - y0) if tolerance is None else tolerance / abs(scale)
    flat: list[Piece] = []
    for part in drawn:
        try:
            for piece in (part,) if isinstance(part, Piece) else arcs_of_curve(part[1], *part[2:], within, part[0]):
                _check(piece)
                flat.append(piece)
                if len(flat) > MOST_PIECES:
                    raise ValueError(f"more than {MOST_PIECES} pieces, arcs of flattened curves included; simplify it")
        except BROKEN as error:
            name = part.name if isinstance(part, Piece) else part[0]
            raise ValueError(f"{name}: cannot be read: {_line(error)}") from None
    if not (contours := joined(flat)):
        raise ValueError("holds no contours of any length")
    matrix = scale * np.diag([1.0, -1.0 if suffix == ".svg" else 1.0])
    outer = [mapped(piece, matrix, np.zeros(2)) for piece in contours[0]]
    shift = -np.array(bounds(outer)[::2])
    loops = {f"the contour of {loop[0].name}": [mapped(piece, matrix, shift) for piece in loop] for loop in contours}
    outline = make_outline(loops)
    return [rows_of_loop(loop) for loop in outline.loops]


def _line(error: Exception) -> str:
    """Return the message of a library as a part of a line."""
    return "".join(letter if letter.isprintable() else "?" for letter in " ".join(str(error).split())[:200])


def _check(piece: Piece) -> None:
    if not np.abs(bounds([piece])).max() < FARTHEST:
        raise ValueError(f"{piece.name}: its coordinates are not numbers up to {FARTHEST:g}")


def _chord(name: str, curve: Curve, low: float, high: float) -> Piece:
    return chord(curve(low)[0], curve(high)[0], name)


def _read_svg(text: str, unit: float | None, layer: str | None) -> tuple[float, list[Drawn]]:
    """Return metres in a user unit, and what an SVG file draws, in user units with y downwards."""
    # Entities and clones can stand for far more than the file holds; zero bytes hide them from this search.
    if (banned := re.search(r"<!ENTITY|<(?:[\w.-]+:)?use[\s/>]|<\?xml-stylesheet|\0", text)) is not None:
        raise ValueError(f"holds {banned[0].strip()!r}, which is not read; unlink clones and save as plain SVG")
    try:
        import svgelements as svg
    except ImportError:
        raise ValueError("SVG files need svgelements: pip install 'warp-plate[cad]'") from None
    try:
        root = ElementTree.parse(io.StringIO(text)).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"not SVG: {error}") from None
    if root.tag not in ("svg", "{http://www.w3.org/2000/svg}svg"):
        raise ValueError(f"not SVG: its root is {root.tag[:200]!r}")
    make_plain(svg, root)
    scale = _svg_unit(root.attrib, unit)
    document = svg.SVG.parse(io.StringIO(ElementTree.tostring(root, "unicode")), reify=False)
    undo = svg.Matrix(document.viewbox_transform or "")
    undo.inverse()
    drawn: list[Drawn] = []
    for number, (element, chosen) in enumerate(_svg_shapes(svg, document, layer), 1):
        if chosen:
            label = element.id and element.id[:LONGEST_NAME]
            name = f"{type(element).__name__.lower()} {label!r}" if label else f"shape {number}"
            try:
                drawn += islice(_svg_pieces(svg, element, element.transform * undo, name), MOST_PIECES + 1)
            except (*BROKEN, ValueError) as error:
                raise ValueError(f"{name}: cannot be read: {error}") from None
            if len(drawn) > MOST_PIECES:
                break  # refused with the arcs of curves
    return scale, drawn


def _svg_unit(size: Any, unit: float | None) -> float:
    """Return metres in a user unit, from the attributes of the root or as given."""
    number = r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*"
    sides = [re.fullmatch(rf"{number}([a-zA-Z%]*)\s*", size.get(side, "")) for side in ("width", "height")]
    for name, side in zip(("width", "height"), sides, strict=True):
        if size.get(name) and not (side and float(side[1]) > 0 and side[2] in ("", "px", "%", *SVG_UNITS)):
            rule = f"must be above 0, in {', '.join(SVG_UNITS)}, px or %"
            raise ValueError(f"its {name} = {size[name][:LONGEST_NAME]!r}: {rule}")
    units = [SVG_UNITS.get(side[2]) if side else None for side in sides]
    try:
        box = [float(part) for part in re.split(r"[\s,]+", size.get("viewBox", "").strip()) if part]
        if box and not (len(box) == 4 and all(0 < side < FARTHEST for side in box[2:])):
            raise ValueError
    except ValueError:
        rule = "is not four numbers, the last two above 0"
        raise ValueError(f"its viewBox = {size['viewBox'][:LONGEST_NAME]!r} {rule}") from None
    stated = None
    if any(units):
        ratios = [PIXEL] * (not box)
        for side, metres, extent in zip(sides, units, box[2:4], strict=False):
            if side and metres and float(side[1]) > 0 and 0 < extent < FARTHEST:
                ratios.append(float(side[1]) * metres / extent)
        fitted = re.search("none|slice", size.get("preserveAspectRatio", "")) is None
        if ratios and not fitted and max(ratios) > (1 + 1e-6) * min(ratios):
            raise ValueError("its width and height stretch its viewBox, which is not read; save it without")
        stated = min(ratios, default=None)
    return _unit(stated, unit, "its width and height")


def _unit(stated: float | None, unit: float | None, where: str) -> float:
    """Return metres in a unit of a file, as stated in it or as given; ValueError: neither, or both and they differ."""
    if stated is None and unit is None:
        raise ValueError(f"{where} state no unit of length; write unit as one of {', '.join(UNITS)}")
    if stated and unit and abs(stated / unit - 1) > 1e-6:
        raise ValueError(f"{where} state a unit of {stated:.6g} m, but unit one of {unit:g} m; delete unit")
    return stated or unit or 1.0


def _svg_shapes(svg: Any, group: Any, layer: str | None, chosen: bool = False) -> Iterator[tuple[Any, bool]]:
    """Yield all shapes below a group, and whether they are, or lie in, the layer."""
    for element in group:
        attributes = element.values.get("attributes", element.values)
        here = chosen or layer is None or layer in (element.id, attributes.get(LABEL))
        if isinstance(element, svg.Group):
            yield from _svg_shapes(svg, element, layer, here)
        elif isinstance(element, svg.Shape) and element.values.get("visibility") not in ("hidden", "collapse"):
            yield element, here


def _svg_pieces(svg: Any, shape: Any, transform: Any, name: str) -> Iterator[Drawn]:
    matrix = np.array([[transform.a, transform.c], [transform.b, transform.d]])
    shift = np.array([transform.e, transform.f])
    if isinstance(shape, svg.Ellipse | svg.Circle):
        axes = np.diag([float(shape.rx), float(shape.ry)])
        yield mapped(
            Arc(None, "", name, np.array([shape.cx, shape.cy], float), axes, (0.0, 2 * math.pi)), matrix, shift
        )
        return
    count = 0
    for segment in shape.segments(transformed=False):
        if isinstance(segment, svg.Move):
            continue
        count += 1
        if None in (segment.start, segment.end):
            raise ValueError("its path does not begin with a point")
        label, ends = f"{name}, piece {count}", np.array([segment.start, segment.end], dtype=float)
        if isinstance(segment, svg.Arc) and abs(segment.sweep) > STRAIGHT and min(segment.rx, segment.ry) > 0:
            centre = np.array(segment.center, dtype=float)
            axes = np.stack([np.array(end, dtype=float) - centre for end in (segment.prx, segment.pry)], axis=1)
            cosine, sine = np.linalg.solve(axes, ends[0] - centre)
            angle = math.atan2(sine, cosine)
            yield mapped(Arc(None, "", label, centre, axes, (angle, angle + segment.sweep)), matrix, shift)
        elif isinstance(segment, svg.CubicBezier | svg.QuadraticBezier):
            yield label, _bezier(np.array(list(segment), dtype=float) @ matrix.T + shift), 0.0, 1.0
        else:
            yield mapped(Straight(None, "", label, ends), matrix, shift)


def _bezier(controls: np.ndarray) -> Curve:
    """Return the curve of control points (3 or 4, 2)."""
    if not np.abs(controls).max() < FARTHEST:
        raise ValueError(f"its coordinates are not numbers up to {FARTHEST:g}")
    points = controls @ np.array([1, 1j])
    degree = len(points) - 1
    slopes = degree * np.diff(points)
    rows = {n: [math.comb(n, i) for i in range(n + 1)] for n in (degree, degree - 1)}

    def curve(t: float) -> tuple[complex, complex]:
        value, slope = (
            sum(w * (1 - t) ** (n - i) * t**i * complex(p) for i, (w, p) in enumerate(zip(rows[n], given, strict=True)))
            for n, given in ((degree, points), (degree - 1, slopes))
        )
        return value, slope

    return curve


def _read_dxf(text: str, unit: float | None, layer: str | None) -> tuple[float, list[Drawn]]:
    """Return metres in a unit of a DXF file, and what it draws."""
    try:
        import ezdxf
    except ImportError:
        raise ValueError("DXF files need ezdxf: pip install 'warp-plate[cad]'") from None
    logging.getLogger("ezdxf").setLevel(logging.CRITICAL)
    try:
        document = ezdxf.read(io.StringIO(text))
    except ezdxf.DXFError as error:
        raise ValueError(f"cannot be read as DXF: {_line(error)}") from None
    _check_handles(text)
    # Files of R12 may have no such variable, for which ezdxf has a default.
    units = document.header.get("$INSUNITS", 0) if "$INSUNITS" in text else 0
    scale = _unit(DXF_UNITS.get(units), unit, "its $INSUNITS")
    drawn: list[Drawn] = []
    for entity in document.modelspace():
        kind, name = entity.dxftype(), f"{entity.dxftype()} {entity.dxf.get('handle', '')}"
        if kind in ("LWPOLYLINE", "SPLINE") and document.dxfversion < "AC1012":
            # Neither their layers nor their flags and directions are read by ezdxf.
            raise ValueError(f"{name}: R12 has none, and $ACADVER is that or missing; save the file as R2000 or later")
        on = _known(entity, "layer", "0")
        of_layer = document.layers.get(on) if document.layers.has_entry(on) else None
        hidden = of_layer is not None and (of_layer.is_off() or of_layer.is_frozen())
        wanted = layer is None or on.lower() == layer.lower()
        if kind == "INSERT" and not wanted:
            wanted = _block_reaches(document, entity.dxf.get("name", ""), layer, set())
        if kind in SILENT or hidden or _known(entity, "invisible", 0) or not wanted:
            continue
        try:
            parts = list(islice(_dxf_pieces(entity, kind, name), MOST_PIECES + 1)) if kind in DRAWN else []
        except (*BROKEN, ValueError, ezdxf.DXFError) as error:
            raise ValueError(f"{name}: cannot be read: {_line(error)}") from None
        if not parts:
            raise ValueError(f"{name}: is not read; explode it into lines, arcs, polylines or splines, or name a layer")
        drawn += parts
        if len(drawn) > MOST_PIECES:
            break  # refused with the arcs of curves
    return scale, drawn


def _known(entity: Any, key: str, default: Any) -> Any:
    """Return an attribute of an entity, whose kind may not have it."""
    return entity.dxf.get(key, default) if entity.dxf.is_supported(key) else default


def _check_handles(text: str) -> None:
    """Refuse entities of the same handle, of which the library keeps the last alone."""
    lines = (line.strip() for line in text.split("\n"))
    groups = dropwhile(lambda group: group != ("2", "ENTITIES"), zip(lines, lines, strict=False))
    seen: set[str] = set()
    for code, value in takewhile(lambda group: group != ("0", "ENDSEC"), groups):
        if code == "5" and value in seen:
            raise ValueError(f"two entities have the handle {value[:LONGEST_NAME]!r}; give each its own, or none")
        if code == "5":
            seen.add(value)


def _block_reaches(document: Any, name: str, layer: str | None, seen: set[str]) -> bool:
    """Say whether a block, or a block in it, draws on a layer; what is on layer 0 is on that of the insert."""
    if layer in (None, "0") or name in seen:
        return False
    seen.add(name)
    return any(
        _known(inner, "layer", "0").lower() == layer.lower()
        or (inner.dxftype() == "INSERT" and _block_reaches(document, inner.dxf.get("name", ""), layer, seen))
        for inner in document.blocks.get(name) or ()
        if inner.dxftype() not in SILENT
    )


def _dxf_pieces(entity: Any, kind: str, name: str) -> Iterator[Drawn]:
    """Yield the pieces of an entity; none if it is of another kind."""
    normal = np.array(entity.dxf.get("extrusion", (0, 0, 1)), dtype=float)
    if abs(normal[:2]).max() > 1e-9:
        raise ValueError("it does not lie in the plane of x and y")
    # Arcs, circles and polylines seen from below are mirrored.
    mirror = np.diag([1.0 if normal[2] > 0 else -1.0, 1.0])
    still = np.zeros(2)
    if kind == "LINE":
        yield Straight(None, "", name, _plane(entity.dxf.start, entity.dxf.end))
    elif kind in ("ARC", "CIRCLE"):
        if not entity.dxf.get("radius", 0) > 0:
            raise ValueError("it has no radius")
        first, last = (entity.dxf.start_angle, entity.dxf.end_angle) if kind == "ARC" else (0.0, 360.0)
        arc = _arc(
            name, _plane(entity.dxf.center)[0], entity.dxf.radius * np.eye(2), math.radians(first), math.radians(last)
        )
        yield mapped(arc, mirror, still)
    elif kind == "ELLIPSE":
        major = _plane((0, 0, 0), entity.dxf.major_axis)[1]
        minor = entity.dxf.ratio * np.sign(normal[2]) * np.array([-major[1], major[0]])
        axes = np.stack([major, minor], axis=1)
        yield _arc(name, _plane(entity.dxf.center)[0], axes, entity.dxf.start_param, entity.dxf.end_param)
    elif kind == "LWPOLYLINE" or (kind == "POLYLINE" and entity.is_2d_polyline and not entity.dxf.flags & 6):
        if kind == "LWPOLYLINE":
            corners = [(complex(x, y), bulge) for x, y, bulge in entity.get_points("xyb")]
        else:
            corners = [(complex(*_plane(row.dxf.location)[0]), row.dxf.bulge) for row in entity.vertices]
        for index, ((start, bulge), (end, _)) in enumerate(pairwise([*corners, *corners[: entity.is_closed]]), 1):
            yield mapped(_bulge(start, end, bulge, f"{name}, piece {index}"), mirror, still)
    elif kind == "SPLINE":
        if max(len(entity.control_points), len(entity.fit_points)) > MOST_PIECES:
            raise ValueError(f"it has more than {MOST_PIECES} points; simplify it")
        spline = entity.construction_tool()
        _plane(*entity.control_points, *entity.fit_points)

        def curve(t: float) -> tuple[complex, complex]:
            point, slope = spline.derivative(t, 1)
            return complex(*_plane(point)[0]), complex(*_plane(slope)[0])

        knots = list(spline.knots())
        first, last = knots[spline.degree], knots[-spline.degree - 1]
        for low, high in pairwise(sorted({knot for knot in knots if first <= knot <= last})):
            curve(low), curve(high)  # errors of the library, here with the name of the entity
            yield name, curve, low, high


def _plane(*points: Any) -> np.ndarray:
    """Return x and y (n, 2) of points in space; ValueError: they do not lie in a plane of x and y."""
    places = np.array([tuple(point) for point in points], dtype=float)
    extent = np.ptp(places, axis=0)
    if extent[2:].max(initial=0) > 1e-9 * extent.max():
        raise ValueError("it does not lie in the plane of x and y")
    return places[:, :2]


def _arc(name: str, centre: Any, axes: np.ndarray, first: float, last: float) -> Piece:
    """Return the counterclockwise arc between two angles [rad]; a whole ellipse if they agree."""
    sweep = (last - first) % (2 * math.pi)
    sweep = 2 * math.pi if min(sweep, 2 * math.pi - sweep) < 1e-9 else sweep
    if not abs(np.linalg.det(axes)) > 0:
        raise ValueError("it has no radius")
    first %= 2 * math.pi
    return Arc(None, "", name, np.array(centre, dtype=float), axes, (first, first + sweep))


def _bulge(start: complex, end: complex, bulge: float, name: str) -> Piece:
    """Return the piece between two vertices; its bulge is the tangent of a quarter of the turn."""
    if abs(bulge) < LEAST_TURN or start == end:
        return chord(start, end, name)
    centre = (start + end) / 2 + 1j * (end - start) * (1 - bulge**2) / (4 * bulge)
    angle = cmath.phase(start - centre)
    axes = abs(start - centre) * np.eye(2)
    return Arc(None, "", name, np.array([centre.real, centre.imag]), axes, (angle, angle + 4 * math.atan(bulge)))
