"""
A plate that gets thinner
=========================

The thickness falls along x from the nominal one to 40 % of it. Waves become slower and shorter as they run into the
thin part, where they gather.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

even = wpl.Scene.load("paper").with_tables(drive={"frequency": 600.0})
wedge = even.with_tables(effects={"damping": {"viscous": 20.0}, "variation": {"thickness": [[1.0, 0.4]]}})
x, y = np.linspace(0, 0.2, 121), np.linspace(0, 0.2, 121)

figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for axis, (name, scene) in zip(axes, {"even": even, "thinner to the right": wedge}.items(), strict=True):
    plate = wpl.modes(scene)
    amplitudes = plate.respond(np.array([600.0]), plate.actuator_forces())[0].sum(axis=1)
    field = 1e6 * abs(plate.displacement(amplitudes, x, y))
    image = axis.pcolormesh(1e3 * x, 1e3 * y, field, cmap="magma")
    figure.colorbar(image, ax=axis, label="amplitude (µm)", shrink=0.8)
    axis.set(title=name, xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
