"""
Large amplitude
===============

A thin film pulls itself tight as it moves by more than its thickness. Near its resonance it then moves far less than
a linear plate, and the amplitude is no longer proportional to the drive.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

film = wpl.Scene.load("large-amplitude")
linear = film.with_tables(effects=film.effects.model_copy(update={"stretching": None}))
gains = np.array([0.01, 0.03, 0.1, 0.3, 1.0])
drives = gains[:, None] * [actuator.magnitude for actuator in film.actuators]

figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
for name, scene in {"linear": linear, "with stretching": film}.items():
    run = wpl.PlateSolver(scene).run(drives)
    peak = np.sqrt(2 * run.energy[:, 0]) / np.sqrt(2 * run.energy[0, 0]) * gains[0]
    axis.loglog(gains, peak, "o-", label=name)
axis.set(xlabel="drive / full drive", ylabel="RMS velocity / linear one at full drive")
axis.legend()
