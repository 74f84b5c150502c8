"""
Strong, or quiet elsewhere
==========================

The localization factor ignores how far the target moves. With the velocity as the objective and a limit for the rest
of the plate, one trades one for the other.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

paper = wpl.Scene.load("paper").with_tables(grid={"accuracy": 0.01})
limits = np.array([1e-5, 3e-5, 1e-4, 3e-4, 1e-3])  # [m/s]
reached = []
for limit in limits:
    search = {
        "method": "gradient",
        "objectives": [{"kind": "velocity", "rest_limit": limit}],
        "limits": {"magnitude": 1.0},
        "magnitude": {"range": (0.0, 1.0)},
        "phase": {},
    }
    result = wpl.localize(paper.with_tables(search=search), spectrum=False, estimate=False)
    reached.append(result.main_case.motion.velocity)

figure, axis = plt.subplots(figsize=(7, 4.2), layout="constrained")
axis.loglog(1e6 * limits, 1e6 * np.array(reached), "o-", label=["target", "rest"])
axis.set(xlabel="limit for the rest (µm/s)", ylabel="RMS velocity (µm/s)")
axis.legend()
