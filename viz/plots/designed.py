"""Plot of a designed panel beside the one that its design began with, and its solid for printers and mills."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.effects.effect import attachments
from warp_plate.plate.section import laminate_of
from warp_plate.result.atomic_io import write_atomically
from warp_plate.result.designed import DesignedPanel
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import GRID
from warp_plate.viz.availability import missing_plots
from warp_plate.viz.fields import colour_map
from warp_plate.viz.outlined import clip
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.plots.plan import draw_parts, drawn_size, label_sides, outline_handles

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

# Longer side of a plate, and height of the course of the search [inch].
LENGTH, COURSE = 3.4, 2.0
ALL, BEST = "#9ecae1", "#08519c"
# Names of the parts of a 3MF file.
PACKAGE, MODEL = "http://schemas.openxmlformats.org/package/2006", "http://schemas.microsoft.com/3dmanufacturing"
# Colour of layers and of what is attached.
ADDED = "#d8b365"


def draw_designed(panel: DesignedPanel, *paths: str | Path) -> None:
    """Draw both panels, with their maps of thickness, and the best value of each start."""
    from matplotlib.patches import Patch

    width, height = drawn_size(panel.scene, LENGTH)
    with figure(paths, (2 * width + 2.2, height + COURSE + 1.4), font_size=9) as fig:
        plans, course = fig.subfigures(2, 1, height_ratios=[height + 0.9, COURSE])
        axes = plans.subplots(1, 2, sharey=True, gridspec_kw={"wspace": 0.06})
        pairs = (panel.original, panel.original_thickness), (panel.scene, panel.thickness)
        values = [panel.before, panel.after]
        limits = _limits(panel)
        for one, (scene, thickness), value, when in zip(axes, pairs, values, ("before", "after"), strict=True):
            image = _draw_plan(one, scene, thickness, limits)
            one.set_title(f"{when}: bound {100 * value.bound:.2f} %", fontsize=9)
            label_sides(one, scene, left=one is axes[0])
        if image is not None:
            plans.colorbar(image, ax=list(axes), label="thickness [mm]", shrink=0.8)
        handles = outline_handles(panel.scene)
        if panel.scene.effects.regions:
            handles.append(Patch(color=ADDED, label="layer or oscillator"))
        plans.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=7)
        _draw_course(panel, course.subplots())
        fig.suptitle(panel.original.title or "Designed panel", fontsize=10, wrap=True)


def _limits(panel: DesignedPanel) -> tuple[float, float] | None:
    """Return the ends of the colours [mm]; None without a map."""
    if panel.thickness is None or panel.original_thickness is None:
        return None
    both = 1e3 * np.array([panel.thickness, panel.original_thickness])
    return float(both.min()), float(both.max())


def _draw_plan(
    axes: Axes, scene: Scene, thickness: np.ndarray | None, limits: tuple[float, float] | None
) -> AxesImage | None:
    image = None
    if thickness is not None and limits is not None:
        image = axes.imshow(
            1e3 * thickness, cmap=colour_map("cividis"), vmin=limits[0], vmax=max(limits[1], limits[0] + 1e-9),
            origin="lower", extent=scene.plate.box, interpolation="bilinear",
        )  # fmt: skip
        clip(image, axes, scene)
    for patch in (*scene.effects.layers, *(attachment.region for attachment in attachments(scene.terms))):
        axes.fill(*patch.closed_path().T, color=ADDED, linewidth=0, zorder=1)
    draw_parts(axes, scene)
    return image


def _draw_course(panel: DesignedPanel, axes: Axes) -> None:
    design = panel.original.design
    sign = -1 if design is not None and design.lowers else 1
    best = max(range(len(panel.history)), key=lambda index: sign * panel.history[index][-1], default=-1)
    for index, values in enumerate(panel.history):
        style = {"color": BEST, "linewidth": 1.6, "zorder": 3} if index == best else {"color": ALL, "linewidth": 0.9}
        label = "best start" if index == best else "others" if index == (best == 0) else None
        axes.plot(range(1, len(values) + 1), values, label=label, **style)
    axes.axhline(panel.before.value, color="black", linewidth=0.8, linestyle="--", label="scene before")
    axes.set_xlabel("iteration")
    axes.xaxis.get_major_locator().set_params(integer=True)
    label = "localization factor" if design is None or design.unit == "1" else design.label
    axes.set_ylabel(label.replace(" by ", "\nby ").replace(" [", "\n["))
    axes.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
    axes.figure.legend(loc="outside right center", fontsize=7)


def check_solid(scene: Scene) -> None:
    """Raise a SceneError unless panels that are designed from a scene can be saved as solids."""
    if missing := missing_plots():
        raise SceneError(f"--solid: {missing}")
    if not (scene.design and scene.design.thickness) and "thickness" not in laminate_of(scene).maps:
        raise SceneError("--solid: the scene has no map of thickness; write [design.thickness]")
    if scene.plate.outline is not None:
        raise SceneError("--solid: plate.outline: solids are those of rectangles; take the map, .thickness.csv")


def save_solid(panel: DesignedPanel, path: str | Path) -> None:
    """Save the panel as a solid between a flat face and one of the map's height, in millimetres, as .stl or .3mf."""
    import pyvista

    thickness = panel.thickness
    assert thickness is not None
    (width, height), (rows, columns) = panel.scene.plate.size, thickness.shape
    x, y = np.meshgrid(np.linspace(0, 1e3 * width, columns), np.linspace(0, 1e3 * height, rows))
    x, y = (np.repeat(places[:, :, None], 2, axis=2) for places in (x, y))
    z = np.stack([1e3 * thickness, np.zeros_like(thickness)], axis=2)  # in this order all triangles face outwards
    surface = pyvista.StructuredGrid(x, y, z).extract_surface(algorithm="dataset_surface").triangulate()
    content = _as_3mf if Path(path).suffix == ".3mf" else _as_stl
    write_atomically(content(surface.points, surface.faces.reshape(-1, 4)[:, 1:]), Path(path))


def _as_stl(points: np.ndarray, triangles: np.ndarray) -> bytes:
    """Return a mesh as a binary STL file."""
    facets = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = facets["corners"] = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes()


def _as_3mf(points: np.ndarray, triangles: np.ndarray) -> bytes:
    """Return a mesh, points (n, 3) in millimetres, as the single object of a file of the 3MF core specification."""
    vertices = "".join(f'<vertex x="{x:.6g}" y="{y:.6g}" z="{z:.6g}"/>' for x, y, z in points.tolist())
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles.tolist())
    mesh = f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"
    objects = f'<resources><object id="1" type="model">{mesh}</object></resources>'
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{PACKAGE}/content-types"><Default Extension="rels" ContentType="'
        'application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" ContentType="'
        'application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{PACKAGE}/relationships"><Relationship Id="model" '
        f'Target="/3D/model.model" Type="{MODEL}/2013/01/3dmodel"/></Relationships>',
        "3D/model.model": f'<model unit="millimeter" xmlns="{MODEL}/core/2015/02">{objects}'
        '<build><item objectid="1"/></build></model>',
    }
    with zipfile.ZipFile(content := io.BytesIO(), "w", zipfile.ZIP_DEFLATED) as file:
        for name, text in parts.items():
            entry = zipfile.ZipInfo(name)  # without the time, so that equal panels have equal files
            file.writestr(entry, f'<?xml version="1.0" encoding="UTF-8"?>{text}', zipfile.ZIP_DEFLATED)
    return content.getvalue()
