"""The figures that Jo, Yang and Shin (2024) published for the scene ``paper``, and how far they can be reproduced."""

from __future__ import annotations

# Section III: localization factors for equal drive, one actuator, and the drive that the swarm found.
PUBLISHED = {"equal": 0.25, "single": 0.6367, "best": 0.72}

NOT_REPRODUCED = (
    "The published 0.72 can't be reproduced: with this reading of the paper no drive at all passes the bound. "
    "The paper gives no damping; it is set here so that one actuator reaches the published 0.6367 on that grid; equal "
    "drives give 0.25 by symmetry. No reading of edges, loads and damping that was tried meets all three figures."
)
