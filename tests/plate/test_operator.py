"""The one-dimensional taps of ``plate.operator``: closures, symmetry, spectrum, order, and a lossless plate.

The matrices are built from the taps as the kernels read them, B = bend and M = move without their edge rows, so that
M B is what a path applies along one axis.
"""

import itertools
import math

import numpy as np
import pytest

from support.numpy_plate import biharmonic, biharmonic_of_fourth_order, with_ghosts
from support.scenes import discrete_operator, point_scene
from warp_plate.plate.operator import DIVISOR, FEWEST_NODES, LARGEST, make_taps

ENDS = list(itertools.product(("clamped", "supported"), repeat=2))
ENDS_IDS = ["CC", "CS", "SC", "SS"]
GRIDS = (*range(FEWEST_NODES[4], 20), 33, 61)


def dense(bands):
    """Return the (nodes, nodes) matrix of (nodes, 2·reach + 1) taps; those beyond the edges must be zero."""
    nodes, reach = len(bands), bands.shape[1] // 2
    matrix = np.zeros((nodes, nodes + 2 * reach))
    for node, taps in enumerate(bands):
        matrix[node, node : node + taps.size] = taps
    assert not matrix[:, :reach].any()
    assert not matrix[:, nodes + reach :].any()
    return matrix[:, reach : nodes + reach]


def passes(nodes, low, high, order):
    """Return both passes in units of spacing²: (nodes, nodes − 2) from moving nodes to curvatures, and back."""
    taps = make_taps(nodes, low, high, order)
    return dense(taps.bend)[:, 1:-1] / DIVISOR[order], dense(taps.move)[1:-1] / DIVISOR[order]


def on_plate(nodes, size, edges, order=4):
    """Return both passes of a plate [1/m²]: (all nodes, inner nodes) and (inner nodes, all nodes), row by row."""
    (nx, ny), (hx, hy) = nodes, (length / (count - 1) for length, count in zip(size, nodes, strict=True))
    left, bottom, right, top = edges
    (bend_x, move_x), (bend_y, move_y) = passes(nx, left, right, order), passes(ny, bottom, top, order)
    place_x, place_y = np.eye(nx)[:, 1:-1], np.eye(ny)[:, 1:-1]
    bend = np.kron(place_y, bend_x) / hx**2 + np.kron(bend_y, place_x) / hy**2
    move = np.kron(place_y.T, move_x) / hx**2 + np.kron(move_y, place_x.T) / hy**2
    return bend, move


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("ends", ENDS, ids=ENDS_IDS)
def test_transposed_passes_and_spectrum_along_an_axis(ends, order):
    """B = Mᵀ to the last bit, but for the weight of edge nodes in second order, 2 where clamped and 0 where supported.

    M B is real to round-off, positive, and below the limit; its lowest eigenvalue is a beam's (π/cells)⁴ at least.
    """
    for nodes in GRIDS:
        bend, move = passes(nodes, *ends, order)
        if order == 4:
            np.testing.assert_array_equal(move, bend.T)
            assert np.linalg.norm(bend, 2) < LARGEST[4]
        else:
            weight = np.diag([{"clamped": 2.0, "supported": 0.0}[ends[0]], *np.ones(nodes - 2)] + [1.0])
            weight[-1, -1] = {"clamped": 2.0, "supported": 0.0}[ends[1]]
            np.testing.assert_array_equal(bend, weight @ move.T)
            np.testing.assert_array_equal(make_taps(nodes, *ends, 2).factors, np.diag(weight))
        values = np.linalg.eigvals(move @ bend)
        assert np.abs(np.imag(values)).max() <= 1e-12 * LARGEST[order] ** 2, nodes
        assert np.real(values).max() < LARGEST[order] ** 2, nodes
        assert np.real(values).min() > 0.97 * (math.pi / (nodes - 1)) ** 4, nodes


@pytest.mark.parametrize("order", [2, 4])
def test_references_and_kernels_have_this_operator(edges, order):
    """The plain NumPy plates, and the default path as measured to 1e-11 of its largest entry."""
    nodes, size = (14, 10), (0.2, 0.1)
    bend, move = on_plate(nodes, size, edges, order)
    expected, inner = move @ bend, (nodes[0] - 2) * (nodes[1] - 2)
    fields = np.zeros((inner, nodes[1], nodes[0]))
    fields[:, 1:-1, 1:-1] = np.eye(inner).reshape(inner, nodes[1] - 2, nodes[0] - 2)
    spacing = tuple(length / (count - 1) for length, count in zip(size, nodes, strict=True))
    if order == 4:
        found = biharmonic_of_fourth_order(fields, spacing, edges)
    else:
        found = biharmonic(with_ghosts(fields, edges), spacing)
    tolerance = np.abs(expected).max()
    np.testing.assert_allclose(found.reshape(inner, inner).T, expected, rtol=0, atol=1e-13 * tolerance)
    measured = discrete_operator(point_scene(nodes, size, edges, order=order))
    np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-10 * tolerance)
