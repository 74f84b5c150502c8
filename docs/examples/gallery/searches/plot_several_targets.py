"""
Several targets and their crosstalk
===================================

One search for each of three targets of a panel, and how much each drive moves the other two.
"""

import warp_plate as wpl

scene = wpl.Scene.load("paper").with_tables(
    target={"area": (0.0, 0.08, 0.0, 0.2)},
    targets=[
        {"name": "left", "area": (0.0, 0.08, 0.0, 0.2)},
        {"name": "middle", "disc": (0.12, 0.1, 0.03)},
        {"name": "right", "area": (0.16, 0.2, 0.0, 0.2)},
    ],
)
result = wpl.localize(scene, spectrum=False, estimate=False)
wpl.plot(result, "targets")
