"""
Where the thin-plate theory ends
================================

In Kirchhoff-Love theory, sections stay straight and normal to the surface. The thicker a plate is relative to its
waves, the more it shears, and the faster the theory's waves are compared with the exact ones of Rayleigh and Lamb.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq

import warp_plate as wpl

POISSON = 0.3
ratios = np.geomspace(0.005, 0.5, 60)  # thickness over wavelength; speeds are over that of shear waves
slow = (1 - 2 * POISSON) / (2 - 2 * POISSON)  # squared speeds of shear over pressure waves


def mismatch(speed, half):
    p, q = np.sqrt(1 - slow * speed**2), np.sqrt(1 - speed**2)
    return 4 * p * q * np.tanh(q * half) - (1 + q**2) ** 2 * np.tanh(p * half)


exact = np.array([brentq(mismatch, 0.9 * ratio, 0.99, args=(np.pi * ratio,)) for ratio in ratios])
thin = 2 * np.pi * ratios * np.sqrt(2 * (1 + POISSON) / 12 / (1 - POISSON**2))

figure, axis = plt.subplots(figsize=(7, 4.2), layout="constrained")
axis.loglog(ratios, 100 * (thin / exact - 1), color="#08519c", label="speed of bending waves")
for name, frequency in {"paper": 290, "touch-panel": 1000, "focusing-glass": 45000}.items():
    plate = wpl.Scene.load(name).plate
    stiffness = plate.young_modulus * plate.thickness**3 / 12 / (1 - plate.poisson_ratio**2)
    wave = 2 * np.pi * (stiffness / plate.density / plate.thickness / (2 * np.pi * frequency) ** 2) ** 0.25
    at = plate.thickness / wave
    axis.plot(at, 100 * np.interp(at, ratios, thin / exact - 1), "o", label=f"{name} at {frequency:g} Hz")
axis.axhline(1, color="grey", linestyle=":", label="1 %")
axis.set(xlabel="thickness / wavelength", ylabel="error of thin-plate theory [%]", xlim=(0.005, 0.5))
axis.legend()
