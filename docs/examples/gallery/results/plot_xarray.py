"""
Results as labelled arrays
==========================

Files open in xarray: select by the names of actuators and regions, with units in the attributes.
"""

import matplotlib.pyplot as plt
import xarray

import warp_plate as wpl

result = wpl.localize("paper", spectrum=False, estimate=False)
path = wpl.save_result(result, "paper.h5")
case = xarray.open_dataset(path, group="cases/best", engine="h5netcdf")
names = xarray.open_dataset(path, engine="h5netcdf")["actuator"]
drives = case[["magnitude", "phase"]].assign_coords(actuator=names).to_pandas()

figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
drives["magnitude"].plot.bar(ax=axes[0], ylabel=f"magnitude ({case.magnitude.units})", rot=30)
drives["phase"].plot.bar(ax=axes[1], ylabel=f"phase ({case.phase.units})", rot=30)
