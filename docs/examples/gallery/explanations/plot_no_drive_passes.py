"""
No drive passes the bound
=========================

Localization factors of 100,000 random drives at 290 Hz from the paper's four places. All lie below the bound, the
largest eigenvalue of a pair of Gram matrices, which one drive attains.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl
from warp_plate.solve.response import measure_response

scene = wpl.Scene.load("paper")
response = measure_response(wpl.PlateSolver(scene.in_float64(), "cpu"))
random = np.random.default_rng(1)
drives = random.normal(size=(100_000, 4)) + 1j * random.normal(size=(100_000, 4))
factors = 100 * response.localization_factors(drives)
alone, equal = response.localization_factors(np.eye(4)), response.localization_factors(np.ones((1, 4)))

figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
axis.hist(factors, 80, color="#9ecae1", label="random drives")
lines = {"all alike": (equal[0], "grey"), "best single actuator": (alone.max(), "#d95f02")}
lines |= {"best random drive": (factors.max() / 100, "#08519c"), "bound": (response.bound(), "#b2182b")}
for name, (value, colour) in lines.items():
    axis.axvline(100 * value, color=colour, label=f"{name}: {100 * value:.2f} %")
axis.set(xlabel="localization factor [%]", ylabel="number of drives", xlim=(0, 75))
axis.legend(loc="upper center", bbox_to_anchor=(0.59, 1.0))
