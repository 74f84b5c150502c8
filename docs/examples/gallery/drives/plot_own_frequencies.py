"""
Two frequencies
===============

Each actuator may have a frequency of its own. Two that differ by 10 Hz make the plate beat ten times a second.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

paper = wpl.Scene.load("paper")
first, second, *_ = paper.actuators
scene = paper.with_tables(
    actuators=[first, second.model_copy(update={"frequency": 300.0})],
    record={"points": [(0.1, 0.1)]},
    window={"start": 0.1, "end": 0.4},
)
result = wpl.simulate(scene, path="modal", estimate=False)

figure, axis = plt.subplots(figsize=(8, 3.6), layout="constrained")
axis.plot(1e3 * result.trace_times, 1e9 * result.main_case.trace[0], linewidth=0.8)
axis.set(xlabel="time (ms)", ylabel="displacement of the middle (nm)", xlim=(0, 400))
