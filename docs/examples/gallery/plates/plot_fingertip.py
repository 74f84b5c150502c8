"""
A fingertip on a touch panel
============================

A finger is a mass on a soft spring with a damper. It takes energy out of the panel, so the peaks of the response are
lower and wider than without it.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

touched = wpl.Scene.load("touch-panel")
alone = wpl.Scene.load("touch-panel", ["effects.oscillators=[]"])

figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
for name, scene in {"without finger": alone, "with finger": touched}.items():
    response = wpl.frf(scene, inputs=["lower left"], points=[(0.06, 0.04)], frequency_range=(50, 800))
    axis.semilogy(response.frequencies, abs(response.responses[0]), label=name)
axis.set(xlabel="frequency (Hz)", ylabel="mobility ((m/s)/N)")
axis.legend()
