"""
A burst spreads
===============

One actuator sends a burst of a few periods into a panel at rest. Its short waves run ahead of the long ones; bending
waves are dispersive.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

scene = wpl.Scene.load("paper").with_tables(
    drive={"frequency": 2000.0, "burst": {"duration": 1.5e-3, "ramp": 7e-4}},
    actuators=[{"name": "left", "area": (0.04, 0.05, 0.095, 0.105)}],
    grid={"nodes": (101, 101), "order": 4, "load": "moments"},
    window={"start": 0.0, "end": 0.005},
    record={"times": (0.0008, 0.0012, 0.0016, 0.002)},
    effects={},
)
result = wpl.simulate(scene, estimate=False)

figure, axes = plt.subplots(1, 4, figsize=(11, 3), layout="constrained")
for axis, time, field in zip(axes, result.times, 1e9 * result.main_case.displacement, strict=True):
    axis.imshow(field, origin="lower", extent=(0, 200, 0, 200), cmap="RdBu_r", vmin=-4, vmax=4)
    axis.set(title=f"{1e3 * time:.1f} ms", xlabel="x (mm)")
axes[0].set(ylabel="y (mm)")
figure.colorbar(axes[-1].images[0], ax=axes, label="displacement (nm)")
