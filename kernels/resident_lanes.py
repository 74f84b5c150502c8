"""Resident path on CUDA, second order, plates of at most 32 × 32 nodes: a warp owns a plate, a lane owns a column.

All numbers of a column stay in the lane's registers from the first step to the last, and neighbours' values come from
their lanes: no shared memory, no barrier, and no traffic but the loads at the start and the stores at the end. Rows are
walked upwards with the curvatures of three rows in hand; a row's displacement is overwritten as soon as the curvature
of the row above, the last to need it, is known.

Edges along x: the lane of an edge column holds zeros (its stiffness is zero), and its curvature is the sum of its two
neighbours. A clamped edge takes the inner lane for both, the mirror image; a supported edge takes itself.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.arithmetic import make_fused
from warp_plate.kernels.cuda import LANES, cuda_kernel, make_from_lane
from warp_plate.kernels.update import make_laplacian, make_parameters, make_state, make_update


def fits(nx, ny):
    """Return whether plates of this size can take the path."""
    return nx <= LANES and ny <= LANES


@cache
def make_run_steps(effects, real, ny, loaded, summed, registers=None):
    """Make the kernel of steps ``start`` … ``stop`` − 1, in the window if ``summed``; launch over (32 × plates,).

    Args:
        loaded: Bit j is set where row j + 1 of the plate has a loaded node; other rows take no registers for loads.
        registers: Most registers per thread; with many, the compiler orders a step for speed alone.
    """
    laplacian = make_laplacian(effects.square_cells, real)
    update = make_update(effects, real)
    from_lane, fused = make_from_lane(real), make_fused(real)
    Parameters, (Forcing, Fields) = make_parameters(real), make_state(real)
    moving = ny - 2
    Column = wp.types.vector(length=moving, dtype=real)

    @cuda_kernel(registers, max_unroll=LANES)
    def run_steps(
        # parameters
        p: Parameters,
        factor_x: wp.array[real],  # (nx,) factors on the curvature, 2 or 0 at the ends
        factor_y: wp.array[real],  # (ny,) the same times aspect
        start: int,
        stop: int,
        # inputs
        drive: Forcing,
        old: Fields,
        # outputs, which may be the inputs
        new: Fields,
    ):
        k = wp.tid() // LANES
        lane = wp.tid() % LANES
        nx = factor_x.shape[0]

        west = lane
        east = lane
        stiffness = real(0.0)
        if lane > 0 and lane < nx - 1:
            west = lane - 1
            east = lane + 1
            stiffness = p.stiffness
        elif lane == 0 and factor_x[0] > real(0.0):
            west = 1
            east = 1
        elif lane == nx - 1 and factor_x[nx - 1] > real(0.0):
            west = nx - 2
            east = nx - 2

        lane_u = Column()
        lane_rate = Column()
        cosine = Column()
        sine = Column()
        squared = Column()
        if lane < nx:
            for j in range(wp.static(moving)):
                lane_u[j] = old.u[k, j + 2, lane]
                lane_rate[j] = old.rate[k, j + 2, lane]
                if wp.static(loaded >> j & 1):
                    cosine[j] = drive.in_phase[k, j + 2, lane]
                    sine[j] = drive.quadrature[k, j + 2, lane]
                if wp.static(summed):
                    squared[j] = new.squares[k, j + 2, lane]

        bottom = factor_y[0]
        top = factor_y[wp.static(ny - 1)]
        plate_wave = drive.wave[k]
        next_cosine = plate_wave[start, 0]
        next_sine = plate_wave[start, 1]
        for n in range(start, stop):
            # Requested a step ahead, so that memory has time to answer.
            wave_cosine = next_cosine
            wave_sine = next_sine
            next_cosine = plate_wave[wp.min(n + 1, stop - 1), 0]
            next_sine = plate_wave[wp.min(n + 1, stop - 1), 1]
            below = fused(bottom, lane_u[0], real(0.0))
            here = laplacian(
                lane_u[0], from_lane(lane_u[0], west), from_lane(lane_u[0], east), real(0.0), lane_u[1], p.aspect
            )
            for j in range(wp.static(moving)):
                above = real(0.0)
                if wp.static(j == moving - 1):
                    above = fused(top, lane_u[j], real(0.0))
                elif wp.static(j == moving - 2):
                    above = laplacian(
                        lane_u[j + 1], from_lane(lane_u[j + 1], west), from_lane(lane_u[j + 1], east), lane_u[j],
                        real(0.0), p.aspect,
                    )
                else:
                    above = laplacian(
                        lane_u[j + 1], from_lane(lane_u[j + 1], west), from_lane(lane_u[j + 1], east), lane_u[j],
                        lane_u[j + 2], p.aspect,
                    )
                biharmonic = laplacian(here, from_lane(here, west), from_lane(here, east), below, above, p.aspect)
                load = real(0.0)
                if wp.static(loaded >> j & 1):
                    load = fused(wave_cosine, cosine[j], wave_sine * sine[j])
                stepped = update(lane_rate[j], biharmonic, load, stiffness, p)
                lane_rate[j] = stepped
                lane_u[j] = lane_u[j] + stepped
                if wp.static(summed):
                    squared[j] = squared[j] + stepped * stepped
                below = here
                here = above

        if lane < nx:
            for j in range(wp.static(moving)):
                new.u[k, j + 2, lane] = lane_u[j]
                new.rate[k, j + 2, lane] = lane_rate[j]
                if wp.static(summed):
                    new.squares[k, j + 2, lane] = squared[j]

    return run_steps
