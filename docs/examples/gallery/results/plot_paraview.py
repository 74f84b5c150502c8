"""
Files for ParaView
==================

The recorded displacements as a VTKHDF file, which ParaView 5.12 opens as a time series; PyVista reads it too.
"""

import tempfile
from pathlib import Path

import pyvista

import warp_plate as wpl
from warp_plate.result.export import write_vtkhdf

result = wpl.simulate(wpl.Scene.load("composite-panel").with_tables(record={"times": (0.01, 0.02)}), estimate=False)
fields = {"displacement_drive": result.main_case.displacement}
with tempfile.TemporaryDirectory() as folder:
    (path,) = write_vtkhdf(result.scene, result.times, fields, Path(folder) / "composite.vtkhdf")
    grid = pyvista.read(path)

plotter = pyvista.Plotter(off_screen=True, window_size=(1000, 640))
grid["displacement (m)"] = grid["displacement_drive"]
surface = grid.warp_by_scalar("displacement (m)", factor=1e4)
plotter.add_mesh(
    surface,
    cmap="RdBu_r",
    scalars="displacement (m)",
    clim=[-2.5e-6, 2.5e-6],
    scalar_bar_args={"vertical": True, "position_x": 0.8},
)
plotter.screenshot("paraview.png")
