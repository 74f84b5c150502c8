"""
Edges on springs
================

A gasket is neither free nor a support. With soft springs under its edges the panel moves as a whole; with stiff ones
the frequencies reach those of a supported panel.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

SIDES = "left", "bottom", "right", "top"
panel = wpl.Scene.load("touch-panel").with_tables(effects={})
stiffness = np.logspace(3, 8, 21)  # [N/m²]

frequencies = []
for value in stiffness:
    springs = panel.with_tables(edges={side: {"translation": value} for side in SIDES})
    frequencies.append(wpl.modes(springs, count=4).frequencies[:4])
supported = wpl.modes(panel.with_tables(edges=dict.fromkeys(SIDES, "supported")), count=4).frequencies[:4]

figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
axis.loglog(stiffness, frequencies, label=[f"mode {number}" for number in range(1, 5)])
for frequency in supported:
    axis.axhline(frequency, color="grey", linestyle=":")
axis.set(xlabel="stiffness of the edges (N/m²)", ylabel="natural frequency (Hz)")
axis.annotate("supported", (stiffness[0], supported[-1]), color="grey", va="bottom")
axis.legend()
