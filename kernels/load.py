"""Loads: the actuators' phasors become two fields a plate, so that a step costs the same for any number of them.

    load(t) = in_phase·cos ωt + quadrature·sin ωt,   in_phase − i·quadrature = Σ patch·Z
"""

from functools import cache

import warp as wp


@cache
def make_spread_drives(real):
    """Writes the load fields at the nodes that some actuator covers; all others hold zero already.

    drives: (plates, 2, actuators), Re Z and −Im Z; support: (covered nodes, 2), row and column;
    patches: (actuators, covered nodes).
    """

    @wp.kernel(module="unique", enable_backward=False)
    def spread_drives(
        drives: wp.array3d[real],
        support: wp.array2d[int],
        patches: wp.array2d[real],
        in_phase: wp.array3d[real],
        quadrature: wp.array3d[real],
    ):
        plate, node = wp.tid()
        cosine = real(0.0)
        sine = real(0.0)
        for actuator in range(patches.shape[0]):
            cosine += patches[actuator, node] * drives[plate, 0, actuator]
            sine += patches[actuator, node] * drives[plate, 1, actuator]
        row = support[node, 0]
        column = support[node, 1]
        in_phase[plate, row, column] = cosine
        quadrature[plate, row, column] = sine

    return spread_drives
