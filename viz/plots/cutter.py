"""Drawing of a designed panel for a cutter: outline, holes, ribs, what is attached, and contours of the thickness."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from warp_plate.effects.effect import attachments
from warp_plate.outline.dxf_files import Loop, dxf_of
from warp_plate.plate.section import bilinear
from warp_plate.result.atomic_io import write_atomically
from warp_plate.result.designed import DesignedPanel
from warp_plate.scene.errors import SceneError
from warp_plate.scene.target import PlateRegion
from warp_plate.viz.availability import missing_plots

# Most contours of a map of thickness, and points of these between two numbers of the map.
CONTOURS, FINER = 8, 8


def check_drawing() -> None:
    """Raise a SceneError unless drawings can be saved."""
    if missing := missing_plots():
        raise SceneError(f"--drawing: {missing}")
    try:
        dxf_of({})
    except ValueError as error:
        raise SceneError(f"--drawing: {error}") from None


def save_drawing(panel: DesignedPanel, path: str | Path) -> None:
    """Save the panel as a DXF file in millimetres of closed contours.

    Its layers are "outline", "holes", one for each table of layers with its thickness, "attached", "actuators", and for
    some thicknesses the boundary of where the plate is at least so thick.
    """
    scene, millimetres = panel.scene, 1e3
    whole = PlateRegion.model_construct(area=scene.plate.box).loop()
    outline, *holes = (whole,) if scene.outline is None else scene.outline.loops
    layers: dict[str, list[Loop]] = {"outline": [outline], "holes": list(holes)}
    for index, layer in enumerate(scene.effects.layers):
        layers[f"layers[{index}] {millimetres * layer.thickness:.4g} mm"] = [layer.loop()]
    layers["attached"] = [attachment.region.loop() for attachment in attachments(scene.terms)]
    layers["actuators"] = [actuator.loop() for actuator in scene.actuators]
    if panel.thickness is not None:
        for level in _levels(millimetres * panel.thickness):
            loops = list(_contours(panel.thickness, level / millimetres, scene.plate.size))
            layers[f"thickness {level:.6g} mm"] = loops
    write_atomically(dxf_of({name: loops for name, loops in layers.items() if loops}), Path(path))


def _levels(thickness: np.ndarray) -> list[float]:
    """Return round numbers between the least and the largest thickness [mm]."""
    from matplotlib.ticker import MaxNLocator

    low, high = float(thickness.min()), float(thickness.max())
    ticks = MaxNLocator(CONTOURS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high).tolist()
    return [tick for tick in ticks if low < tick < high]


def _contours(thickness: np.ndarray, level: float, size: tuple[float, float]) -> Iterator[np.ndarray]:
    """Yield the closed contours (corners, 2) x, y [m] of where a map (rows, columns) [m] is at least a level [m]."""
    import contourpy

    y, x = (np.linspace(0, 1, FINER * (count - 1) + 1) for count in thickness.shape)
    fine = bilinear(thickness, x, y)
    areas = contourpy.contour_generator(size[0] * x, size[1] * y, fine, fill_type="OuterOffset")
    for points, offsets in zip(*areas.filled(level, np.inf), strict=True):
        for start, end in pairwise(offsets):
            yield points[start : end - 1]  # the last corner is the first
