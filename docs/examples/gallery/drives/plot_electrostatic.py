"""
Electrostatic force
===================

An electrode pulls with the square of its voltage. Without a bias the plate moves at twice the frequency of the
voltage; with a large bias it follows the voltage itself.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

scene = wpl.Scene.load("paper").with_tables(
    record={"points": [(0.1, 0.1)]}, grid={"nodes": (41, 41)}, window={"start": 0.1, "end": 0.3}
)

figure, axis = plt.subplots(figsize=(7, 4.2), layout="constrained")
for bias in (0.0, 50.0):
    drive = {"frequency": 100.0, "electrostatic": {"bias": bias, "gain": 4.4e-4}}
    actuators = [{"name": "electrode", "area": (0.06, 0.14, 0.06, 0.14), "magnitude": 50.0}]
    result = wpl.simulate(scene.with_tables(drive=drive, actuators=actuators), estimate=False)
    late = result.trace_times > 0.1
    trace = result.main_case.trace[0][late]
    spectrum = 2 * abs(np.fft.rfft(trace - trace.mean())) / len(trace)
    frequency = np.fft.rfftfreq(len(trace), result.trace_times[1] - result.trace_times[0])
    axis.semilogy(frequency, 1e6 * spectrum, "o-", markersize=3, label=f"bias {bias:g} V, amplitude 50 V")
axis.set(xlabel="frequency (Hz)", ylabel="displacement of the middle (µm)", xlim=(0, 400), ylim=(1e-4, None))
axis.legend()
