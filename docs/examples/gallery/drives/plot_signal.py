"""
A recorded signal as the drive
==============================

A WAV or CSV file beside the scene file can take the place of the tone. Here a click, written as CSV, drives all
actuators of a glass panel, which rings on after it.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

times = np.arange(0, 0.004, 5e-5)
click = np.exp(-(((times - 0.001) / 2e-4) ** 2))
with tempfile.TemporaryDirectory() as folder:
    np.savetxt(Path(folder) / "click.csv", np.column_stack([times, click]), delimiter=",")
    scene = wpl.Scene.load("touch-panel").with_tables(
        drive={"frequency": 2000.0, "signal": {"file": "click.csv"}},
        window={"start": 0.0, "end": 0.05},
        record={"points": [(0.05, 0.04)]},
    )
    result = wpl.simulate(scene.in_folder(Path(folder)), estimate=False)

figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
axis.plot(1e3 * result.trace_times, 1e6 * result.main_case.trace[0], label="displacement of a point")
axis.set(xlabel="time (ms)", ylabel="displacement (µm)")
other = axis.twinx()
other.plot(1e3 * times, click, "k:", label="click")
other.set(ylabel="drive")
figure.legend(loc="outside upper center", ncols=2)
