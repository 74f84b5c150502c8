"""SVG trees made plain: style sheets and what is not drawn removed, and refused what is drawn but cannot be read."""

import re
from itertools import count
from typing import Any
from xml.etree import ElementTree

# What the attributes that place, clip or hide shapes may hold, for what else they hold would be skipped in silence.
NUMBER, UNIT = r"(?>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)", "(?:px|mm|cm|in|pt|pc|Q)?"
NEXT = rf"(?:[\s,]*[+-]?{NUMBER})"
PLACES = ("x", "y", "cx", "cy", "x1", "y1", "x2", "y2")
GEOMETRY = {"d": r"\s*(?:[Mm][\s\d.,+\-MmZzLlHhVvCcSsQqTtAaEe]*)?", "points": r"[\s\d.,eE+-]*"}
GEOMETRY |= dict.fromkeys(PLACES, rf"\s*[+-]?{NUMBER}(?:{UNIT}|%)\s*")
GEOMETRY |= dict.fromkeys(("width", "height"), rf"\s*\+?{NUMBER}(?:{UNIT}|%)\s*")
# svgelements takes percentages of radii of the wrong side.
GEOMETRY |= dict.fromkeys(("r", "rx", "ry"), rf"\s*\+?{NUMBER}{UNIT}\s*")
ATTRIBUTES = GEOMETRY | {
    "transform": rf"(?:[\s,]*(?:matrix\s*\({NEXT}{{6}}|(?:translate|scale)\s*\({NEXT}{{1,2}}"
    rf"|rotate\s*\({NEXT}(?:{NEXT}{{2}})?|skew[XY]\s*\({NEXT})\s*\))*[\s,]*|none",
    "transform-origin": r"0(?:px)?(?:\s+0(?:px)?){1,2}",
    "transform-box": "view-box",
    "display": r"\s*(?!(?i:none))[a-zA-Z-]*\s*",
    "visibility": r"visible|hidden|collapse",
}
MOVING = ("translate", "rotate", "scale", "offset", "offset-path", "offset-position", "zoom")
ATTRIBUTES |= dict.fromkeys((*MOVING, "clip-path", "mask", "mask-image"), "none")
ATTRIBUTES |= dict.fromkeys(("requiredExtensions", "systemLanguage"), "")
SHAPES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")
# Elements that draw what they hold, and those that change it; others do so at most where they are referred to.
GROUPS = ("svg", "g", "a", "switch")
CHANGING = ("animate", "animateTransform", "animateMotion", "set")
# Selectors that are followed, bytes of a style sheet that are read in a second, characters of names in messages.
SELECTOR, MOST_STYLE, LONGEST_NAME = r"(?:\*|[\w-]+)|(?:\*|[\w-]+)?([.#])[\w-]+", 20_000, 60
COMMENT = r"/\*[\s\S]*?(?:\*/|\Z)"

Rules = dict[str, dict[str, tuple[int, int, str]]]


def make_plain(svg: Any, root: ElementTree.Element) -> None:
    """Turn what CSS says of geometry into attributes, and remove what is not drawn itself.

    Raises:
        ValueError: An element, or an attribute of one, is not read as it is written.
    """
    rules = _rules(root)
    for element in root.iter():
        _resolve(element, rules)
    for element in root.iter():
        tag = _tag(element)
        for child in list(element):
            kind, hidden = _tag(child), child.get("display", "").strip().lower() == "none"
            if hidden or kind not in (*SHAPES, *GROUPS, *CHANGING) or (kind == "path" and not child.get("d")):
                element.remove(child)
        name = f"{tag} {element.get('id', '')[:LONGEST_NAME]!r}" if element.get("id") else tag
        nested = tag == "svg" and element is not root
        if nested or tag in CHANGING or (tag == "switch" and len(element) > 1):
            raise ValueError(f"{'nested ' * nested}{name} is not read; save it as plain SVG")
        size = {"width", "height"} if element is root else set()
        # svgelements lets children inherit these.
        for key in GEOMETRY.keys() - size if tag in GROUPS else ():
            element.attrib.pop(key, None)
        for key, value in element.items():
            try:
                readable = key not in ATTRIBUTES.keys() - size or re.fullmatch(ATTRIBUTES[key], value) is not None
                if readable and key == "d":
                    svg.Path(value)
            except (ValueError, ArithmeticError, TypeError):
                readable = False
            if not readable:
                shown = " ".join(value[:LONGEST_NAME].split())
                raise ValueError(f"{name}: {key} = {shown!r} is not read; apply or remove it, and save as plain SVG")
        if tag == "rect":
            element.attrib = {"width": "0", "height": "0"} | element.attrib


def _tag(element: ElementTree.Element) -> str:
    """Return the name of an element of SVG; that of others has their namespace."""
    return element.tag.removeprefix("{http://www.w3.org/2000/svg}")


def _rules(root: ElementTree.Element) -> Rules:
    """Return rank, place and value of the properties among ``ATTRIBUTES`` in style sheets, by selectors."""
    rules: Rules = {}
    places = count()
    for sheet in (element for element in root.iter() if _tag(element) == "style"):
        text = sheet.text or ""
        if len(text) > MOST_STYLE:
            raise ValueError(f"a style sheet of {len(text)} bytes; at most {MOST_STYLE} are read")
        text = re.sub(COMMENT, " ", text)
        bad = re.search(r"@(?!font-face)[\w-]+", text)
        for rule in text.split("}") if bad is None else ():
            selectors, _, body = rule.partition("{")
            declared = _declared(body)
            for selector in map(str.strip, selectors.split(",") if declared else ()):
                kind = re.fullmatch(SELECTOR, selector)
                if kind is None or "{" in body or sheet.get("media", "all") not in ("all", "screen"):
                    bad = re.match(r"\s*([\s\S]*)", rule)
                    break
                rank, place = 2 * ("", ".", "#").index(kind[1] or "") + (selector[0] not in "*.#"), next(places)
                merged = rules.setdefault(selector.removeprefix("*") or "*", {})
                merged.update({key: (rank, place, value) for key, value in declared.items()})
        if bad is not None:
            shown = " ".join(bad[0][:LONGEST_NAME].split())
            raise ValueError(f"a style sheet holds {shown!r}, which is not read; save it as plain SVG")
    return rules


def _declared(body: str) -> dict[str, str]:
    """Return the properties among ``ATTRIBUTES`` that a style declares."""
    pairs = (part.partition(":") for part in re.split("[{;]", re.sub(COMMENT, " ", body)))
    return {key: value.strip() for name, _, value in pairs if (key := name.strip().lower()) in ATTRIBUTES}


def _resolve(element: ElementTree.Element, rules: Rules) -> None:
    """Write into the attributes of an element what its style and the style sheets say of them, the strongest last."""
    tag = _tag(element)
    marks = [f".{name}" for name in set(element.get("class", "").split())] + [f"#{element.get('id', '')}"]
    found = [rules.get(name, {}) for name in ("*", tag, *marks, *(tag + mark for mark in marks))]
    for _, key, value in sorted((given[:2], key, given[2]) for some in found for key, given in some.items()):
        element.set(key, value)
    element.attrib |= _declared(element.attrib.pop("style", ""))
