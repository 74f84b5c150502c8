"""
Two engines
===========

Time stepping follows the plate from rest under any load; modes are sums of closed-form solutions, for linear scenes.
Both give the same motion of the paper's plate. Errors fall as a power of the nodes, or faster with the functions.
"""

import json
from pathlib import Path

import matplotlib.pyplot as plt

import warp_plate as wpl
from warp_plate.accuracy.reference_solution import solve_response

measured = Path(wpl.__file__).resolve().parents[1] / "benchmarks" / "results" / "accuracy-cpu.json"
rows = json.loads(measured.read_text())["rows"]
points = {"record": {"points": [(0.1, 0.1)]}, "window": {"start": 0.01, "end": 0.03}}
scene = wpl.Scene.load("paper").with_tables(**points, grid={"nodes": (27, 27), "order": 4, "load": "moments"})

figure, (motion, error) = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained", width_ratios=[1.5, 1])
for label, path, look in (("time steps", "auto", {"linewidth": 4, "color": "#fdae6b"}),
                          ("modes", "modal", {"linewidth": 1.2, "color": "#08519c"})):  # fmt: skip
    result = wpl.simulate(scene, device="cpu", path=path, estimate=False)
    motion.plot(1e3 * result.trace_times, 1e9 * result.main_case.trace[0], label=label, **look)
motion.set(xlabel="time [ms]", ylabel="displacement of the middle [nm]")
motion.legend(loc="lower left")
steps = {row["nodes"][0]: row["error"] for row in rows if row["load"] == "moments" and row["time_step"]}
solved = {density: solve_response(scene, density) for density in (0.4, 0.5, 0.6, 0.7, 1.1)}
*coarser, (_, exact) = solved.values()
functions = [round(len(plate.vectors) ** 0.5) for plate, _ in coarser]
error.loglog(*zip(*sorted(steps.items()), strict=True), "o-", color="#fdae6b", label="time steps, order 4")
error.loglog(functions, [abs(response.bound() / exact.bound() - 1) for _, response in coarser], "o-", color="#08519c",
             label="modes")  # fmt: skip
error.set(xlabel="nodes, or functions, along a side", ylabel="relative error of localization factors")
error.set_xticks([10, 20, 50, 100], [10, 20, 50, 100], minor=False)
error.set_xticks([], minor=True)
error.legend()
