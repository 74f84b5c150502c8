"""
Grids converge, modes are there at once
=======================================

The localization factor of one actuator on finer and finer grids against the modal engine, which has no grid: fourth
order with moments is right on grids on which second order is ten times as far off.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

scene = wpl.Scene.load("paper").replace("actuators[0].magnitude", 1.0).with_tables(drive={"frequency": 150.0})
scene = scene.with_tables(actuators=scene.actuators[:1])
exact = wpl.simulate(scene, path="modal", estimate=False).main_case.localization_factor
nodes = (15, 21, 27, 37, 45)

figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
for label, grid in {"order 2, overlap": {"order": 2}, "order 4, moments": {"order": 4, "load": "moments"}}.items():
    errors = []
    for count in nodes:
        found = wpl.simulate(scene.with_tables(grid={"nodes": (count, count), **grid}), estimate=False)
        errors.append(100 * abs(found.main_case.localization_factor / exact - 1))
    axis.loglog(nodes, errors, "o-", label=label)
axis.set(xlabel="nodes a side", ylabel="error of the localization factor (%)", xticks=nodes, xticklabels=nodes)
axis.minorticks_off()
axis.legend()
