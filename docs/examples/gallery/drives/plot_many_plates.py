"""
Thousands of plates at once
===========================

4096 random drives of the paper's plate, each on a plate of its own, all stepped in one batch. None of them passes the
bound that holds for all drives of these four places at this frequency.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

scene = wpl.Scene.load("paper")
solver = wpl.PlateSolver(scene)
random = np.random.default_rng(0)
phasors = random.normal(size=(4096, 4)) + 1j * random.normal(size=(4096, 4))
energy = solver.run(phasors).energy
target, plate = (energy[:, solver.regions.index(name)] for name in ("target", "plate"))
best = wpl.localize(scene.with_tables(search={"method": "exact"}), estimate=False)

figure, axis = plt.subplots(figsize=(7, 4.2), layout="constrained")
axis.hist(100 * target / plate, 80)
axis.axvline(100 * best.bound, color="black", linestyle="--", label=f"bound, {100 * best.bound:.2f} %")
axis.set(xlabel="localization factor (%)", ylabel="drives")
axis.legend()
