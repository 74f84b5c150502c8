"""
Plates of any outline
=====================

First modes of six glass plates. Edges: dashed free, thin supported, thick clamped, dotted sprung. Circles: supports.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl
from warp_plate.viz.outlined import clip, continued
from warp_plate.viz.plots.plan import draw_edges

corners = [(0.1 + 0.1 * np.cos(angle), 0.1 + 0.1 * np.sin(angle)) for angle in np.arange(6) * np.pi / 3]
bent = {"polygon": [(0, 0), (0.12, 0), (0.12, 0.04), (0.04, 0.04), (0.04, 0.12), (0, 0.12)], "corner_radius": 0.006}
bolts = [{"disc": (x, 0.02, 0.005), "edge": "clamped"} for x in (0.06, 0.1)]
legs = [(x, y) for x in (0.2, 0.8) for y in (0.2, 0.8)]
phone = {"outline": {"rectangle": (0.071, 0.147), "corner_radius": 0.012}, "holes": [{"disc": (0.018, 0.129, 0.007)}]}
plates = {  # outline and holes, edges, points that are held
    "phone": (phone, "supported", []),
    "table": ({"outline": {"disc": (0.5, 0.5, 0.5)}, "thickness": 0.01}, "free", legs),
    "bracket": ({"outline": bent, "holes": [*bolts, {"disc": (0.02, 0.1, 0.008)}]}, "free", []),
    "hexagon": ({"outline": {"polygon": corners}}, "free", corners[::2]),
}
glass = {"thickness": 1e-3, "young_modulus": 7.2e10, "poisson_ratio": 0.22, "density": 2450.0}
scenes, everywhere = {name: wpl.Scene.load(name) for name in ("watch", "trackpad")}, {"disc": (0.5, 0.5, 0.7)}
for name, (plate, edge, points) in plates.items():
    tables = {"plate": glass | plate, "edges": {"outline": edge}, "supports": [{"point": point} for point in points]}
    scenes[name] = scenes["watch"].with_tables(**tables, target=everywhere, actuators=[{"name": "A", **everywhere}])

figure, axes = plt.subplots(2, 3, figsize=(8, 5.6), layout="constrained")
for axis, (name, scene) in zip(axes.flat, scenes.items(), strict=True):
    x, y = (np.linspace(0, side, 121) for side in scene.plate.size)
    modes = wpl.modes(scene, count=4)
    shape = continued(scene, modes.shapes(x, y)[0])
    clip(axis.contourf(x, y, shape / abs(shape).max(), np.linspace(-1, 1, 22), cmap="RdBu_r"), axis, scene)
    draw_edges(axis, scene)
    axis.set_title(f"{name}: {modes.frequencies[0]:.0f} Hz")
