"""More functions of modes: what ``grid.modal_density`` does, and that an accuracy takes it where it is needed."""

import pytest

from warp_plate.accuracy.choose import choose
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Grid
from warp_plate.scene.model import Scene
from warp_plate.studies.simulate import simulate

# Without damping the high modes of a small patch keep their phases, so that the usual functions leave 3 %.
UNDAMPED = Scene.from_tables(
    {
        "plate": {
            "size": (0.2, 0.12),
            "thickness": 7e-4,
            "young_modulus": 7e10,
            "poisson_ratio": 0.22,
            "density": 2500.0,
        },
        "drive": {"frequency": 90.0},
        "window": {"start": 0.2, "end": 0.22},
        "target": {"area": (0.02, 0.06, 0.02, 0.06)},
        "actuators": [{"name": "a", "area": (0.15, 0.153, 0.03, 0.032)}],
        "edges": dict.fromkeys(("left", "right", "bottom", "top"), "clamped"),
    }
)


def test_density_gives_functions_along_each_side() -> None:
    plain, dense = (solve_modes(UNDAMPED.with_tables(grid={"modal_density": density})) for density in (1.0, 1.5))
    for few, many in zip(plain.space.shape, dense.space.shape, strict=True):
        assert many == pytest.approx(1.5 * few, rel=0.15)
    assert dense.frequencies[:5] == pytest.approx(plain.frequencies[:5], rel=1e-5)


@pytest.mark.slow
def test_accuracy_takes_more_functions_where_the_usual_ones_leave_too_much() -> None:
    scene = UNDAMPED.model_copy(update={"grid": Grid(accuracy=0.01)})
    choice = choose(scene, 0.01, "cpu", engine="modes")
    assert choice.by_modes
    assert choice.scene.grid.modal_density > 1
    assert f"{choice.scene.grid.modal_density:g} times as many functions" in choice.reason
    assert choice.error <= 0.01
    with pytest.raises(SceneError, match="modes have errors of up to"):
        choose(scene, 1e-5, "cpu", engine="modes")
    case = simulate(scene, device="cpu").cases["drive"]
    denser = simulate(scene.with_tables(grid={"modal_density": 3.0}), device="cpu", path="modal", estimate=False)
    assert case.localization_factor == pytest.approx(denser.cases["drive"].localization_factor, rel=choice.error)
