"""Loads: the actuators' pressures become a few fields a plate, so that a step costs the same for any number of them.

    load(n) = Σ_t wave[n, t]·loads[t, plate]   with   loads[t, plate] = Σ_k coefficient[plate, t, k]·patch_k

One tone has two terms, cos ωt and sin ωt, with the coefficients Re Z and −Im Z. A load that moves has no such field; it
is the product of a strength and of shares along y and x, new at each step.
"""

from functools import cache

import warp as wp


@cache
def make_spread_drives(real):
    """Writes the load fields at the nodes that some actuator covers; all others hold zero already.

    coefficients: (plates, terms, actuators); support: (covered nodes, 2), row and column; patches: (actuators, covered
    nodes); loads: (terms, plates, rows, columns). Launch over (plates, terms, covered nodes).
    """

    @wp.kernel(module="unique", enable_backward=False)
    def spread_drives(
        coefficients: wp.array3d[real],
        support: wp.array2d[int],
        patches: wp.array2d[real],
        loads: wp.array4d[real],
    ):
        plate, term, node = wp.tid()
        total = real(0.0)
        for actuator in range(patches.shape[0]):
            total += patches[actuator, node] * coefficients[plate, term, actuator]
        loads[term, plate, support[node, 0], support[node, 1]] = total

    return spread_drives


@cache
def make_moving_load(real):
    """What a load that moves presses with at a node: its strength times the node's shares along y and x."""

    @wp.func
    def moving_load(strength: real, along_y: real, along_x: real):
        return strength * along_y * along_x

    return moving_load
