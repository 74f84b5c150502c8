"""
Carbon fibres
=============

Fibres along x make the composite panel stiff along x. Waves of one frequency are longer in that direction.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

composite = wpl.Scene.load("composite-panel")
isotropic = composite.with_tables(effects=composite.effects.model_copy(update={"orthotropic": None}))
width, height = composite.plate.size

figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for axis, (name, scene) in zip(axes, {"isotropic": isotropic, "fibres along x": composite}.items(), strict=True):
    result = wpl.simulate(scene, estimate=False)
    field = 1e6 * result.main_case.displacement[-1]
    image = axis.imshow(field, origin="lower", extent=(0, 1e3 * width, 0, 1e3 * height), cmap="RdBu_r",
                        vmin=-abs(field).max(), vmax=abs(field).max())  # fmt: skip
    figure.colorbar(image, ax=axis, label="displacement (µm)", shrink=0.7)
    axis.set(title=name, xlabel="x (mm)", ylabel="y (mm)")
