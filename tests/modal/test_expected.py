"""Sizes of solutions by modes that are known beforehand."""

import pytest

from warp_plate.modal.expected import expected_modes
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.signals import highest_frequency
from warp_plate.scene.model import Scene

LAYER = {"area": (0.05, 0.12, 0.04, 0.1), "thickness": 2e-4, "young_modulus": 6e10, "density": 7800.0}


@pytest.mark.parametrize(
    ("name", "effects", "part"),
    [("paper", {}, 1e-9), ("paper", {"layers": [LAYER]}, 1e-9), ("watch", {}, 0.25), ("trackpad", {}, 0.25)],
)
def test_the_functions_of_a_plate_are_known_before_it_is_solved(name, effects, part):
    scene = Scene.load(name)
    scene = scene.with_tables(effects={**scene.effects.model_dump(exclude_none=True), **effects})
    highest = highest_frequency(scene)
    unknowns, modes = solve_modes(scene, highest).vectors.shape
    expected = expected_modes(scene, highest)
    assert expected.functions == pytest.approx(unknowns, rel=part)
    assert expected.modes == pytest.approx(modes, rel=0.3)  # stiff motions beside layers are left out


def test_more_time_for_coupled_modes_less_symmetry_and_more_actuators():
    def seconds(scene):
        return expected_modes(scene, highest_frequency(scene)).seconds

    paper = Scene.load("paper")
    free = paper.with_tables(edges={"left": "clamped", "bottom": "free", "right": "free", "top": "clamped"})
    many = paper.with_tables(actuators=[{"name": str(index), "area": (0.03, 0.04, 0.03, 0.04)} for index in range(40)])
    coupled = paper.with_tables(
        effects={"damping": {"viscous": 88.3}, "material_damping": {"time": 1e-6}, "foundation": {"stiffness": 1e5}}
    )
    assert seconds(paper) < min(seconds(free), seconds(many))
    assert seconds(coupled) > 3 * seconds(paper)
