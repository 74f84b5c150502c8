"""
Methods side by side
====================

Every method from three seeds, with the same number of evaluations. Dashed: the bound of these searches, at 290 Hz
from the paper's four places.
"""

import warp_plate as wpl

compared = wpl.compare("paper", methods=["pso", "constriction", "gradient", "exact"], seeds=3)
wpl.plot(compared, "methods")
