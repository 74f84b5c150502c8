"""
A map over two keys
===================

The best localization factor over the frequency and the thickness of the plate: one sweep, a point for each scene.
"""

import warp_plate as wpl

scene = wpl.Scene.load("paper").with_tables(search={})
found = wpl.sweep(scene, ["drive.frequency=150:400:9", "plate.thickness=4e-4:8e-4:5"])
wpl.plot(found, "map")
