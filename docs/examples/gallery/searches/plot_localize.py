"""
Move one quarter of a panel
===========================

The share of the plate's kinetic energy that lies in the target, the lower left quarter: with all actuators alike,
with the best single one, and with the best drive of all four.
"""

import warp_plate as wpl

# sphinx_gallery_thumbnail_number = 2

result = wpl.localize("paper")
wpl.plot(result, "quarter")
