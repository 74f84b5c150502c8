"""A scene from above as SVG: edges by kind, target, actuators, layers and oscillators. Needs no library."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from warp_plate.result.outlines import target_outlines
from warp_plate.scene.model import Area, Scene
from warp_plate.scene.target import NamedTarget, Target
from warp_plate.viz.edges import NAMES, SIDES, edge_kind
from warp_plate.viz.lettering import INK, TARGET

# The longer side of the plate in pixels, and the room around it.
LENGTH, MARGIN = 240.0, 14.0
LAYER, OSCILLATOR = "#8c6bb1", "#e6820e"


def scene_plan(scene: Scene) -> Element:
    """The element ``svg``, y upwards as in the scene; each area tells its name and place when pointed at."""
    width, height = scene.plate.size
    scale = LENGTH / max(width, height)
    across, high = width * scale + 2 * MARGIN, height * scale + 2 * MARGIN
    svg = Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{across:.6g}",
            "height": f"{high:.6g}",
            "viewBox": f"0 0 {across:.6g} {high:.6g}",
            "role": "img",
        },
    )
    SubElement(svg, "title").text = f"Plan of the plate, {width:g} m × {height:g} m"

    def add(area: Area, words: str, looks: dict[str, str]) -> None:
        x0, x1, y0, y1 = area
        place = {
            "x": f"{MARGIN + x0 * scale:.6g}",
            "y": f"{MARGIN + (height - y1) * scale:.6g}",
            "width": f"{(x1 - x0) * scale:.6g}",
            "height": f"{(y1 - y0) * scale:.6g}",
        }
        rectangle = SubElement(svg, "rect", place | looks)
        SubElement(rectangle, "title").text = f"{words}: x {x0:g} … {x1:g} m, y {y0:g} … {y1:g} m"

    def add_target(key: str, target: Target) -> None:
        looks = {"fill": TARGET, "fill-opacity": "0.15", "stroke": TARGET, "stroke-width": "2"}
        words = f"target {target.name}" if isinstance(target, NamedTarget) else "target"
        if target.area is not None:
            return add(target.area, words, looks)
        ways = [
            " ".join(f"{MARGIN + x * scale:.6g},{MARGIN + (height - y) * scale:.6g}" for x, y in way.tolist())
            for way in target_outlines(scene, key, target)
        ]
        shape = SubElement(svg, "path", {"d": " ".join(f"M {way} Z" for way in ways), "fill-rule": "evenodd"} | looks)
        SubElement(shape, "title").text = f"{words}: {target.description}"

    add((0.0, width, 0.0, height), "plate", {"fill": "white"})
    for layer in scene.effects.layers:
        add(layer.area, "layer", {"fill": LAYER, "fill-opacity": "0.3"})
    for key, target in scene.targets_by_key.items():
        add_target(key, target)
    for oscillator in scene.effects.oscillators:
        add(oscillator.area, "oscillator", {"fill": "none", "stroke": OSCILLATOR, "stroke-width": "2"})
    for actuator in scene.actuators:
        add(actuator.area, f"actuator {actuator.name}", {"fill": INK, "fill-opacity": "0.55", "stroke": INK})
    _add_sides(svg, scene, width * scale, height * scale)
    return svg


def _add_sides(svg: Element, scene: Scene, width: float, height: float) -> None:
    """Lines around the plate, whose sides are given in pixels."""
    left, top, right, bottom = MARGIN, MARGIN, MARGIN + width, MARGIN + height
    ends = {
        "left": (left, bottom, left, top),
        "bottom": (left, bottom, right, bottom),
        "right": (right, bottom, right, top),
        "top": (left, top, right, top),
    }
    for name in NAMES:
        look = SIDES[edge_kind(getattr(scene.edges, name))]
        place = {key: f"{end:.6g}" for key, end in zip(("x1", "y1", "x2", "y2"), ends[name], strict=True)}
        dashes = " ".join(f"{look.width * length:.4g}" for length in look.dashes or ())
        looks = {"stroke": look.colour, "stroke-width": f"{look.width:g}"}
        line = SubElement(svg, "line", place | looks | ({"stroke-dasharray": dashes} if dashes else {}))
        SubElement(line, "title").text = f"{name} edge: {look.words}"
