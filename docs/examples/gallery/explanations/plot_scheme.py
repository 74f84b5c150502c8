"""
The scheme: staggered in time, thirteen nodes in space
======================================================

Displacements are defined at whole time steps and velocities at half ones; each advances the other. The biharmonic
operator at a node is the five-point Laplacian of the five-point Laplacian.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import convolve2d

laplacian = np.array([[0, 1, 0], [1, -4, 1], [0, 1, 0]])
stencil = convolve2d(laplacian, laplacian)

figure, (time, space) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", width_ratios=[1.5, 1])
for row, (colour, shift, name) in enumerate((("#08519c", 0, "displacement u"), ("#d95f02", 0.5, "velocity v"))):
    places = np.arange(4 - row) + shift
    time.plot(places, np.full(4 - row, row), "o", color=colour, markersize=13)
    time.text(-0.3, row, name, color=colour, ha="right", va="center")
    for place in places[:-1]:
        time.annotate("", (place + 0.88, row), (place + 0.12, row), arrowprops={"arrowstyle": "->", "color": colour})
for place in range(3):
    time.annotate("", (place + 0.46, 0.88), (place + 0.05, 0.12), arrowprops={"arrowstyle": "->", "color": "#08519c"})
    time.annotate("", (place + 0.95, 0.12), (place + 0.55, 0.88), arrowprops={"arrowstyle": "->", "color": "#d95f02"})
time.text(0.5, 1.35, "$v^+ = v - \\Delta t\\,(D\\nabla^4 u - f)/\\rho H$", ha="left", color="#d95f02")
time.text(0.5, -0.45, "$u^+ = u + \\Delta t\\,v^+$", ha="left", color="#08519c")
time.set(xlim=(-1.5, 3.3), ylim=(-0.7, 1.7), yticks=[], xticks=[0, 0.5, 1, 1.5, 2, 2.5, 3], xlabel="time / Δt")
time.spines[["left", "top", "right"]].set_visible(False)

for (y, x), weight in np.ndenumerate(stencil):
    if weight:
        space.plot(x, y, "o", color="#9ecae1" if weight > 0 else "#fdae6b", markersize=27)
        space.text(x, y, f"{weight}".replace("-", "−"), ha="center", va="center")
space.set(xlim=(-0.6, 4.6), ylim=(-0.6, 4.6), aspect="equal", title="$h^4\\nabla^4 u$ at the middle node")
space.axis("off")
