"""
A moving load
=============

A force crosses the plate along x at 40 m/s. The plate's long waves are slower and its short ones faster, so that
ripples run ahead and a wake opens behind, like that of a boat.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

times = (0.001, 0.002, 0.003, 0.004)
scene = wpl.Scene.load("paper").with_tables(
    actuators=[{"name": "off", "area": (0.01, 0.02, 0.01, 0.02), "magnitude": 0.0}],
    effects={"moving_load": {"force": 0.01, "start": (0.0, 0.1), "velocity": (40.0, 0.0), "size": 0.01}},
    grid={"nodes": (81, 81)},
    window={"start": 0.0, "end": 0.005},
    record={"times": times},
)
result = wpl.simulate(scene)

figure, axes = plt.subplots(1, 4, figsize=(11, 3.2), layout="constrained")
fields = 1e6 * result.main_case.displacement
for axis, time, field in zip(axes, result.times, fields, strict=True):
    image = axis.imshow(field, origin="lower", extent=(0, 200, 0, 200), cmap="RdBu_r",
                        vmin=-abs(fields).max(), vmax=abs(fields).max())  # fmt: skip
    axis.plot(40e3 * time, 100, "k+", markersize=12)
    axis.set(title=f"{1e3 * time:.0f} ms", xlabel="x (mm)")
axes[0].set(ylabel="y (mm)")
figure.colorbar(image, ax=axes, label="displacement (µm)")
