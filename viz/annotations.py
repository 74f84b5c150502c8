"""Colours and line styles of the parts of a plate, captions, and camera, colour bar, legend and texts in 3-D."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_plate.outline.pieces import ellipse
from warp_plate.scene.errors import printable
from warp_plate.scene.model import Scene
from warp_plate.viz.fields import TALLEST, DrawingScale, colour_map

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
    from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D, vtkTextActor, vtkTextProperty

    from warp_plate.result.case import Case
    from warp_plate.result.model import Result
    from warp_plate.result.motion import Motion

INK, TARGET, GRID = "#1a1a1a", "#1b7837", "#8a8a8a"
LONGEST_NAME = 22  # characters of a name in a caption or legend
CASE_LABELS = {
    "equal": "equal drive",
    "single": "single actuator",
    "time_reversal": "time reversal",
    "inverse_filter": "inverse filter",
    "nominal": "optimised without scatter",
    "best": "best drive found",
    "drive": "given drive",
}
# Azimuth and elevation of the camera [°]: the viewer stands in front of the lower left corner.
AZIMUTH, ELEVATION = -127.5, 40.0
# Width of colour bar and legend, and height of a line of the legend [font sizes].
LEGEND_WIDTH, LINE_HEIGHT = 8.2, 1.35
# Labels are quarters of a limit of two digits, and so have at most four digits.
LABEL_FORMAT = "%.4g"
# Corners (x, y) [m].
Path = list[tuple[float, float]]


@dataclass(frozen=True)
class EdgeStyle:
    """Line style of one kind of edge."""

    colour: str  # #rrggbb
    width: float  # line width [pt]
    dashes: str  # Matplotlib line style of plots; lines in 3-D are solid
    label: str  # text of the legend

    @property
    def matplotlib(self) -> dict[str, Any]:
        """Keyword arguments of a Matplotlib line."""
        line = {"color": self.colour, "linewidth": self.width, "linestyle": self.dashes}
        return {**line, "solid_capstyle": "projecting"}


EDGE_STYLES = {
    "clamped": EdgeStyle(INK, 3.2, "-", "clamped"),
    "supported": EdgeStyle(INK, 1.2, "-", "supported"),
    "springs": EdgeStyle("#e6820e", 2.2, ":", "on springs"),
    "free": EdgeStyle(GRID, 1.2, "--", "free"),
    "support": EdgeStyle("#7b2d8b", 1.6, "-", "support"),
}
# Radius of the circle that stands for a support at a point, of the plate's longer side.
POINT_SUPPORT = 0.014


def edges_by_kind(scene: Scene) -> dict[str, list[Path]]:
    """Return the ends of the edges and supports of every kind in the scene, in the order of EDGE_STYLES."""
    (x0, y0), (x1, y1) = (0.0, 0.0), scene.plate.size
    ends = {"left": [(x0, y0), (x0, y1)], "bottom": [(x0, y0), (x1, y0)]}
    ends |= {"right": [(x1, y0), (x1, y1)], "top": [(x0, y1), (x1, y1)]}
    kinds: dict[str, list[Path]] = {kind: [] for kind in EDGE_STYLES}
    pieces = [] if scene.outline is None else scene.outline.pieces
    for piece in pieces:
        kinds[_kind(piece.condition)].append([(x, y) for x, y in piece.polyline().tolist()])
    for name, edge in () if pieces else scene.edges:
        kinds[_kind(edge)].append(ends[name])
    radius = POINT_SUPPORT * max(scene.plate.size)
    for support in scene.supports:
        circle = None if support.point is None else ellipse(support.point, (radius, radius), 0.0, "", "")
        if (piece := circle or support.piece("")) is not None:
            kinds["support"].append([(x, y) for x, y in piece.polyline().tolist()])
    return {kind: edges for kind, edges in kinds.items() if edges}


def _kind(edge: object) -> str:
    return edge if isinstance(edge, str) else "springs"


def length_unit(size: Sequence[float]) -> tuple[str, float]:
    """Return the unit for lengths of a plate of this size [m], mm if both sides are below a metre, and how many of it
    make a metre."""
    return ("mm", 1000.0) if max(size) < 1 else ("m", 1.0)


def size_text(size: Sequence[float]) -> str:
    """Return the lengths [m] of a plate's sides with their unit."""
    unit, factor = length_unit(size)
    return f"{' × '.join(f'{side * factor:.5g}' for side in size)} {unit}"


def point_text(point: Sequence[float], size: Sequence[float]) -> str:
    """Return a point (x, y) [m] of a plate of this size, without its unit."""
    return ", ".join(f"{at * length_unit(size)[1]:.5g}" for at in point)


def legend_entries(scene: Scene) -> list[tuple[str, str]]:
    """Return text and colour of every kind of outline."""
    edges = []
    for kind in edges_by_kind(scene):
        style = EDGE_STYLES[kind]
        sign = "○" if kind == "support" and only_points(scene) else "━━" if style.width > 2 else "──"
        edges.append((f"{sign} {style.label}", style.colour))
    return [("□ target", TARGET), ("□ actuator", INK), *edges]


def only_points(scene: Scene) -> bool:
    """Return true if all supports besides the edges are points, which are drawn as circles."""
    return all(support.point is not None for support in scene.supports)


def case_label(name: str, scene: Scene, actuator: str = "") -> str:
    """Return the label of a case of a result of this scene; of a single actuator with its name, if it is given."""
    from warp_plate.result.case import target_cases  # with h5py

    targets = {case: target for target, case in target_cases(scene.targets).items()}
    label = f"best drive for {targets[name]}" if name in targets else CASE_LABELS.get(name, name)
    return f"{label}, {shortened(actuator)}" if name == "single" and actuator else label


def shortened(name: str) -> str:
    """Return a name cut after LONGEST_NAME characters, with control characters escaped."""
    name = printable(name)
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def ordered_cases(result: Result) -> dict[str, Case]:
    """Return the cases in the order of the source paper, then those of further targets, then any others."""
    from warp_plate.result.case import target_cases

    names = dict.fromkeys([*CASE_LABELS, *target_cases(result.scene.targets).values(), *result.cases])
    return {name: result.cases[name] for name in names if name in result.cases}


def caption(
    label: str, time: float, localization_factor: float, decimals: int | None = None, frequency_text: str = ""
) -> str:
    """Return two lines: the drive and the time [s], rounded to ``decimals`` (default: to four digits); the localization
    factor and the text of :func:`at_frequency`."""
    moment = f"{time:.4g}" if decimals is None else f"{time:.{decimals}f}"
    return f"{label}, t = {moment} s\nlocalization factor {in_percent(localization_factor)}{frequency_text}"


def at_frequency(scene: Scene, frequency: float) -> str:
    """Return " at ... Hz" if a common frequency was searched, so that the cases of a result may differ in it."""
    searched = scene.search.frequency
    common = searched is not None and searched.actuators is None and not searched.own
    return f" at {frequency:.4g} Hz" if common else ""


def frame_caption(motion: Motion, frame: int, scene: Scene) -> str:
    """Return the caption of a plate at a frame: drive, time and localization factor, or the mode."""
    if motion.localization_factor is None:
        return motion.name
    # Enough decimals to tell one frame from the next.
    decimals = max(0, math.ceil(-math.log10((motion.span[1] - motion.span[0]) / len(motion.times))))
    label = case_label(motion.name, scene, motion.only_actuator)
    frequency_text = at_frequency(scene, motion.frequency)
    return caption(label, float(motion.times[frame]), motion.localization_factor, decimals, frequency_text)


def in_percent(share: float, decimals: int = 2) -> str:
    """Return a share in percent, or "not defined" for a plate at rest."""
    return f"{100 * share:.{decimals}f} %" if math.isfinite(share) else "not defined"


def look_at_plate(plotter: pyvista.Plotter, size: tuple[float, float], font_size: int, share: float = 1.0) -> None:
    """Point the camera of the active subplot at a plate, the same for every field on it.

    The plate of this size [m], with its largest heights and its axis labels, fills this share of the subplot's width,
    from the left, and its height below two lines of text of ``font_size`` [pixels].
    """
    pixels_wide, pixels_high = plotter.renderer.GetSize()
    azimuth, elevation = np.radians([AZIMUTH, ELEVATION])
    # Unit vectors of the picture: to its right, towards the viewer, and to its top.
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array([np.cos(elevation) * right[1], -np.cos(elevation) * right[0], np.sin(elevation)])
    up = np.cross(towards, right)
    tall = TALLEST * min(size)
    corners = np.array([(x, y, z) for x in (0, size[0]) for y in (0, size[1]) for z in (-tall, tall)])
    across, vertical = np.sort(corners @ right), corners @ up
    # What reaches farthest to the left or right: position [m], and pixels that are needed beyond it.
    margin = 0.02 * pixels_wide
    (text_x, at_x), (text_y, at_y) = axis_labels(size)
    lefts = [(across[0], margin), (at_y @ right, margin + 0.62 * font_size * len(text_y))]
    rights = [(across[-1], margin), (at_x @ right, margin + 0.62 * font_size * len(text_x))]
    width, height = share * pixels_wide, max(pixels_high * 0.96 - 3.4 * font_size, pixels_high / 4)
    wide = max((b - a) / (width - beyond_a - beyond_b) for a, beyond_a in lefts for b, beyond_b in rights)
    scale = max(np.ptp(vertical) / height, wide)  # metres per pixel
    first = max(beyond - position / scale for position, beyond in lefts)
    last = min(width - beyond - position / scale for position, beyond in rights)
    centre_right = scale * (pixels_wide - first - last) / 2
    centre_up = (vertical.max() + vertical.min()) / 2 + scale * 3.4 * font_size / 2
    focus, camera = centre_right * right + centre_up * up, plotter.camera
    camera.focal_point, camera.position, camera.up = tuple(focus), tuple(focus + 8 * max(size) * towards), (0, 0, 1)
    camera.parallel_projection, camera.parallel_scale = True, float(scale * pixels_high / 2)
    # The clipping range must hold for all heights to come, not only for the present ones.
    far = 2 * tall
    plotter.renderer.ResetCameraClippingRange(-far, size[0] + far, -far, size[1] + far, -far, far)


def axis_labels(size: tuple[float, float]) -> tuple[tuple[str, np.ndarray], tuple[str, np.ndarray]]:
    """Return name and length of x and y, and their positions [m] beside the two edges nearest to the viewer."""
    (width, height), away, (unit, factor) = size, 0.06 * min(size), length_unit(size)
    label_x = (f"x: 0 … {width * factor:.5g} {unit}", np.array([width / 2, -away, 0.0]))
    return label_x, (f"y: 0 … {height * factor:.5g} {unit}", np.array([-away, height / 2, 0.0]))


def name_actuators(
    plotter: pyvista.Plotter, scene: Scene, nodes: tuple[int, ...], font_size: int
) -> tuple[pyvista.PolyData, np.ndarray]:
    """Write the actuators' names in front of their patches, but for those that would overlap, in the active subplot;
    return their places, at rest, and the (actuators,) indices of the nodes (ny, nx) whose heights they follow."""
    import pyvista

    front = np.array([(actuator.box[0], actuator.box[2]) for actuator in scene.actuators]).reshape(-1, 2)
    columns, rows = np.rint(front / scene.plate.size * (np.array(nodes[::-1]) - 1)).astype(int).T
    places = pyvista.PolyData(np.column_stack([front, np.zeros(len(front))]))
    plotter.add_point_labels(
        places, [shortened(actuator.name) for actuator in scene.actuators],
        font_size=font_size, font_file=_font_file(), text_color=INK, bold=False, shape=None, show_points=False,
        always_visible=True, justification_horizontal="center", justification_vertical="top", reset_camera=False,
    )  # fmt: skip
    return places, rows * nodes[1] + columns


def free_width(plotter: pyvista.Plotter, font_size: int) -> float:
    """Return the share of the active subplot's width left of a legend."""
    return max(0.0, 1 - LEGEND_WIDTH * font_size / plotter.renderer.GetSize()[0])


def add_legend(plotter: pyvista.Plotter, scene: Scene, scale: DrawingScale, font_size: int) -> vtkScalarBarActor:
    """Add a colour bar, and below it the legend of the outlines, at the right of the active subplot."""
    # PyVista's own bar is shared by title over all subplots and widens their limits.
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

    left = free_width(plotter, font_size)
    entries = legend_entries(scene)
    line = LINE_HEIGHT * font_size / plotter.renderer.GetSize()[1]
    top = 0.03 + line * len(entries)
    for index, (text, colour) in enumerate(entries):
        add_text(plotter, text, (left, top - line * index), font_size, colour)
    bar = vtkScalarBarActor()
    bar.SetNumberOfLabels(5)
    bar.SetLabelFormat(f" {LABEL_FORMAT}")  # a space, for the bar's own padding moves labels off their ticks
    bar.SetMaximumNumberOfColors(256)
    bar.UnconstrainedFontSizeOn()
    bar.SetVerticalTitleSeparation(font_size // 2)
    bar.SetPosition(left, top + line)
    bar.SetPosition2(0.95 * (1 - left), 0.84 - top - line)
    for style in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty()):
        style_text(style, font_size)
    set_colour_bar(bar, scale)
    plotter.renderer.AddViewProp(bar)
    return bar


def set_colour_bar(bar: vtkScalarBarActor, scale: DrawingScale) -> None:
    """Show another scale."""
    bar.SetLookupTable(lookup_table(scale))
    bar.SetTitle(scale.title)


def lookup_table(scale: DrawingScale) -> pyvista.LookupTable:
    """Return the colours of a scale between its limits."""
    import pyvista

    return pyvista.LookupTable(cmap=colour_map(scale.cmap), scalar_range=scale.clim, nan_color=scale.field.nan_colour)


def add_text(
    plotter: pyvista.Plotter, text: str, position: Sequence[float], font_size: int, colour: str = INK
) -> vtkTextActor | vtkBillboardTextActor3D:
    """Add text with its upper left corner at shares of the active subplot's width and height, or at x, y, z [m]."""
    from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D, vtkTextActor

    actor = vtkBillboardTextActor3D() if len(position) == 3 else vtkTextActor()
    actor.SetInput(text)
    style_text(actor.GetTextProperty(), font_size, colour)
    actor.GetTextProperty().SetVerticalJustificationToTop()
    if len(position) == 2:
        actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.SetPosition(*position)
    plotter.renderer.AddViewProp(actor)
    return actor


def _font_file() -> str:
    """Return the path of Matplotlib's font, as VTK's own fonts lack many characters."""
    from matplotlib import get_data_path

    return f"{get_data_path()}/fonts/ttf/DejaVuSans.ttf"


def style_text(text: vtkTextProperty, font_size: int, colour: str = INK) -> None:
    """Set font, size [pixels] and colour."""
    import pyvista
    from vtkmodules.vtkCommonCore import VTK_FONT_FILE

    text.SetFontFamily(VTK_FONT_FILE)
    text.SetFontFile(_font_file())
    text.SetFontSize(font_size)
    text.SetColor(*pyvista.Color(colour).float_rgb)
    for switch_off in (text.BoldOff, text.ItalicOff, text.ShadowOff):
        switch_off()
    text.SetLineSpacing(1.2)
