"""
Frequency responses
===================

Mobility from each actuator to the middle of the target, the localization factor, and the mean square velocity of the
plate, at frequencies that follow every resonance.
"""

import warp_plate as wpl

response = wpl.frf("touch-panel", frequency_range=(100, 1000))
wpl.plot(response, "touch-panel-frf")
