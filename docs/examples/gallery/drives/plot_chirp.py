"""
A sweep through the resonances
==============================

The frequency of the drive rises from 15 Hz to 115 Hz in a second. A point of the plate answers at each resonance in
turn.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

scene = wpl.Scene.load("paper").with_tables(
    drive={"frequency": 15.0, "chirp": {"end_frequency": 115.0, "duration": 1.0}},
    grid={"nodes": (41, 41)},
    actuators=[{"name": "lower left", "area": (0.03, 0.042, 0.03, 0.042)}],
    window={"start": 0.0, "end": 1.0},
    record={"points": [(0.07, 0.06)]},
    effects={"damping": {"viscous": 12.0}},
)
result = wpl.simulate(scene, estimate=False)
resonances = [value for value in wpl.modes(scene).frequencies if value < 115]

figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
axis.plot(15 + 100 * result.trace_times, 1e6 * result.main_case.trace[0], linewidth=0.7)
axis.vlines(resonances, *axis.get_ylim(), color="grey", linestyle=":", label="natural frequencies")
axis.set(xlabel="frequency of the drive (Hz)", ylabel="displacement (µm)", xlim=(15, 115))
axis.legend()
