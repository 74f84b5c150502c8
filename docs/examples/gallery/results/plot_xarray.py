"""
Results as labelled arrays
==========================

A result turns into an xarray dataset: select by the names of cases, actuators and regions, with units in the
attributes.
"""

import matplotlib.pyplot as plt

import warp_plate as wpl

result = wpl.localize("paper", spectrum=False, estimate=False)
data = result.to_xarray()
drives = data[["magnitude", "phase"]].sel(case="best").to_pandas()

figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
drives["magnitude"].plot.bar(ax=axes[0], ylabel=f"magnitude ({data.magnitude.units})", rot=30)
drives["phase"].plot.bar(ax=axes[1], ylabel=f"phase ({data.phase.units})", rot=30)
