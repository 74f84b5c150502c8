"""
Targets of any shape
====================

The best drive for a disc, a polygon and a rectangle on one panel with twelve actuators around its rim.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

along = (0.03, 0.077, 0.123, 0.17)
places = [(x, y) for x in along for y in along if {x, y} & {0.03, 0.17}]
panel = wpl.Scene.load("paper").with_tables(
    drive={"frequency": 150.0},
    grid={"accuracy": 0.01},
    actuators=[{"name": f"{x:g}, {y:g}", "area": (x - 0.006, x + 0.006, y - 0.006, y + 0.006)} for x, y in places],
)
targets = {
    "disc": {"disc": (0.07, 0.07, 0.04)},
    "polygon": {"polygon": [(0.1, 0.05), (0.17, 0.1), (0.1, 0.15), (0.05, 0.1)]},
    "strip": {"area": (0.02, 0.18, 0.14, 0.18)},
}
angle = np.linspace(0, 2 * np.pi, 100)

figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
for axis, (name, shape) in zip(axes, targets.items(), strict=True):
    result = wpl.localize(panel.with_tables(target=shape), spectrum=False, estimate=False)
    field = abs(result.main_case.displacement).max(axis=0)
    axis.imshow(field, origin="lower", extent=(0, 0.2, 0, 0.2), cmap="magma")
    corners = wpl.Target(**shape).corners(64)
    axis.fill(*corners.T, fill=False, edgecolor="white")
    axis.set(title=f"{name}: {100 * result.main_case.localization_factor:.0f} %", xticks=[], yticks=[])
