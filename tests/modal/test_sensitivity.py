"""Slopes of energies by the matrices of a plate and by its map of thickness, against central differences."""

from dataclasses import fields, replace

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate.designing.functions import PanelFunctions
from warp_plate.modal.assemble import make_galerkin
from warp_plate.modal.sensitivity.adjoint import EnergyAdjoint
from warp_plate.modal.sensitivity.fields import FieldSlopes
from warp_plate.modal.sensitivity.forms import PlateMatrices, plate_matrices
from warp_plate.modal.spaces.space import Matrix
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.scene.errors import SceneError
from warp_plate.solve.response import largest_ratio

OSCILLATOR = {"area": (0.05, 0.09, 0.1, 0.12), "mass": 2e-3, "stiffness": 3e3, "damping": 0.5}
LAYER = {"area": (0.02, 0.12, 0.05, 0.08), "thickness": 1e-4, "young_modulus": 2e9, "density": 1800.0}
DISC = {**{key: LAYER[key] for key in LAYER if key != "area"}, "disc": (0.12, 0.1, 0.03)}
# Without any symmetry, so that modes of all parities mix.
THICKNESS = [[1.0, 0.98, 1.01], [0.99, 1.01, 1.0]]
CASES = {
    "viscous": {"damping": 40.0},
    "undamped": {},
    "oscillator": {"damping": 40.0, "effects": {"oscillators": [OSCILLATOR]}},
    "steady": {"effects": {"loss_factor": {"eta": 0.02}, "oscillators": [OSCILLATOR]}},
    "material": {"effects": {"material_damping": {"time": 1e-5}}},
    "modal damping": {"effects": {"modal_damping": {"ratio": 0.02}, "oscillators": [OSCILLATOR]}},
    "displacement": {"damping": 40.0},
    "sound and power": {"effects": {"loss_factor": {"eta": 0.02}, "oscillators": [OSCILLATOR]}},
    "air": {"effects": {"air": {"sides": "front"}, "damping": {"viscous": 30.0}}},
    "springs": {"damping": 40.0, "edges": ({"translation": 1e5}, "clamped", "free", "supported")},
}
NAMES = [field.name for field in fields(PlateMatrices)]
INTERVALS = (5, 5)
WEIGHTS = {
    "displacement": {"displacement": 1e6, "target": -0.7},
    "sound and power": {"sound": 1e3, "power": 1.0, "plate": -1.0, "acceleration": 1e-6},
    "air": {"sound": 1e3, "target": 0.3},
}


def scene_with(thickness, window=(0.003, 0.008), **case):
    scene = scene_of(window=window, **case)
    return scene.model_copy(update={"effects": scene.effects.with_thickness(thickness)})


def difference(function, step):
    """Return the derivative at 0, but for errors of the fourth power of the step."""
    near, far = ((function(size) - function(-size)) / (2 * size) for size in (step, 2 * step))
    return (4 * near - far) / 3


@pytest.mark.parametrize("name", CASES)
def test_slopes_by_matrices(name, random):
    scene = scene_with(THICKNESS, **CASES[name])
    galerkin = make_galerkin(scene, TensorSplines(scene, INTERVALS))
    base, weights = plate_matrices(galerkin), WEIGHTS.get(name, {"plate": 1.0, "target": -0.7})
    phasors = random.normal(size=3) + 1j * random.normal(size=3)
    functions = PanelFunctions(scene, 290.0)
    functions.space = galerkin.space
    air = functions.air(290.0)
    slopes = EnergyAdjoint(galerkin, base, air=air).slopes(phasors, weights)

    def energy(changed, factor):
        matrices = PlateMatrices(*(getattr(base, key) + factor * getattr(changed, key) for key in NAMES))
        sparse = {key: Matrix(getattr(matrices, key)) for key in NAMES[:4]}
        adjoint = EnergyAdjoint(replace(galerkin, **sparse), matrices, air=air)
        forms = np.stack([adjoint[name] for name in weights])
        return quadratic_forms(forms, phasors[None])[0] @ list(weights.values())

    changes = []
    for key in NAMES[:-1]:
        reference = getattr(base, "mass" if key == "damping" else "bending" if key == "support" else key)
        scale = random.normal(size=reference.shape[-1] if key != "forces" else reference.shape)
        change = reference * (scale if key == "forces" else scale[:, None] + scale) * 0.3
        changes.append(change * (80.0 if key == "damping" else 1.0))
    change = PlateMatrices(*changes, coils=np.zeros((3, 0)))
    assert slopes.product(change) == pytest.approx(difference(lambda factor: energy(change, factor), 2e-4), rel=1e-6)


@pytest.mark.parametrize(
    "case",
    [
        {"damping": 40.0},
        {"damping": 40.0, "target": {"disc": (0.13, 0.11, 0.03)}},
        pytest.param(
            {"damping": 40.0, "effects": {"layers": [LAYER], "oscillators": [OSCILLATOR]}}, marks=pytest.mark.slow
        ),
        {"damping": 40.0, "effects": {"layers": [DISC]}, "target": {"disc": (0.13, 0.11, 0.03)}},
        {"effects": {"loss_factor": {"eta": 0.02}}},
    ],
    ids=["viscous", "disc", "layer", "disc layer", "steady"],
)
def test_slopes_of_the_bound_by_thickness(case, random):
    thickness = 1 + 0.2 * random.random((4, 5))
    along = TensorSplines(scene_with(thickness, **case), INTERVALS).along
    direction = random.normal(size=thickness.shape)

    def solved(factor):
        scene = scene_with((thickness + factor * direction).tolist(), (0.01, 0.03), **case)
        space = TensorSplines(scene, INTERVALS, along)
        adjoint = EnergyAdjoint(make_galerkin(scene, space))
        return space, adjoint, *largest_ratio(np.stack([adjoint["plate"], adjoint["target"]]))

    space, adjoint, bound, z = solved(0.0)
    phasors = z[: len(z) // 2] - 1j * z[len(z) // 2 :]
    plate = quadratic_forms(adjoint["plate"][None], phasors[None])[0, 0]
    weights = {"plate": -bound / plate, "target": 1 / plate}
    (slopes,) = FieldSlopes(space, [adjoint.slopes(phasors, weights)], np.zeros(1), np.zeros(1)).by_thickness()
    expected = difference(lambda factor: solved(factor)[2], 2e-4)
    assert np.sum(slopes * direction) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("case", "key"),
    [
        ({"drive": {"frequency": 290.0, "burst": {"start": 0.0, "duration": 0.01}}}, "drive.burst"),
        ({"effects": {"modal_damping": {"ratio": [0.02, 0.01]}}}, "effects.modal_damping"),
        ({"effects": {"air": {"baffle": False}}}, "effects.air.baffle: false"),
    ],
)
def test_scenes_without_slopes_are_refused(case, key):
    scene = scene_of(**case)
    with pytest.raises(SceneError, match=f"^{key}: slopes are"):
        EnergyAdjoint(make_galerkin(scene, TensorSplines(scene, INTERVALS)))
