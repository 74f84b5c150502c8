"""
A panel on foam
===============

A bed of foam under the whole plate adds its stiffness k to every mode alike: ω² rises by k/ρH.
"""

import matplotlib.pyplot as plt
import numpy as np

import warp_plate as wpl

scene = wpl.Scene.load("paper").with_tables(effects={"foundation": {"stiffness": 1e3}})
found = wpl.sweep(scene, ["effects.foundation.stiffness=log:1e3:1e7:25"], what="modes", count=5)
stiffness = found.plan.coordinates[0]
of_bed = np.sqrt(stiffness / (scene.plate.density * scene.plate.thickness)) / (2 * np.pi)

figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
axis.loglog(stiffness, found.values["frequency"])
axis.loglog(stiffness, of_bed, "k:", label="rigid plate on the bed")
axis.set(xlabel="stiffness of the bed (N/m³)", ylabel="natural frequency (Hz)", ylim=(20, None))
axis.legend()
