"""Pictures of plates on supports."""

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate.viz.annotations import EDGE_STYLES, edges_by_kind, legend_entries
from warp_plate.viz.fields import drawing_scale
from warp_plate.viz.outlined import continued
from warp_plate.viz.plots.frame import with_unit
from warp_plate.viz.plots.modes import refined
from warp_plate.viz.plots.plan import edge_handles
from warp_plate.viz.scene3d import PlateMeshes, line_layers

pytest.importorskip("pyvista")


def test_a_rectangle_on_supports_is_drawn_as_one_without():
    plain = scene_of(size=(0.2, 0.2))
    held = scene_of(size=(0.2, 0.2), supports=[{"line": ((0.0, 0.0), (0.2, 0.2))}])
    shape = np.random.default_rng(1).normal(size=(31, 31))
    np.testing.assert_array_equal(continued(held, shape), shape)
    np.testing.assert_array_equal(refined(held, shape)[2], refined(plain, shape)[2])


def test_supports_are_drawn_on_the_plate_alone():
    line, ring = ((0.05, 0.1), (0.15, 0.1)), (0.1, 0.1, 0.03)
    supports = [{"point": (0.0, 0.0)}, {"line": line, "stiffness": 1e5}, {"ring": ring}]
    scene = scene_of(size=(0.2, 0.2), supports=supports)
    point, line, ring = map(np.array, edges_by_kind(scene)["support"])
    assert np.hypot(*point.T).max() < 0.01
    np.testing.assert_allclose(line, [[0.05, 0.1], [0.15, 0.1]])
    np.testing.assert_allclose(np.hypot(*(ring - 0.1).T), 0.03)
    meshes = PlateMeshes(scene, np.zeros((9, 9)), drawing_scale([np.zeros((9, 9))], scene.plate.size))
    assert meshes.lines["support"].mesh.n_points > len(ring)
    assert meshes.lines["support"].mesh.points[:, :2].min() >= 0
    assert ("── support", EDGE_STYLES["support"].colour) in legend_entries(scene)


def test_supports_at_points_have_a_circle_in_legends():
    scene = scene_of(size=(0.2, 0.2), supports=[{"point": (0.05, 0.05)}])
    assert ("○ support", EDGE_STYLES["support"].colour) in legend_entries(scene)
    assert [handle.get_marker() for handle in edge_handles(scene)] == ["None", "o"]


def test_the_line_of_a_target_lies_on_wide_edges():
    springs = {"translation": 1e6, "rotation": 0.0}
    scene = scene_of(size=(0.2, 0.2), edges=("clamped", springs, "clamped", "clamped"))
    meshes = PlateMeshes(scene, np.zeros((9, 9)), drawing_scale([np.zeros((9, 9))], scene.plate.size))
    names = {id(lines): name for name, lines in meshes.lines.items()}
    layers = {names[id(layer.lines)]: layer for layer in line_layers(meshes)}
    for kind in ("clamped", "springs"):
        assert layers[kind].width > layers["target"].width
        assert layers[kind].depth_offset < layers["target"].depth_offset


def test_powers_of_units_are_superscripts():
    assert with_unit("mean square velocity", "(m/s)^2/N^2") == "mean square velocity [(m/s)²/N²]"
