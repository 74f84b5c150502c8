"""
Modulus and damping from a frequency response
=============================================

One accelerance with noise tells the modulus and the loss factor together. The measurement is made here, from a panel
whose numbers the fit does not know.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl
from warp_plate.fitting.fit import fit_responses
from warp_plate.fitting.measured_responses import MeasuredResponses

panel = wpl.Scene.load("paper").with_tables(
    effects={"loss_factor": {"eta": 0.02}},
    measurement=[{"actuator": "lower left", "point": (0.13, 0.08)}],
    fit={"free": {"plate.young_modulus": (8e8, 1.2e9), "effects.loss_factor.eta": (0.005, 0.1)}, "starts": 1},
)
true = panel.replace("plate.young_modulus", 1.1e9).replace("effects.loss_factor.eta", 0.03)
clean = wpl.frf(true, ["lower left"], [(0.13, 0.08)], (15, 120), "accelerance")
errors = np.random.default_rng(0).normal(0, 0.05, (2, len(clean.frequencies)))
measured = MeasuredResponses("bench", clean.frequencies, clean.responses * np.exp(errors[0] + 1j * errors[1]))
found = fit_responses(panel, measured)

figure, axis = plt.subplots(figsize=(8, 4.2), layout="constrained")
axis.semilogy(measured.frequencies, abs(measured.responses[0]), ".", markersize=3, label="measured")
axis.semilogy(measured.frequencies, abs(found.responses[0]), label="fitted")
axis.set(xlabel="frequency (Hz)", ylabel="accelerance ((m/s²)/N)")
axis.set_title(f"E = {found.values[0] / 1e9:.3f} GPa (true: 1.1), η = {found.values[1]:.4f} (true: 0.03)")
axis.legend()
