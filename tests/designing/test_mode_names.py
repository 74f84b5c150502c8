"""Frequencies of named modes in designs: names follow shapes where frequencies cross, and slopes are exact."""

import pytest

import warp_plate as wpl
from support.scenes import scene_of
from warp_plate.designing.mode_names import NamedModes
from warp_plate.designing.panel import FreePanel
from warp_plate.modal.modes import solve_modes


def test_names_follow_shapes_where_frequencies_cross():
    """Half-waves (2, 1) and (1, 2) of a supported plate change places with its stiffer direction."""
    stiff = {"orthotropic": {"Dx": 0.02, "Dy": 0.01, "D1": 0.004, "Dxy": 0.004}}
    soft = {"orthotropic": {"Dx": 0.01, "Dy": 0.02, "D1": 0.004, "Dxy": 0.004}}
    one, other = (scene_of(edges=("supported",) * 4, modal_density=0.5, effects=effects) for effects in (stiff, soft))
    named = NamedModes(one, [2, 3])
    plates = [solve_modes(scene, count=6) for scene in (one, other)]
    assert named.among(plates[0].space, plates[0].vectors) == [1, 2]
    assert named.among(plates[1].space, plates[1].vectors) == [2, 1]


def test_modes_with_equal_frequencies_are_refused():
    with pytest.raises(wpl.SceneError, match=r"design.limits.modes: 2: at .* Hz are several modes; name another"):
        NamedModes(scene_of(edges=("supported",) * 4, modal_density=0.5), [2])


def test_slopes_and_limits_of_named_modes(random):
    free = {"plate.young_modulus": [0.8e9, 1.3e9], "edges.right.translation": [1e4, 1e6]}
    edges = ("clamped", "clamped", {"translation": 1e5}, "supported")
    design = {"free": free, "limits": {"modes": {"3": [90.0, 130.0]}}, "starts": 1, "iterations": 3}
    scene = scene_of(edges=edges, modal_density=0.5, damping=60.0, window=(0.01, 0.03), design=design)
    panel = FreePanel(scene)
    numbers, direction = 0.3 + 0.4 * random.random((2, panel.count))
    value = panel.evaluate(numbers)
    near, far = (panel.evaluate(numbers + sign * 1e-3 * direction).excess for sign in (1, -1))
    assert len(value.excess) == 2
    assert value.excess_slopes @ direction == pytest.approx((near - far) / 2e-3, rel=1e-5)
    frequency = wpl.modes(scene, 3).frequencies[2]
    bare = scene.model_copy(update={"design": None})
    assert panel.exact(bare).excess["mode 3"] == pytest.approx(max(1 - frequency / 90, frequency / 130 - 1), abs=1e-6)


@pytest.mark.slow
def test_a_design_keeps_the_frequency_of_a_named_mode():
    free = {"thickness": {"range": [3.5e-4, 7.5e-4], "length_scale": 0.1}}
    scene = scene_of(size=(0.23, 0.2), edges=("supported",) * 4, modal_density=0.5, damping=60.0)
    third = wpl.modes(scene, 3).frequencies[2]
    limits = {"modes": {"3": [0.97 * third, 1.03 * third]}}
    scene = scene.replace("design", {**free, "limits": limits, "starts": 1, "iterations": 8})
    panel = wpl.design(scene, check=False)
    assert panel.improved
    plate = solve_modes(panel.scene, count=20)
    (at,) = NamedModes(scene, [3]).among(plate.space, plate.vectors)
    assert 0.97 * (1 - 1e-6) <= plate.frequencies[at] / third <= 1.03 * (1 + 1e-6)
