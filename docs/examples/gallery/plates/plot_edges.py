"""
Clamped, supported and free edges
=================================

The same panel, held in four ways. What holds the edges sets the lowest frequency more than anything else.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

panel = wpl.Scene.load("touch-panel").with_tables(effects={})
held = {
    "clamped": wpl.Edges(),
    "supported": wpl.Edges(left="supported", right="supported", bottom="supported", top="supported"),
    "clamped left, else free": wpl.Edges(right="free", bottom="free", top="free"),
    "free": wpl.Edges(left="free", right="free", bottom="free", top="free"),
}
x, y = np.linspace(0, 0.16, 97), np.linspace(0, 0.1, 61)

figure, axes = plt.subplots(2, 2, figsize=(8, 5.6), layout="constrained")
for axis, (name, edges) in zip(axes.flat, held.items(), strict=True):
    plate = wpl.modes(panel.with_tables(edges=edges), count=6)
    lowest = np.argmax(plate.frequencies > 0)  # a free panel has three rigid motions of 0 Hz
    shape = plate.shapes(x, y)[lowest]
    axis.contourf(1e3 * x, 1e3 * y, shape, 21, cmap="RdBu_r", vmin=-abs(shape).max(), vmax=abs(shape).max())
    axis.set(title=f"{name}: {plate.frequencies[lowest]:.0f} Hz", aspect="equal")
figure.supxlabel("x (mm)")
figure.supylabel("y (mm)")
