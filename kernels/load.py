"""Loads: the actuators' pressures become a few fields a plate, so that a step costs the same for any number of them.

    load(n) = Σ_t wave[n, t]·loads[t, plate]   with   loads[t, plate] = Σ_k coefficient[plate, t, k]·patch_k

One tone has two terms, cos ωt and sin ωt, with the coefficients Re Z and −Im Z. Where actuators are elsewhere on each
plate, their patches are made here too, of weights along x and along y, which are those of ``plate/weights.py``. A load
that moves has no such field; it is the product of a strength and of shares along y and x, new at each step.
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
def make_spread_moved_drives(real):
    """The same where each plate has its own patches, as ``weigh_along`` weighs them.

    along_x: (plates, actuators, nx), along_y: (plates, actuators, ny); share: (covered nodes,) what a pressure of one
    on the whole of a node's cell is worth there.
    """

    @wp.kernel(module="unique", enable_backward=False)
    def spread_moved_drives(
        coefficients: wp.array3d[real],
        support: wp.array2d[int],
        share: wp.array[wp.float64],
        along_x: wp.array3d[wp.float64],
        along_y: wp.array3d[wp.float64],
        loads: wp.array4d[real],
    ):
        plate, term, node = wp.tid()
        row = support[node, 0]
        column = support[node, 1]
        total = real(0.0)
        for actuator in range(along_x.shape[1]):
            # One row of zeros lies below the plate.
            weight = along_y[plate, actuator, row - 1] * along_x[plate, actuator, column] * share[node]
            total += real(weight) * coefficients[plate, term, actuator]
        loads[term, plate, row, column] = total

    return spread_moved_drives


@cache
def make_weigh_along(by_moments):
    """Weights of nodes along one axis for the span of each actuator on each plate; launch over (plates, actuators).

    By overlap, the covered part of each node's cell; ``by_moments``, the integral over the span of the node's Lagrange
    polynomial through four nodes. edges: (plates, actuators, 4) x0, x1, y0, y1 [m], of which the span is from ``first``
    on; positions: (nodes,) [m]; weights: (plates, actuators, nodes). to_weights: turns the moments 1, x, x², x³ about
    the middle of four nodes, in spacings, into their weights.
    """

    @wp.func
    def overlap(positions: wp.array[wp.float64], low: wp.float64, high: wp.float64, node: int):
        half = (positions[1] - positions[0]) / wp.float64(2.0)
        left = wp.max(positions[node] - half, wp.max(low, positions[0]))
        right = wp.min(positions[node] + half, wp.min(high, positions[positions.shape[0] - 1]))
        return wp.max(right - left, wp.float64(0.0)) / (wp.float64(2.0) * half)

    @wp.func
    def moments_between(start: wp.float64, stop: wp.float64):
        """∫ (1, x, x², x³) dx."""
        made = wp.vec4d()
        low = wp.float64(1.0)
        high = wp.float64(1.0)
        for power in range(4):
            low *= start
            high *= stop
            made[power] = (high - low) / wp.float64(power + 1)
        return made

    @wp.kernel(module="unique", enable_backward=False)
    def weigh_along(
        edges: wp.array3d[wp.float64],
        first: int,
        positions: wp.array[wp.float64],
        to_weights: wp.mat44d,
        weights: wp.array3d[wp.float64],
    ):
        plate, actuator = wp.tid()
        low = edges[plate, actuator, first]
        high = edges[plate, actuator, first + 1]
        nodes = positions.shape[0]
        if wp.static(by_moments):
            spacing = positions[1] - positions[0]
            last = wp.float64(nodes - 1)
            begin = wp.clamp((low - positions[0]) / spacing, wp.float64(0.0), last)
            end = wp.clamp((high - positions[0]) / spacing, wp.float64(0.0), last)
            for node in range(nodes):
                weights[plate, actuator, node] = wp.float64(0.0)
            for interval in range(int(begin), wp.min(int(wp.ceil(end)), nodes - 1)):
                # The four nodes whose cubic stands for this interval.
                node = wp.min(wp.max(interval - 1, 0), nodes - 4)
                middle = wp.float64(node) + wp.float64(1.5)
                left = wp.clamp(begin, wp.float64(interval), wp.float64(interval + 1)) - middle
                right = wp.clamp(end, wp.float64(interval), wp.float64(interval + 1)) - middle
                four = to_weights * moments_between(left, right)
                for place in range(4):
                    weights[plate, actuator, node + place] += four[place]
        else:
            for node in range(nodes):
                weights[plate, actuator, node] = overlap(positions, low, high, node)

    return weigh_along


@cache
def make_moving_load(real):
    """What a load that moves presses with at a node: its strength times the node's shares along y and x."""

    @wp.func
    def moving_load(strength: real, along_y: real, along_x: real):
        return strength * along_y * along_x

    return moving_load
