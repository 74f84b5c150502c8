"""Drawings: random outlines written and read back, curves within their tolerance, and broken files refused."""

import io
import math

import ezdxf
import numpy as np
import pytest
import svgelements

from support.drawings import dxf_of, svg_of
from warp_plate.outline.contours import piece_of_row
from warp_plate.outline.drawings import read_drawing
from warp_plate.outline.outline import make_outline


def outline_of_rows(loops):
    return make_outline(
        {
            str(number): [
                piece_of_row(row, ahead, f"piece {index}", None, "")
                for index, (row, ahead) in enumerate(zip(rows, [*rows[1:], rows[0]], strict=True))
            ]
            for number, rows in enumerate(loops)
        }
    )


def random_loops(generator):
    """Return rows of a random star of lines and arcs, with a round and an elliptic hole."""
    count = generator.integers(5, 12)
    angles = 2 * math.pi * (np.arange(count) + generator.uniform(-0.3, 0.3, count)) / count
    corners = (generator.uniform(40, 60, count) * np.exp(1j * angles)).tolist()
    rows = []
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        rows.append([start.real, start.imag])
        turn = generator.uniform(0.05, 0.4) * generator.choice([-1, 1])
        if generator.random() < 0.5:
            centre = (start + end) / 2 + 1j * (end - start) / (2 * math.tan(turn / 2))
            rows[-1] += [centre.real, centre.imag, turn]
    x, y = generator.uniform(-9, 9, 2).tolist()
    ratio, direction = generator.uniform(0.2, 0.9), np.exp(1j * generator.uniform(0, 6))
    centre = 12 * direction
    first = 3 * np.exp(1j * generator.uniform(0, 6))
    second = centre + 1j * ratio * first
    ellipse = [(centre + first).real, (centre + first).imag, centre.real, centre.imag, second.real, second.imag]
    x, y = x / 9 - 8 * direction.real, y / 9 - 8 * direction.imag
    loops = [rows, [[*ellipse, 2 * math.pi]], [[x + 2, y, x, y, -2 * math.pi]]]
    return [[[float(number) for number in row] for row in loop] for loop in loops]


def assert_same(loops, read, scale, rel):
    """Assert that an outline is another one scaled and shifted: area, length, and points on it."""
    expected, outline = outline_of_rows(loops), outline_of_rows(read)
    assert outline.area == pytest.approx(expected.area * scale**2, rel=rel)
    assert outline.length == pytest.approx(expected.length * scale, rel=rel)
    assert outline.bounds[::2] == pytest.approx((0, 0), abs=1e-14)
    points = np.concatenate([piece.points(np.linspace(0, 1, 5)) for piece in expected.pieces])
    points = (points - expected.bounds[::2]) * scale
    distances = [min(piece.nearest(point)[1] for piece in outline.pieces) for point in points[::17]]
    assert max(distances) < 1e-6 * scale


@pytest.mark.parametrize("seed", range(2))
def test_random_outlines_are_read_as_written(seed):
    generator = np.random.default_rng(seed)
    for _ in range(3):
        loops = random_loops(generator)
        assert_same(loops, read_drawing(dxf_of(loops).encode(), ".dxf"), 1e-3, 1e-12)
        shift = "translate(3,4) rotate(90) scale(2)"
        read = read_drawing(svg_of(loops).encode(), ".svg")
        assert_same(loops, read, 1e-3, 1e-8)  # an arc of an ellipse by its ends and radii is ill-conditioned
        moved = outline_of_rows(read_drawing(svg_of(loops, shift).encode(), ".svg"))
        assert moved.area == pytest.approx(4 * outline_of_rows(read).area, rel=1e-8)


CURVES = {
    "circle": "M 0,50 C 0,22.4 22.4,0 50,0 C 77.6,0 100,22.4 100,50 S 77.6,100 50,100 C 22.4,100 0,77.6 0,50 Z",
    "drop": "M 0,0 C 150,10 -20,90 100,100 Q 0,100 0,0 Z",
    "control points twice": "M 0,0 C 0,0 80,20 80,20 C 80,20 20,70 0,90 Z",
    "skewed": "M 0,0 C 40,-30 60,30 100,0 S 100,100 50,100 T 0,50 Z",
}


@pytest.mark.parametrize(
    ("name", "tolerance"), [("circle", 1e-3), *((name, 1e-5) for name in CURVES), ("control points twice", 1e-7)]
)
def test_curves_become_smooth_arcs_within_the_tolerance(name, tolerance):
    text = f'<svg xmlns="http://www.w3.org/2000/svg"><path d="{CURVES[name]}"/></svg>'
    outline = outline_of_rows(read_drawing(text.encode(), ".svg", "mm", tolerance))
    segments = [segment for segment in svgelements.Path(CURVES[name]) if not isinstance(segment, svgelements.Move)]
    points = np.array([complex(*segment.point(t)) for segment in segments for t in np.linspace(0, 1, 301)]) * 1e-3
    points = np.stack([points.real - points.real.min(), points.imag.max() - points.imag], axis=-1)
    shift = points.min(axis=0)
    distances = [min(piece.nearest(point)[1] for piece in outline.pieces) for point in points[::151] - shift]
    assert max(distances) < 2 * tolerance  # the corner of the bounding box is known to the tolerance too
    corners = sum(abs(angle - math.pi) > 1e-5 for *_, angle in outline.corners())
    assert corners <= len(segments)


def test_rational_splines_of_dxf():
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 1
    space = document.modelspace()
    spline = space.add_rational_spline([(0, 0), (9, -2), (12, 7), (4, 12), (-3, 5)], [1, 2, 1, 1, 3])
    space.add_line((-3, 5), (0, 0))
    stream = io.StringIO()
    document.write(stream)
    outline = outline_of_rows(read_drawing(stream.getvalue().encode(), ".dxf", tolerance=1e-6))
    tool = spline.construction_tool()
    t = np.linspace(tool.knots()[tool.degree], tool.knots()[-tool.degree - 1], 20001)
    points = np.array([tuple(point)[:2] for point in tool.points(t)]) * 0.0254
    x, y = points.T
    area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    assert outline.area == pytest.approx(area, rel=1e-5)
    distances = [min(piece.nearest(p)[1] for piece in outline.pieces) for p in (points - points.min(axis=0))[::997]]
    assert max(distances) < 2e-6


def svg(body, size='width="100mm" height="100mm" viewBox="0 0 100 100"', head=""):
    return f'{head}<svg xmlns="http://www.w3.org/2000/svg" {size}>{body}</svg>'.encode()


def dxf(*entities, version="AC1015"):
    groups = "".join(f"{code}\n{value}\n" for entity in entities for code, value in entity)
    head = f"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\n{version}\n0\nENDSEC\n"
    return f"{head}0\nSECTION\n2\nENTITIES\n{groups}0\nENDSEC\n0\nEOF\n".encode()


def line(*ends):
    return [(0, "LINE"), (8, "0"), *zip((10, 20, 11, 21), ends, strict=True)]


SQUARE = (line(0, 0, 9, 0), line(9, 9, 9, 0), line(9, 9, 0, 9), line(0, 9, 0, 0))


SPLINE = [(0, "SPLINE"), (100, "AcDbEntity"), (100, "AcDbSpline"), (70, 8), (71, 3)]
SPLINE += [(40, knot) for knot in (0, 0, 0, 0, 1, 1, 1, 1)]
NO_RADIUS = r"CIRCLE \w+: cannot be read: it has no radius"
CONTROLS = [*zip((10, 20) * 4, (0, 0, 9, 0, 9, 9, 0, 0), strict=True)]


HOLE = "<circle id='c' class='b a' cx='30' cy='40' r='5' %s/>"
MOVED = (
    *("transform='rotate(9 5)'", "transform='matrix(1 0 0)'", "transform-origin='30 40'", "clip-path='circle(3px)'"),
    *("mask='url(#k)'", "visibility='inherit'", "style='r:10%'", "style='r:-5px'", "style='display:none !important'"),
    *("style='transform:rotate(9deg)'", "systemLanguage='de'"),
)
MOVING = ("translate", "rotate", "scale", "offset-path", "transform-box", "transform-origin", "zoom", "d")
SHEETS = {
    ".a{transform-origin:3px 3px}": "circle 'c': transform-origin = '3px 3px'",
    "g .a { display: none }": "a style sheet holds 'g .a { display: none', which is not read",
    "@media print{.a{display:none}}": "a style sheet holds '@media'",
    ".b{.a{display:none}}": "a style sheet holds '.b{.a{display:none'",
}


@pytest.mark.parametrize(
    ("data", "suffix", "message"),
    [
        (b"\xff\xfe<", ".svg", "not UTF-8"),
        (b"", ".svg", "not SVG"),
        (b"<html/>", ".svg", "not SVG: its root is 'html'"),
        (svg("<path d='M0 0"), ".svg", "not SVG"),
        (svg("", head='<!DOCTYPE svg [<!ENTITY a "aaaa">]>'), ".svg", "'<!ENTITY'"),
        (svg("<use href='#a'/>"), ".svg", "'<use'"),
        (svg(""), ".svg", "holds no contours"),
        (svg("<path id='a' d='M1 1h0'/>"), ".svg", "holds no contours"),
        (
            svg("<path id='a' d='M0 0L1e300 0L5 5Z'/>"),
            ".svg",
            "path 'a', piece 1: its coordinates are not numbers up to",
        ),
        (svg("<path id='a' d='M0 0C0 1e308 0 0 1 0Z'/>"), ".svg", "path 'a': cannot be read: its coordinates"),
        (svg("<rect width='9' height='9' transform='scale(0)'/>"), ".svg", "holds no contours"),
        (
            svg("<rect width='9' height='9'/>", "width='90px'"),
            ".svg",
            "state no unit of length; write unit",
        ),
        (
            svg("<path id='rim' d='M 0 0 H 50 V 50 H 0'/>"),
            ".svg",
            r"path 'rim', piece 1 ends at \(0, 0\), where nothing",
        ),
        (svg("<path id='rim' d='M 0 0 L 50 50 V 0 L 0 50 Z'/>"), ".svg", "path 'rim', piece 1 crosses or touches path"),
        (svg("<rect id='a' width='9' height='9'/><circle id='b' r='5'/>"), ".svg", "rect 'a', piece .* circle 'b'"),
        (
            svg("<rect id='a' width='9' height='9'/><circle id='b' cx='50' r='2'/>"),
            ".svg",
            "contour of circle 'b': is off",
        ),
        (svg("<path d='M0 0H9V9H0Z M9 9H20V20H9Z'/>"), ".svg", r"ends at \(9, 9\), where it meets shape 1, piece"),
        (svg(" " * 2_000_000), ".svg", "at most 2000000 are read"),
        (svg("<use href='#a'/>").decode().encode("utf-16-le"), ".svg", r"holds '\\x00'"),
        (svg(f"<style>{'a{' * 20_000}</style>"), ".svg", "a style sheet of 40000 bytes; at most 20000 are read"),
        (svg("<path id='a' d='M0 0L9 0L9 9L nan 9Z'/>"), ".svg", "path 'a': d = 'M0 0L9 0L9 9L nan 9Z' is not read"),
        (svg("<path id='a' d='M0 0L9'/>"), ".svg", "path 'a': d = 'M0 0L9' is not read"),
        (svg("<path id='a' d='L9 0L9 9Z'/>"), ".svg", "path 'a': d = 'L9 0L9 9Z' is not read"),
        (svg("<polygon points='0 0 9 0 nan 5 9 9'/>"), ".svg", "polygon: points = '0 0 9 0 nan 5 9 9' is not read"),
        (svg("<rect width='5em' height='9'/>"), ".svg", "rect: width = '5em' is not read"),
        (svg("<g transform='rotate(45deg)'><path d='M0 0'/></g>"), ".svg", r"g: transform = 'rotate\(45deg\)' is not"),
        (svg("", "width='1mm' viewBox='a b'"), ".svg", "its viewBox = 'a b' is not four numbers"),
        (svg("", "width='9mm' viewBox='0 0 9 0'"), ".svg", "its viewBox = '0 0 9 0' is not four numbers, the last two"),
        (svg("", "width='9mm' viewBox='0 0 9'"), ".svg", "its viewBox = '0 0 9' is not four numbers"),
        (svg("", "width='0mm' height='0mm' viewBox='0 0 9 9'"), ".svg", "its width = '0mm': must be above 0, in mm"),
        (svg("", "width='9mm' height='0mm' viewBox='0 0 9 9'"), ".svg", "its height = '0mm': must be above 0, in mm"),
        (svg("", "width='9mm' height='5em' viewBox='0 0 9 9'"), ".svg", "its height = '5em': must be above 0, in mm"),
        (svg('<path d="M0 0 H V5 z"/>'), ".svg", "path: d = 'M0 0 H V5 z' is not read"),
        (
            svg("", "width='9mm' height='18mm' viewBox='0 0 9 9' preserveAspectRatio='xMidYMid slice'"),
            ".svg",
            "stretch its viewBox",
        ),
        *((svg(HOLE % text), ".svg", "circle 'c': .* is not read; apply or remove it") for text in MOVED),
        *((svg(HOLE % f"style='{key}:9px'"), ".svg", f"circle 'c': {key} = '9px'") for key in MOVING),
        *((svg(f"<style>{text}</style>{HOLE % ''}"), ".svg", message) for text, message in SHEETS.items()),
        (svg(f"<g clip-path='url(#k)'>{HOLE % ''}</g>"), ".svg", r"g: clip-path = 'url\(#k\)' is not read"),
        (svg(f"<switch><g/>{HOLE % ''}</switch>"), ".svg", "switch is not read"),
        (svg(f"<svg id='a' width='9'>{HOLE % ''}</svg>"), ".svg", "nested svg 'a' is not read"),
        (svg("<rect width='9'><animate/></rect>"), ".svg", "animate is not read"),
        (svg("", head="<?xml-stylesheet href='a.css'?>"), ".svg", r"holds '<\?xml-stylesheet'"),
        (svg("", "display='none'"), ".svg", "svg: display = 'none' is not read"),
        (
            svg("<path id='a' d='M0 0A1e-300 5 0 1 1 5 0Z'/>"),
            ".svg",
            "path 'a': d = 'M0 0A1e-300 5 0 1 1 5 0Z' is not read",
        ),
        (b"<svg xmlns='urn:x' width='9mm'/>", ".svg", "not SVG: its root is '{urn:x}svg'"),
        (svg("<rect visibility='hidden' width='9' height='9'/><path/>"), ".svg", "holds no contours"),
        (svg("<symbol><rect width='9' height='9'/></symbol>"), ".svg", "holds no contours"),
        (bytes(999), ".dxf", r"cannot be read as DXF: Invalid group code \"\?\?"),
        (svg(f"<path d='M0 0{'L1 1' * 3000}Z'/>"), ".svg", "more than 2000 pieces"),
        (b"", ".dxf", "cannot be read as DXF"),
        (dxf(*SQUARE[:3]), ".dxf", "INSUNITS state no unit"),
        (b"AutoCAD Binary DXF\r\n\x1a\x00", ".dxf", "cannot be read as DXF"),
    ],
)
def test_broken_files_are_refused_by_the_names_of_their_pieces(data, suffix, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_drawing(data, suffix)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (HOLE % "style='transform:scale(2);transform-origin:0 0; r:/* */3px'", (60, 80, 6)),
        (HOLE % "style='fill:none' transform='translate(-1.5.5)'", (28.5, 40.5, 5)),
        ("<style>@font-face{src:url(//a)}.a{r:3px}.b{r:9px}</style>" + HOLE % "", (30, 40, 9)),
        (HOLE % "" + "<style>.a{r:3px}*{r:9px}</style>", (30, 40, 3)),
        ("<style>#c{display:inline}circle.a{display:none}</style>" + HOLE % "", (30, 40, 5)),
        ("<g cx='9' rx='9'><circle cy='40' r='5'/></g>", (0, 40, 5)),
        (f"<switch><foreignObject/><g>{HOLE % ''}</g></switch>", (30, 40, 5)),
        (HOLE % "" + f"<style>.z{{display:none}}</style><g class='z'>{HOLE % ''}</g>", (30, 40, 5)),
        (HOLE % "" + f"<text>{HOLE % ''}</text><rect x='20' height='9'/>", (30, 40, 5)),
    ],
)  # fmt: skip
def test_shapes_are_where_viewers_draw_them(body, expected):
    _, hole = read_drawing(svg(f"<rect x='-20' width='120' height='100'/>{body}"), ".svg")
    x, y, radius = expected
    assert hole[0][:4] == pytest.approx([(20 + x + radius) / 1e3, (100 - y) / 1e3, (20 + x) / 1e3, (100 - y) / 1e3])


@pytest.mark.parametrize(
    ("entities", "message"),
    [
        (SQUARE[:3], r"LINE \w+ ends at \(0, 0\), where nothing begins"),
        ((*SQUARE, SQUARE[0]), r"ends at .*, where it meets LINE \w+, LINE \w+; .* twice"),
        ((*SQUARE, [(0, "ARC"), (10, 4), (20, 4), (40, 2), (50, "1e300"), (51, 30)]), r"ARC \w+ ends at"),
        ((*SQUARE, [(0, "FOO"), (5, "AB")]), "FOO AB: is not read; explode it"),
        ((*SQUARE, [*line(1, 1, 2, 2), (31, 5)]), r"LINE \w+: cannot be read: it does not lie in the plane"),
        (([*SPLINE, *[(41, 0)] * 4, *CONTROLS],), r"SPLINE \w+: cannot be read: float division"),
        (([*SPLINE, *CONTROLS * 501],), r"SPLINE \w+: cannot be read: it has more than 2000 points; simplify it"),
        ((*SQUARE, line(20, 0, 30, 0)), r"LINE \w+ ends at \(20, 0\)"),
        ((*SQUARE, [(0, "INSERT"), (2, "screw"), (10, 1), (20, 1)]), r"INSERT \w+: is not read; explode it"),
        *(((*SQUARE, [(0, "CIRCLE"), (10, 4), (20, 4), *radius]), NO_RADIUS) for radius in ([], [(40, -2)])),
        ((*SQUARE, *[[(0, "CIRCLE"), (5, "AA"), (10, x), (20, 4), (40, 1)] for x in (2, 6)]), "two .* handle 'AA'"),
        ((*SQUARE, [*SPLINE, *CONTROLS[:2], (30, 1), *CONTROLS[2:]]), "SPLINE .* not lie in the plane"),
        ((*SQUARE, [(0, "CIRCLE"), (10, 4), (20, 4), (40, 0)]), r"CIRCLE \w+: cannot be read: it has no radius"),
        ((*SQUARE, [(0, "CIRCLE"), (10, 4), (20, 4), (40, 2), (210, 1), (220, 0), (230, 0)]), "plane of x and y"),
        ((*SQUARE, [(0, "CIRCLE"), (10, 9), (20, 4), (40, 2)]), r"LINE \w+ crosses or touches CIRCLE \w+"),
    ],
)
def test_dxf_entities_are_refused_by_their_handles(entities, message):
    with pytest.raises(ValueError, match=message):
        read_drawing(dxf(*entities), ".dxf", "mm")


def test_entities_that_r12_has_not_are_refused_in_its_files():
    with pytest.raises(ValueError, match=r"SPLINE \w+: R12 has none, and \$ACADVER is that"):
        read_drawing(dxf(*SQUARE, [*SPLINE, *CONTROLS], version="AC1009"), ".dxf", "mm", layer="cut")


def test_many_contours_that_touch_are_a_line_that_can_be_read():
    with pytest.raises(ValueError, match=r"where it meets .*\[\.\.\.\]") as refused:
        read_drawing(svg("<path d='M0 0H9V9H0Z'/>" * 100), ".svg")
    assert len(str(refused.value)) < 400


def test_ends_that_nearly_meet_are_joined():
    entities = (line(0, 0, 9, 4e-6), line(9, 9, 9, 0), line(9, 9, 0, 9), line(0, 9, 3e-6, 0))
    (rows,) = read_drawing(dxf(*entities), ".dxf", "mm")
    assert outline_of_rows([rows]).area == pytest.approx(81e-6, rel=1e-6)


def test_arcs_without_radius_are_straight():
    """SVG 1.1, appendix F.6: arcs without a radius are lines, and those without a length nothing."""
    (rows,) = read_drawing(svg("<path d='M0 0 A0 5 0 1 1 10 0 L5 5 A9 9 0 0 0 5 5 Z'/>"), ".svg")
    assert np.array(rows) == pytest.approx(1e-3 * np.array([(0, 5), (5, 0), (10, 5)]))


def written(document):
    stream = io.StringIO()
    document.write(stream)
    return stream.getvalue().encode()


@pytest.mark.parametrize("attributes", [{"layer": "Construction"}, {"invisible": 1}, {"paperspace": 1}])
def test_what_is_hidden_is_skipped(attributes):
    document = ezdxf.new("R2010")
    document.layers.add("construction").freeze()
    document.modelspace().add_lwpolyline([(0, 0), (9, 0), (9, 9)], close=True)
    (document.paperspace() if "paperspace" in attributes else document.modelspace()).add_circle((4, 2), 1, attributes)
    assert len(read_drawing(written(document), ".dxf", "m")) == 1


@pytest.mark.parametrize("first", [0, -3])
def test_periodic_splines_close(first):
    document = ezdxf.new("R2010")
    corners = np.array([(0, 0), (9, 0), (9, 9), (0, 9), (0, 0), (9, 0), (9, 9)], dtype=float)
    spline = document.modelspace().add_spline()
    spline.set_uniform(corners, 3)
    spline.knots = np.array(spline.knots) + first
    (rows,) = read_drawing(written(document), ".dxf", "m", tolerance=1e-6)
    t = np.linspace(0, 1, 1001)[:, None]
    basis = np.hstack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6
    x, y = np.concatenate([basis[:-1] @ corners[index : index + 4] for index in range(4)]).T
    area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    assert outline_of_rows([rows]).area == pytest.approx(area, rel=1e-5)


def test_blocks_are_refused_where_they_reach_the_layer():
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 9
    document.blocks.new("screw").add_circle((5, 1), 1, {"layer": "Cut"})
    document.blocks.new("frame").add_blockref("screw", (0, 0))
    document.modelspace().add_lwpolyline([(0, 0), (9, 0), (9, 9)], close=True, dxfattribs={"layer": "CUT"})
    document.modelspace().add_blockref("frame", (0, 0))
    with pytest.raises(ValueError, match=r"INSERT \w+: is not read; explode it"):
        read_drawing(written(document), ".dxf", layer="cut")
    document.blocks.get("screw").delete_all_entities()
    (rows,) = read_drawing(written(document), ".dxf", layer="cut")
    assert outline_of_rows([rows]).area == pytest.approx(81 / 2 * 2.54e-5**2)
    with pytest.raises(ValueError, match=r"its \$INSUNITS state a unit of 2.54e-05 m, but unit one of 0.001 m"):
        read_drawing(written(document), ".dxf", "mm", layer="cut")
