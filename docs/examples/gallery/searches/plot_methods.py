"""
Methods side by side
====================

What the best drive so far of four methods lacks to the bound at 290 Hz, from the places of the paper.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

paper = wpl.Scene.load("paper")
figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for method in ("pso", "constriction", "ring", "gradient"):
    scene = paper.with_tables(search={"method": method})
    result = wpl.localize(scene, evaluator="response", spectrum=False, estimate=False)
    axis.semilogy(result.history["evaluations"], result.bound - result.history["best"], label=method)
axis.set(xlabel="evaluations", ylabel="distance from the bound")
axis.legend()
