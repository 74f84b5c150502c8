"""
Step by step
============

A solver can be stepped by hand and looked at on the way: here, the motion of two plates as it builds up from rest.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

solver = wpl.PlateSolver(wpl.Scene.load("paper"))
solver.setup([[1, 0, 0, 0], [1, 1, 1, 1]])
times, middles = [], []
while solver.time < 0.05:
    solver.step(2)
    times.append(solver.time)
    middles.append(solver.displacement[:, 13, 13])

figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
axis.plot(1e3 * np.array(times), 1e9 * np.array(middles), label=["one actuator", "all four"])
axis.set(xlabel="time (ms)", ylabel="displacement of the middle (nm)")
axis.legend()
