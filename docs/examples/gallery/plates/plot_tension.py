"""
Tension
=======

In-plane tension raises all frequencies; compression lowers them, and the first reaches zero where the plate buckles.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

scene = wpl.Scene.load("paper").with_tables(effects={"tension": {"x": 0.0, "y": 0.0}})
found = wpl.sweep(scene, ["effects.tension.x=-25:100:26"], what="modes", count=5)

figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
axis.plot(found.plan.coordinates[0], found.values["frequency"])
axis.axvline(0, color="grey", linestyle=":")
axis.set(xlabel="tension along x (N/m)", ylabel="natural frequency (Hz)", ylim=(0, None))
