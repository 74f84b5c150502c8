"""
Error bars hold
===============

Each of 501 random linear scenes was simulated with its error bar, and computed again by finite elements that share no
code with the program. Below the line the bar holds; the few points above it are within the error of the finite
elements.
"""

import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

measured = Path(wpl.__file__).resolve().parents[1] / "benchmarks" / "results" / "error-bars-cpu.json"
rows = [row for row in json.loads(measured.read_text()) if row.get("bar")]

figure, axis = plt.subplots(figsize=(6.4, 5), layout="constrained")
for engine, label, colour in (("steps", "time steps", "#d95f02"), ("modes", "modes", "#08519c")):
    chosen = [row for row in rows if row["engine"] == engine]
    found, truth, bars, judge = np.array([[row[key] for key in ("found", "truth", "bar", "judge")] for row in chosen]).T
    errors = abs(found - truth)
    holds = np.count_nonzero(errors <= bars + judge * truth)
    axis.loglog(bars, errors, ".", color=colour, alpha=0.6, label=f"{label}: {holds} of {len(chosen)} hold")
ends = np.array([1e-9, 1])
axis.loglog(ends, ends, color="black", linewidth=1, label="error = bar")
axis.set(
    xlabel="printed error bar of the localization factor",
    ylabel="difference from finite elements",
    xlim=ends,
    ylim=ends,
)
axis.legend()
