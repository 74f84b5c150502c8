"""
Confinement by ribs
===================

Between ribs at a distance b that support it, a pane carries no bending waves below (π/b)² √(D/ρH) / 2π (dotted): it
moves where it is driven, and less 30 mm farther, along the ribs or across one. Without ribs all of it moves.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

WIDTH, SIDE, MIDDLE = 0.03, 0.15, 0.075  # m
glass = wpl.Plate(size=(SIDE, SIDE), thickness=1e-3, young_modulus=7e10, poisson_ratio=0.22, density=2500)
pane = wpl.Scene(
    plate=glass, edges=dict.fromkeys(("left", "right", "bottom", "top"), "supported"), drive=wpl.Drive(frequency=1000),
    effects=wpl.Effects(loss_factor={"eta": 0.02}), target=wpl.Target(disc=(MIDDLE, MIDDLE, 0.01)),
    actuators=[wpl.Actuator(name="disc", disc=(MIDDLE, MIDDLE, 0.006))],
)  # fmt: skip
ribs = [{"line": ((WIDTH * index, 0.0), (WIDTH * index, SIDE))} for index in range(1, 5)]
places = {"at the actuator": (MIDDLE, MIDDLE), "30 mm along": (MIDDLE, MIDDLE + WIDTH)}
places |= {"30 mm across": (MIDDLE + WIDTH, MIDDLE)}
rigidity = glass.young_modulus * glass.thickness**3 / 12 / (1 - glass.poisson_ratio**2)
cut_off = np.pi / 2 / WIDTH**2 * np.sqrt(rigidity / glass.density / glass.thickness)

figure, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True, layout="constrained")
scenes = {"without ribs": pane, "with ribs": pane.with_tables(supports=ribs)}
for axis, (name, scene) in zip(axes, scenes.items(), strict=True):
    response = wpl.frf(scene, points=list(places.values()), frequency_range=(100, 5000), quantity="receptance")
    for place, values, style in zip(places, response.responses, ("-", "-", "--"), strict=True):
        axis.loglog(response.frequencies, 1e6 * abs(values), style, label=place)
    axis.axvline(cut_off, color="grey", linestyle=":")
    axis.set(title=name, xlabel="frequency (Hz)")
axes[0].set_ylabel("displacement per force (µm/N)")
axes[0].legend()
