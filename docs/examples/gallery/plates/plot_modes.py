"""
Modes of a plate
================

The six lowest modes of a plate that is clamped along its edges. Two of them come in pairs: on a square, turning a
mode by a right angle gives another one of the same frequency.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

scene = wpl.Scene.load("paper")
plate = wpl.modes(scene, count=6)
x, y = np.linspace(0, 0.2, 81), np.linspace(0, 0.2, 81)
shapes = plate.shapes(x, y)

figure, axes = plt.subplots(2, 3, figsize=(8, 5.4), layout="constrained")
for axis, frequency, shape in zip(axes.flat, plate.frequencies, shapes, strict=False):
    axis.contourf(1e3 * x, 1e3 * y, shape, 21, cmap="RdBu_r", vmin=-abs(shape).max(), vmax=abs(shape).max())
    axis.contour(1e3 * x[2:-2], 1e3 * y[2:-2], shape[2:-2, 2:-2], [0], colors="black")
    axis.set(title=f"{frequency:.1f} Hz", aspect="equal", xticks=[0, 200], yticks=[0, 200])
figure.supxlabel("x (mm)")
figure.supylabel("y (mm)")
