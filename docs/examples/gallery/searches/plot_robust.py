"""
A drive for panels that differ
==============================

Real panels differ from the drawing, and a finger is there or not. A drive that is best for the nominal panel loses on
others; one that is searched over many panels at once loses less.
"""

import warp_plate as wpl

# sphinx_gallery_thumbnail_number = 2
scene = wpl.Scene.load("touch-panel").with_tables(
    drive={"frequency": 600.0},
    grid={"nodes": (25, 16)},
    target={"area": (0.08, 0.16, 0.0, 0.05)},
    search={
        "method": "gradient",
        "particles": 4,
        "iterations": 20,
        "robust": {"scenarios": 8, "fresh": 40, "young_modulus": 0.05, "thickness": 0.03, "without_oscillators": 0.5},
    },
)
result = wpl.localize(scene, spectrum=False, estimate=False)
wpl.plot(result, "robust")
