"""
Waveforms that focus
====================

Waveforms of all actuators that move one point most at one moment, by time reversal and by the optimum of all
waveforms within the amplifier's limits, and the plate at that moment.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

panel = wpl.Scene.load("touch-panel")
scene = panel.with_tables(
    focus={"points": [(0.06, 0.06)], "highest": 6000.0, "time": 0.01, "rate": 24000, "peak": 100.0},
)
found = wpl.focus(scene)
width, height = (1e3 * side for side in panel.plate.size)
shown = {name: found.methods[name] for name in ("time_reversal", "optimum")}
largest = 1e6 * abs(shown["optimum"].fields).max()

figure, axes = plt.subplots(2, 2, figsize=(9, 5.4), layout="constrained")
for (left, right), (name, method) in zip(axes, shown.items(), strict=True):
    left.plot([1e3 * sample / 24000 for sample in range(method.waveforms.shape[-1])], method.waveforms[0].T)
    left.set(title=name.replace("_", " "), xlabel="time (ms)", ylabel="pressure (N/m²)")
    image = right.imshow(1e6 * method.fields[0], origin="lower", extent=(0, width, 0, height), cmap="RdBu_r",
                         vmin=-largest, vmax=largest)  # fmt: skip
    right.set(title=f"{1e6 * method.peak[0]:.1f} µm in the focus", xlabel="x (mm)", ylabel="y (mm)")
    figure.colorbar(image, ax=right, label="displacement (µm)")
