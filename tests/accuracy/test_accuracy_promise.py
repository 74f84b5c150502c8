"""Chosen grids keep their accuracy, against the modal engine with many functions, and so do chosen functions."""

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate import PlateSolver, Scene
from warp_plate.accuracy.choose import choose
from warp_plate.accuracy.reference_solution import best_single, solve_response
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Grid
from warp_plate.solve.response import measure_response
from warp_plate.studies.simulate import simulate

C, S = "clamped", "supported"
ALUMINIUM = {"thickness": 1e-3, "young_modulus": 7e10, "poisson_ratio": 0.34, "density": 2700.0}
ACRYLIC = {"thickness": 2e-3, "young_modulus": 3e9, "poisson_ratio": 0.37, "density": 1180.0}
PAPER = {"thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1000.0}
# Size [m], material, edges left, bottom, right, top, damping [N·s/m³], frequency [Hz], window [s], target and actuators
# as fractions of the sides.
SCENES = {
    "rectangular, supported": (
        (0.3, 0.12), ALUMINIUM, (S, S, S, S), 400.0, 500.0, (0.02, 0.04), (0.5, 1, 0, 1),
        [(0.1, 0.2, 0.3, 0.6), (0.75, 0.85, 0.4, 0.7), (0.45, 0.55, 0.1, 0.3)],
    ),
    "undamped, strip target": (
        (0.2, 0.15), ACRYLIC, (C, C, C, C), None, 200.0, (0.005, 0.015), (0.35, 0.6, 0, 1),
        [(0.2, 0.35, 0.3, 0.45), (0.6, 0.7, 0.6, 0.75)],
    ),
    "heavy damping": (
        (0.25, 0.2), PAPER, (S, C, S, C), 2000.0, 150.0, (0.01, 0.03), (0, 0.4, 0, 0.4),
        [(0.1, 0.2, 0.1, 0.2), (0.6, 0.7, 0.5, 0.65), (0.3, 0.4, 0.7, 0.8)],
    ),
    "large patches at the edge": (
        (0.3, 0.3), ALUMINIUM, (S, S, C, C), 600.0, 300.0, (0.015, 0.04), (0, 1, 0, 0.33),
        [(0.0, 0.3, 0.0, 0.2), (0.5, 1.0, 0.6, 1.0)],
    ),
}  # fmt: skip
QUICK = "undamped, strip target"
ASKED = 0.01


def scene_called(name):
    size, material, edges, damping, frequency, window, target, actuators = SCENES[name]
    scale = np.repeat(size, 2)
    areas = [tuple(scale * area) for area in actuators]
    return Scene.model_validate(
        {
            "plate": {"size": size, **material},
            "edges": dict(zip(("left", "bottom", "right", "top"), edges, strict=True)),
            "window": {"start": window[0], "end": window[1]},
            "drive": {"frequency": frequency},
            "target": {"area": tuple(scale * target)},
            "effects": {} if damping is None else {"damping": {"viscous": damping}},
            "actuators": [{"name": str(index), "area": area} for index, area in enumerate(areas)],
        }
    )


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == QUICK else pytest.mark.slow) for name in SCENES]
)
def test_chosen_grids_keep_their_accuracy(name):
    """The best single actuator, the best drive, equal drive and the bound have at most the error asked for."""
    scene = scene_called(name)
    choice = choose(scene, ASKED, "cpu")
    coarse, exact = (solve_response(scene, density)[1] for density in (1.0, 1.3))
    phasors = np.array([best_single(exact), exact.best_drive(), np.ones(len(scene.actuators))])
    expected = exact.localization_factors(phasors)
    uncertainty = np.abs(expected - coarse.localization_factors(phasors)).max()
    assert uncertainty < 0.15 * ASKED
    computed = localization_factor(PlateSolver(choice.scene, "cpu").run(phasors).energy)
    grid = choice.scene.grid.model_copy(update={"precision": "float64"})
    computed_bound = measure_response(PlateSolver(choice.scene.model_copy(update={"grid": grid}), "cpu")).bound()
    errors = [*np.abs(computed / expected - 1), abs(computed_bound / exact.bound() - 1)]
    assert max(errors) < choice.error + uncertainty
    assert choice.error <= ASKED
    assert choice.scene.grid.accuracy is None


# Without damping the high modes of a small patch keep their phases, so that the usual functions leave 3 %.
GLASS = {"size": (0.2, 0.12), "thickness": 7e-4, "young_modulus": 7e10, "poisson_ratio": 0.22, "density": 2500.0}
UNDAMPED = scene_of(
    plate=GLASS, size=(0.2, 0.12), frequency=90.0, window=(0.2, 0.22), actuators=[(0.15, 0.153, 0.03, 0.032)],
    target={"area": (0.02, 0.06, 0.02, 0.06)},
)  # fmt: skip


def test_density_gives_functions_along_each_side():
    plain, dense = (solve_modes(UNDAMPED.with_tables(grid={"modal_density": density})) for density in (1.0, 1.5))
    for few, many in zip(plain.space.shape, dense.space.shape, strict=True):
        assert many == pytest.approx(1.5 * few, rel=0.15)
    assert dense.frequencies[:5] == pytest.approx(plain.frequencies[:5], rel=1e-5)


@pytest.mark.slow
def test_accuracy_takes_more_functions_where_the_usual_ones_leave_too_much():
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


@pytest.mark.slow
def test_small_factors_are_stepped_in_float64():
    """In a corner between clamped edges energies are lost in the rounding of float32."""
    scene = scene_of(
        size=(0.1, 0.1), frequency=400.0, window=(0.02, 0.025), actuators=[(0.05, 0.08, 0.03, 0.06)],
        target={"area": (0.0005, 0.003, 0.0005, 0.003)}, modal_density=1.0,
    )  # fmt: skip
    choice = choose(scene, 0.1, "cpu")
    assert choice.error <= 0.1
    assert choice.scene.grid.precision == "float64"
    coarse = choice.scene.with_tables(grid={**choice.scene.grid.model_dump(), "precision": "float32"})
    exact, rounded = (PlateSolver(made, "cpu").run(np.ones((1, 1))).energy for made in (choice.scene, coarse))
    assert abs(localization_factor(rounded) / localization_factor(exact) - 1) > 0.05
