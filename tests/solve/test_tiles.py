"""Tiles of large plates on CUDA: cuts, what a tile's own edges spoil, and plans; and the same bits as other paths."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from support.oracle import check_same
from support.scenes import EDGE_MIXES
from warp_plate import PlateSolver
from warp_plate.kernels.plans import cut, make_place
from warp_plate.plate.operator import biharmonic, make_taps
from warp_plate.solve.cuda import plan_tiles

CUTS = [(33, 5, 4), (97, 40, 16), (40, 2, 16), (9, 30, 8)]
SIDES = [(sides[0], sides[1]) for sides in EDGE_MIXES[:4]]


def places(axis):
    """Return (tiles, 3) start, first and end of each tile, as a kernel gets them."""
    place = make_place(axis)

    @wp.kernel(module="unique", enable_backward=False)
    def write_places(found: wp.array2d[int]):
        tile = wp.tid()
        start, first, end = place(tile)
        found[tile, 0] = start
        found[tile, 1] = first
        found[tile, 2] = end

    found = wp.zeros((axis.count, 3), dtype=int, device="cpu")
    wp.launch(write_places, axis.count, outputs=[found], device="cpu")
    return found.numpy().tolist()


@pytest.mark.parametrize(("nodes", "count", "margin"), CUTS)
def test_each_node_is_written_by_one_tile(nodes, count, margin):
    axis, written = cut(nodes, count, margin), np.zeros(nodes, int)
    for start, first, end in places(axis):
        written[start + first : start + end] += 1
        assert 0 <= start <= nodes - axis.length
        assert start + first == 0 or first > margin
        assert start + end == nodes or end <= axis.length - 1 - margin or first >= end
    assert (written == 1).all()


@pytest.mark.parametrize(("order", "steps"), [(2, 3), (4, 2)])
@pytest.mark.parametrize("sides", SIDES)
def test_a_tile_is_right_beyond_its_margin(order, steps, sides, random):
    """Steps of tiles as plates of their own, held at all edges, beside steps of the whole plate."""
    nodes, stiffness = (41, 33), {2: 0.05, 4: 0.03}[order]
    axes = [cut(count, 2, order * steps) for count in nodes]
    u, rate = random.normal(size=(2, nodes[1], nodes[0]))
    u[[0, -1]] = u[:, [0, -1]] = 0
    moved = advance(u, rate, order, steps, stiffness, sides)
    assert axes[0].count == axes[1].count == 2
    for left, first_x, end_x in places(axes[0]):
        for low, first_y, end_y in places(axes[1]):
            part = np.s_[low : low + axes[1].length, left : left + axes[0].length]
            tile = advance(u[part], rate[part], order, steps, stiffness, sides)
            written = np.s_[first_y:end_y, first_x:end_x]
            np.testing.assert_allclose(tile[written], moved[part][written], rtol=0, atol=1e-12)


def advance(u, rate, order, steps, stiffness, sides):
    """Return the displacement (ny, nx) of a plate with sides (low, high) along both axes; its edges do not move."""
    ny, nx = u.shape
    matrix = biharmonic(make_taps(nx, *sides, order), make_taps(ny, *sides, order), (1.0, 1.0), order)
    inner, u, rate = np.s_[1:-1, 1:-1], u.copy(), rate[1:-1, 1:-1].copy()
    for _ in range(steps):
        rate -= stiffness * (matrix @ u[inner].ravel()).reshape(rate.shape)
        u[inner] += rate
    return u


@pytest.mark.parametrize("order", [2, 4])
def test_plates_have_at_most_a_tile_for_each_multiprocessor(order):
    scheme, device = SimpleNamespace(order=order, nodes=(161, 191)), SimpleNamespace(sm_count=132)
    specialized = SimpleNamespace(scheme=scheme, device=device, real=wp.float32, shared_bytes=99 * 1024)
    axes, _ = plan_tiles(specialized, 1)
    assert 1 < axes[0].count * axes[1].count <= 132
    assert plan_tiles(specialized, 200) is None


@pytest.mark.skipif(not wp.is_cuda_available(), reason="tiles are of CUDA")
@pytest.mark.parametrize(("order", "precision"), [(2, "float32"), (4, "float32"), (4, "float64")])
def test_few_plates_and_many_get_the_same_bits(order, precision, scene, phasors):
    """One and three plates are cut into tiles, and 200 are not."""
    made = scene((97, 89), edges=EDGE_MIXES[1], damping=88.5, precision=precision, order=order)
    drives = phasors(200, len(made.actuators))
    many = PlateSolver(made, "cuda:0", "streaming").run(drives, (0.003, 0.009))
    for count in (1, 3):
        check_same(PlateSolver(made, "cuda:0", "streaming").run(drives[:count], (0.003, 0.009)), many, range(count))
