"""
Damping
=======

The peak of a resonance is proportional to 1/η, its width to η: the response between two peaks hardly changes.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

panel = wpl.Scene.load("touch-panel")

figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
for eta in (0.01, 0.03, 0.1):
    scene = panel.with_tables(effects={"loss_factor": {"eta": eta}})
    response = wpl.frf(scene, inputs=["lower left"], points=[(0.06, 0.04)], frequency_range=(50, 800))
    axis.semilogy(response.frequencies, abs(response.responses[0]), label=f"η = {eta:g}")
axis.set(xlabel="frequency (Hz)", ylabel="mobility ((m/s)/N)")
axis.legend()
