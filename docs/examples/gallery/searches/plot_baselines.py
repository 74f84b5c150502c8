"""
Drives that need no search
==========================

Time reversal and the inverse filter are the classic ways to focus waves. On the paper's plate both stay behind the
best drive for the localization factor.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

result = wpl.localize("paper", baselines=True, spectrum=False, estimate=False)
factors = {name: 100 * case.localization_factor for name, case in result.cases.items()}

figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
bars = axis.barh(list(factors), list(factors.values()))
axis.bar_label(bars, fmt="%.1f %%", padding=3)
axis.axvline(100 * result.bound, color="black", linestyle="--", label="bound")
axis.set(xlabel="localization factor (%)", xlim=(0, 100))
axis.legend()
