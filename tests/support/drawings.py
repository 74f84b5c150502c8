"""One plate as four programs draw it, and a writer of SVG and DXF files that shares no code with the reader.

The plate is 120 mm by 80 mm with corners of 10 mm radius, a round hole of 8 mm radius at (30, 40) mm and a turned
elliptic one with half axes of 12 and 6 mm at (80, 40) mm, whose first axis points to (0.8, 0.6).
"""

import math

OUTLINE = {"rectangle": (0.12, 0.08), "corner_radius": 0.01}
HOLES = (
    {"disc": (0.03, 0.04, 0.008), "edge": "free"},
    {"ellipse": (0.08, 0.04, 0.012, 0.006, math.atan2(0.6, 0.8)), "edge": "free"},
)

INKSCAPE = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<!-- Created with Inkscape (http://www.inkscape.org/) -->
<svg width="210mm" height="297mm" viewBox="0 0 210 297" version="1.1" id="svg5"
   xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" xmlns="http://www.w3.org/2000/svg">
  <defs id="defs2"><clipPath id="clip"><rect width="9" height="9" x="0" y="0" /></clipPath></defs>
  <g inkscape:label="cut" inkscape:groupmode="layer" id="layer1" transform="translate(-12.5,20)">
    <rect style="fill:none;stroke:#000000" id="rim" width="120" height="80" x="40" y="50" rx="10" ry="10" />
    <circle id="hole" cx="70" cy="90" r="8" />
    <ellipse id="eye" cx="120" cy="90" rx="12" ry="6" transform="matrix(0.8,-0.6,0.6,0.8,-30,90)" />
    <path id="hidden" style="display:none" d="m 1,1 h 1" />
  </g>
  <g inkscape:label="notes" inkscape:groupmode="layer" id="layer2">
    <path id="cross" d="M 20,20 H 200 M 100,0 V 250" /><text x="3" y="3"><tspan>120 mm</tspan></text>
  </g>
</svg>
"""
# In points, as a path of lines and arcs, beside an external document type.
POINT = 72 / 25.4
ILLUSTRATOR = """<?xml version="1.0" encoding="utf-8"?>
<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd">
<svg version="1.1" id="Layer_1" xmlns="http://www.w3.org/2000/svg" x="0px" y="0px" width="500px" height="400px"
      viewBox="0 0 500 400" style="enable-background:new 0 0 500 400;" xml:space="preserve">
<path class="st0" d="M130,100H30c-0,0,0,0,0,0a10,10,0,0,1-10-10V30A10 10 0 0 1 30,20h100.0a10,10 0 0110,10v60
     A10,10,0,0,1,130,100z"/>
<path d="M58,60a8,8,0,1,1-16,0a8,8,0,1,1,16,0z"/>
<ellipse transform="matrix(0.8 -0.6 0.6 0.8 -16 72)" class="st0" cx="100" cy="60" rx="12" ry="6"/>
</svg>
"""


def _groups(*pairs):
    return "".join(f"{code:3d}\n{value}\n" for code, value in pairs)


def _r12():
    """Return separate lines and arcs in any order and direction, without units; the ellipse has no entity in R12."""
    lines = [((10, 0), (110, 0)), ((120, 70), (120, 10)), ((110, 80), (10, 80)), ((0, 10), (0, 70))]
    arcs = [(10, 10, 180), (110, 10, 270), (110, 70, 0), (10, 70, 90)]
    text = _groups((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (0, "ENDSEC"))
    text += _groups((0, "SECTION"), (2, "ENTITIES"))
    for (x0, y0), (x1, y1) in lines:
        text += _groups(
            (0, "LINE"), (8, "cut"), (10, 25.0 + x0), (20, y0), (30, 0.0), (11, 25.0 + x1), (21, y1), (31, 0)
        )
    for x, y, first in arcs:
        text += _groups(
            (0, "ARC"), (8, "cut"), (10, 25.0 + x), (20, y), (40, 10.0), (50, first), (51, (first + 90) % 360)
        )
    text += _groups((0, "CIRCLE"), (8, "cut"), (10, 55.0), (20, 40.0), (40, 8.0))
    text += _groups((0, "TEXT"), (8, "notes"), (10, 1.0), (20, 1.0), (40, 2.5), (1, "panel"))
    return text + _groups((0, "ENDSEC"), (0, "EOF"))


def _autocad():
    """Return a closed polyline with bulges, a circle seen from below, and an ellipse in two parts, in millimetres."""
    quarter = math.tan(math.pi / 8)
    corners = [(10, 0, 0), (110, 0, quarter), (120, 10, 0), (120, 70, quarter), (110, 80, 0), (10, 80, quarter)]
    corners += [(0, 70, 0), (0, 10, quarter)]
    text = _groups((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1024"), (9, "$INSUNITS"), (70, 4))
    text += _groups((0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES"))
    text += _groups((0, "LWPOLYLINE"), (5, "2A1"), (100, "AcDbEntity"), (8, "0"), (100, "AcDbPolyline"))
    text += _groups((90, len(corners)), (70, 1), (43, 0.0))
    for x, y, bulge in corners:
        text += _groups((10, x - 300.0), (20, y + 7.0), *([(42, bulge)] if bulge else []))
    text += _groups((0, "CIRCLE"), (5, "2A2"), (100, "AcDbEntity"), (8, "0"), (100, "AcDbCircle"))
    text += _groups((10, 270.0), (20, 47.0), (30, 0.0), (40, 8.0), (210, 0.0), (220, 0.0), (230, -1.0))
    for first, last in ((0.0, 2.0), (2.0, 2 * math.pi)):
        text += _groups((0, "ELLIPSE"), (5, f"2B{first:g}"), (100, "AcDbEntity"), (8, "0"), (100, "AcDbEllipse"))
        text += _groups((10, -220.0), (20, 47.0), (30, 0.0), (11, 9.6), (21, 7.2), (31, 0.0), (40, 0.5))
        text += _groups((41, first), (42, last))
    return text + _groups((0, "ENDSEC"), (0, "EOF"))


R12, AUTOCAD = _r12(), _autocad()

DRAWINGS = {
    "inkscape": (INKSCAPE, ".svg", {"layer": "cut"}),
    "illustrator": (ILLUSTRATOR, ".svg", {"unit": "mm"}),
    "r12": (R12, ".dxf", {"unit": "mm"}),
    "autocad": (AUTOCAD, ".dxf", {}),
}


def svg_of(loops, transform="", unit="mm"):
    """Return an SVG file in millimetres of loops of rows as in ``plate.outline.path``, drawn upside down."""
    shapes = []
    for number, loop in enumerate(loops):
        text = ""
        for row, ahead in zip(loop, [*loop[1:], loop[0]], strict=True):
            x, y = row[:2]
            text += "" if text else f"M{x!r},{-y!r}"
            if len(row) == 2:
                text += f"L{ahead[0]!r},{-ahead[1]!r}"
            else:  # in halves, since an arc by its ends cannot be a whole ellipse
                for part in (0.5, 1.0):
                    end = ahead[:2] if part == 1 and len(loop) > 1 else point_of(row, part)
                    text += _svg_arc(row, row[-1] / 2, end)
        shapes.append(f'<path id="contour {number}" d="{text}Z"/>')
    size = f'width="100{unit}" height="100{unit}" viewBox="0 0 100 100"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}><g transform="{transform}">{"".join(shapes)}</g></svg>'


def _svg_arc(row, sweep, end):
    first, second = axes_of(row)
    large, side = int(abs(sweep) > math.pi), int(sweep * (first * second.conjugate()).imag > 0)
    radii = f"{abs(first)!r} {abs(second)!r} {-math.degrees(math.atan2(first.imag, first.real))!r}"
    return f"A{radii} {large} {side} {end[0]!r},{-end[1]!r}"


def axes_of(row):
    """Return the half axes x + iy of an arc from its row."""
    centre = complex(row[2], row[3])
    first = complex(row[0], row[1]) - centre
    return first, complex(row[4], row[5]) - centre if len(row) == 7 else 1j * first


def point_of(row, part):
    """Return the point at a part of an arc."""
    first, second = axes_of(row)
    point = complex(row[2], row[3]) + first * math.cos(row[-1] * part) + second * math.sin(row[-1] * part)
    return point.real, point.imag


def dxf_of(loops, insunits=4):
    """Return a DXF file of loops of rows, with the pieces of all loops separate and shuffled by a fixed rule."""
    text = _groups((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1024"), (9, "$INSUNITS"), (70, insunits))
    text += _groups((0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES"))
    listed = [pair for loop in loops for pair in zip(loop, [*loop[1:], loop[0]], strict=True)]
    for number, (row, ahead) in sorted(enumerate(listed), key=lambda pair: (7 * pair[0]) % 11):
        head = [(5, f"{number + 256:X}"), (100, "AcDbEntity"), (8, "0")]
        if len(row) == 2:
            ends = [row, ahead[:2]][:: -1 if number % 2 else 1]
            text += _groups(
                (0, "LINE"), *head, (100, "AcDbLine"), *zip((10, 20, 11, 21), (*ends[0], *ends[1]), strict=True)
            )
            continue
        first, second = axes_of(row)
        low, high = sorted((0.0, row[-1]))
        flipped = (first.conjugate() * second).imag < 0
        low, high = (-high, -low) if flipped else (low, high)
        if len(row) == 5:
            start = math.degrees(math.atan2(first.imag, first.real))
            angles = [] if high - low > 6.28 else [(50, start + math.degrees(low)), (51, start + math.degrees(high))]
            text += _groups((0, "ARC" if angles else "CIRCLE"), *head, (100, "AcDbCircle"), (10, row[2]), (20, row[3]))
            text += _groups((40, abs(first)), *([(100, "AcDbArc"), *angles] if angles else []))
        else:
            text += _groups((0, "ELLIPSE"), *head, (100, "AcDbEllipse"), (10, row[2]), (20, row[3]), (30, 0.0))
            text += _groups((11, first.real), (21, first.imag), (31, 0.0), (40, abs(second) / abs(first)))
            text += _groups((41, low), (42, high))
    return text + _groups((0, "ENDSEC"), (0, "EOF"))
