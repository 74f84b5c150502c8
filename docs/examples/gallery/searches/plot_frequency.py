"""
The best frequency
==================

Where the frequency is free too, the search returns the localization factor that each frequency allows, and the best
of them.
"""

import warp_plate as wpl

# sphinx_gallery_thumbnail_number = 2

scene = wpl.Scene.load("paper").with_tables(
    grid={"accuracy": 0.01},
    search={"magnitude": {"range": (0.0, 2.0)}, "phase": {}, "frequency": {"range": (150.0, 450.0)},
            "particles": 10, "iterations": 20},
)  # fmt: skip
result = wpl.localize(scene, estimate=False)
wpl.plot(result, "frequency")
