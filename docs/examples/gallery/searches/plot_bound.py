"""
The bound over frequency
========================

In a linear plate the best localization factor at a frequency is an eigenvalue, so it is known exactly. Over frequency
it shows where a panel can be driven well before anything is searched.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

scene = wpl.Scene.load("paper")
response = wpl.frf(scene, frequency_range=(50, 600))

figure, axis = plt.subplots(figsize=(8, 4.2), layout="constrained")
axis.plot(response.frequencies, 100 * response.bound, label="bound of all drives of the four actuators")
axis.plot(response.frequencies, 100 * response.localization_factor, label="all four alike")
axis.axvline(scene.drive.frequency, color="grey", linestyle=":")
axis.set(xlabel="frequency (Hz)", ylabel="localization factor (%)", ylim=(0, 100))
axis.legend()
