"""
A stiffening rib
================

A strip of steel on a clamped glass panel adds stiffness and mass. The first mode bends it little, so that its mass
wins and the frequency falls; shorter waves along the strip bend it more, and their frequencies rise.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

panel = wpl.Scene.load("touch-panel").with_tables(effects={}, edges={})
rib = wpl.Effects(layers=[{"area": (0.0, 0.16, 0.045, 0.055), "thickness": 1e-3, "young_modulus": 2e11,
                           "density": 7850}])  # fmt: skip
x, y = np.linspace(0, 0.16, 97), np.linspace(0, 0.1, 61)

figure, axes = plt.subplots(2, 3, figsize=(9, 4.4), layout="constrained")
for row, (name, scene) in zip(axes, {"glass": panel, "with rib": panel.with_tables(effects=rib)}.items(), strict=True):
    plate = wpl.modes(scene, count=3)
    for axis, frequency, shape in zip(row, plate.frequencies, plate.shapes(x, y), strict=False):
        axis.contourf(1e3 * x, 1e3 * y, shape, 21, cmap="RdBu_r", vmin=-abs(shape).max(), vmax=abs(shape).max())
        axis.set(title=f"{name}: {frequency:.0f} Hz", aspect="equal")
figure.supxlabel("x (mm)")
figure.supylabel("y (mm)")
