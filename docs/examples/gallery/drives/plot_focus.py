"""
Bursts that meet
================

Twelve actuators along the rim send a burst, each with the delay and the phase that let all of them arrive at one
point together. There the displacement is larger than anywhere else.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

F, point = 2000.0, np.array([0.12, 0.09])  # [Hz], [m]
plate = wpl.Scene.load("paper").plate
speed = np.sqrt(2 * np.pi * F) * (plate.rigidity / (plate.density * plate.thickness)) ** 0.25  # of crests [m/s]
actuators = []
for angle in np.radians(np.arange(0, 360, 30)):
    x, y = 0.1 + 0.08 * np.array([np.cos(angle), np.sin(angle)])
    way = np.hypot(*(point - (x, y)))
    delay, phase = 2e-3 - way / (2 * speed), -2 * np.pi * F * way / speed  # bursts run at twice the speed of crests
    area = (x - 0.005, x + 0.005, y - 0.005, y + 0.005)
    actuators.append(wpl.Actuator(name=f"{np.degrees(angle):.0f}°", area=area, delay=delay, phase=phase))
scene = wpl.Scene.load("paper").with_tables(
    drive={"frequency": F, "burst": {"duration": 1.5e-3, "ramp": 7e-4}},
    actuators=actuators,
    grid={"nodes": (121, 121)},
    window={"start": 0.0, "end": 0.004},
    record={"times": tuple(np.arange(2.55e-3, 2.95e-3, 5e-5))},
    effects={},
)
field = 1e9 * abs(wpl.simulate(scene, estimate=False).main_case.displacement).max(axis=0)

figure, axis = plt.subplots(figsize=(5.6, 4.6), layout="constrained")
image = axis.imshow(field, origin="lower", extent=(0, 200, 0, 200), cmap="magma")
axis.set(xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(image, label="largest displacement (nm)")
