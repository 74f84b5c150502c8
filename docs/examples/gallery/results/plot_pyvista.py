"""
A surface in PyVista
====================

Displacements are NumPy arrays on the nodes of the grid, so that a few lines draw them with any library: here the best
drive as a surface in PyVista.
"""

import numpy as np
import pyvista

import warp_plate as wpl

result = wpl.localize("paper", spectrum=False, estimate=False)
field = result.main_case.displacement[0]  # (ny, nx) at the first recorded time
ny, nx = field.shape
width, height = result.scene.plate.size
x, y = np.meshgrid(np.linspace(0, width, nx), np.linspace(0, height, ny))

plotter = pyvista.Plotter(off_screen=True, window_size=(1000, 640))
surface = pyvista.StructuredGrid(x, y, 1e5 * field)
surface["displacement (nm)"] = 1e9 * field.ravel(order="F")
plotter.add_mesh(
    surface, cmap="RdBu_r", clim=[-300, 300], smooth_shading=True, scalar_bar_args={"vertical": True, "position_x": 0.8}
)
plotter.screenshot("surface.png")
