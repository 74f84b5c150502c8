"""
Young's modulus from natural frequencies
========================================

Four natural frequencies, measured within a percent, tell the modulus of the panel and its interval of 95 %.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl
from warp_plate.fitting.fit import fit_modes
from warp_plate.fitting.measured_modes import MeasuredModes

scene = wpl.Scene.load("paper", ["fit.free.plate.young_modulus=[5e8, 2e9]"])
measured = MeasuredModes("bench", np.array([21.5, 44.0, 44.3, 64.9]), np.full(4, np.nan))
found = fit_modes(scene, measured)
fitted = wpl.modes(found.scene, count=4).frequencies[:4]

figure, axis = plt.subplots(figsize=(6, 4.2), layout="constrained")
axis.plot(range(1, 5), measured.frequencies, "o", label="measured")
axis.plot(range(1, 5), fitted, "_", markersize=24, label="fitted")
axis.set(xlabel="mode", ylabel="natural frequency (Hz)", xticks=range(1, 5))
axis.set_title(f"E = {found.values[0] / 1e9:.3f} GPa, {found.low[0] / 1e9:.3f} to {found.high[0] / 1e9:.3f}")
axis.legend()
