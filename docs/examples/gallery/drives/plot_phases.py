"""
In phase and in antiphase
=========================

Two actuators on one panel. In phase they drive the modes that are even along x, in antiphase the odd ones; with a
quarter of a period between them the pattern travels.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

panel = wpl.Scene.load("touch-panel")
scene = panel.with_tables(actuators=[panel.actuators[0], panel.actuators[2]], effects={"damping": {"viscous": 200.0}})
plate = wpl.modes(scene)
x, y = np.linspace(0, 0.16, 97), np.linspace(0, 0.1, 61)
per_pressure = plate.respond(np.array([400.0]), plate.actuator_forces())[0]

figure, axes = plt.subplots(1, 3, figsize=(11, 2.8), layout="constrained")
for axis, phase in zip(axes, (0, 90, 180), strict=True):
    phasors = 300.0 * np.exp([0, -1j * np.radians(phase)])  # [N/m²]
    field = 1e6 * abs(plate.displacement(per_pressure @ phasors, x, y))
    image = axis.pcolormesh(1e3 * x, 1e3 * y, field, cmap="magma")
    figure.colorbar(image, ax=axis, label="amplitude (µm)")
    axis.set(title=f"{phase}° between them", aspect="equal", xlabel="x (mm)")
axes[0].set(ylabel="y (mm)")
