"""Random scenes with a table ``[design]``: a number is a scene of ``error_bars/scenes.py``, or one with an outline."""

from __future__ import annotations

import math

import numpy as np
import scipy
from error_bars.elements import Side, density_at
from error_bars.scenes import random_scene

from warp_plate import Scene
from warp_plate.designing.candidates import gridded
from warp_plate.designing.panel import FreePanel
from warp_plate.modal.assemble import make_galerkin
from warp_plate.modal.sensitivity.adjoint import EnergyAdjoint
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors

# Objectives of a steady state, and of any window; efforts; a coil.
STEADY, OTHERS = ("acceleration", "sound", "power"), ("bound", "drive", "energy_target", "velocity", "displacement")
EFFORTS = ("drive", "power", "sound")
COIL = {
    "kind": "coil", "force_factor": 2.0, "resistance": 4.0, "moving_mass": 1e-3, "suspension_stiffness": 500.0,
    "suspension_damping": 0.1, "magnet": "free", "magnet_mass": 0.02, "voltage": 1.0,
}  # fmt: skip


def designed_scene(number: int, limited: bool, accurate: bool = False) -> Scene:
    """Return a random scene with a random table ``[design]``."""
    rng = np.random.default_rng([number, 47])
    scene, _ = random_scene(number)
    effects, plate = scene.model_dump()["effects"], scene.plate
    if rng.random() < 0.3:
        effects |= {"loss_factor": {"eta": 10 ** rng.uniform(-2, -1)}, "material_damping": None}
    design: dict = {"starts": 2, "iterations": 8, "seed": number, "free": {}, "places": {}}
    design["objective"] = str(rng.choice(["bound", "drive", "energy_target"], p=(0.6, 0.2, 0.2)))
    mapped = effects["orthotropic"] is None and rng.random() < 0.5
    if mapped:
        effects["variation"] = None
        length = max(plate.size) / rng.uniform(2, 4)
        design["thickness"] = {
            "range": [0.7 * plate.thickness, 1.4 * plate.thickness], "length_scale": length,
            "mass": rng.choice([None, 1.0]),
            "symmetry": str(rng.choice(["none", "x", "y", "both"], p=(0.7, 0.1, 0.1, 0.1))),
        }  # fmt: skip
    free, whole = design["free"], (0.0, plate.size[0], 0.0, plate.size[1])
    if effects["oscillators"]:
        for name in ("mass", "stiffness"):
            value = effects["oscillators"][0][name]
            free[f"effects.oscillators[0].{name}"] = [0.3 * value, 3 * value]
        if rng.random() < 0.5:
            design["places"]["effects.oscillators[0]"] = whole
    if effects["layers"]:
        value = effects["layers"][0]["thickness"]
        free["effects.layers[0].thickness"] = [0.3 * value, 2 * value]
    if isinstance(edge := scene.model_dump()["edges"]["top"], dict):
        free["edges.top.translation"] = [0.3 * edge["translation"], 3 * edge["translation"]]
    if effects["foundation"]:
        free["effects.foundation.stiffness"] = [
            0.3 * effects["foundation"]["stiffness"],
            2 * effects["foundation"]["stiffness"],
        ]
    if rng.random() < 0.3 or not (mapped or free):
        design["places"]["actuators[0]"] = whole
    if rng.random() < 0.2:
        design["tolerance"] = {"plate.young_modulus": 0.05}
    if rng.random() < 0.2:
        design["frequencies"] = [scene.drive.frequency, 1.1 * scene.drive.frequency]
    scene = scene.with_tables(
        effects=effects, design=design, grid={"nodes": [21, 21], **({} if accurate else {"modal_density": 0.7})}
    )
    return scene if not limited or rng.random() < 0.4 else with_limits(scene, rng)


def with_limits(scene: Scene, rng: np.random.Generator) -> Scene:
    """Return a scene with random limits about what its panel has."""
    panel, limits = FreePanel(scene), {}
    bare = scene.model_copy(update={"design": None})
    solver = ModalSolver(gridded(bare), "cpu")
    if rng.random() < 0.5 and (panel.thickness is None or panel.thickness.mass is None):
        limits["mass"] = true_mass(bare) * rng.uniform(0.97, 1.1)
    if rng.random() < 0.5:
        natural = solver.plate.frequencies[:6]
        index = int(rng.integers(0, 5))
        low, high = natural[index : index + 2]
        if high - low > 0.03 * high and low > 1e-2 * high:
            part = rng.uniform(0.02, 0.3) * (high - low)
            limits["gap"] = [low + part * rng.choice([-0.2, 1]), high - part]
    if rng.random() < 0.3:
        energy = energy_of(panel, bare)
        limits["energy_target"] = energy * rng.uniform(0.5, 1.2)
    return scene if not limits else scene.replace("design.limits", limits)


def energy_of(panel: FreePanel, scene: Scene) -> float:
    adjoint = EnergyAdjoint(make_galerkin(scene, panel._functions.of_scene(scene)))
    phasors = scene_phasors(scene)
    z = np.concatenate([phasors.real, -phasors.imag])
    return float(z @ adjoint["target"] @ z)


def both_forms(panel: FreePanel, numbers: np.ndarray) -> np.ndarray:
    """Return the (2, 2M, 2M) energies of unit drives in plate and target."""
    adjoint = panel._adjoint(numbers, panel.cases[0])
    return np.stack([adjoint["plate"], adjoint["target"]])


def symmetric_scene(number: int) -> Scene:
    """Return a square panel on equal springs with all its symmetries, of which one spring or the thickness is free, if
    possible at a frequency at which two drives reach the bound."""
    rng = np.random.default_rng([number, 48])
    side, thickness = 0.2, 5e-4
    low, width = rng.uniform(0.02, 0.07), rng.uniform(0.01, 0.02)
    places = low, side - low - width
    actuators = [{"name": f"{x:g} {y:g}", "area": (x, x + width, y, y + width)} for x in places for y in places]
    inner = rng.uniform(0.03, 0.07)
    edge = {"translation": 10 ** rng.uniform(4, 6)}
    design = {"free": {"edges.left.translation": [0.5 * edge["translation"], 1.5 * edge["translation"]]}}
    if rng.random() < 0.5:
        design = {"thickness": {"range": [4e-4, 6e-4], "length_scale": 0.1}}
    scene = Scene.from_tables({
        "plate": {"size": (side, side), "thickness": thickness, "young_modulus": 1e9, "poisson_ratio": 0.33,
                  "density": 1000.0},
        "edges": dict.fromkeys(("left", "right", "bottom", "top"), edge), "actuators": actuators,
        "effects": {"damping": {"viscous": rng.uniform(20, 100)}}, "grid": {"nodes": [21, 21], "modal_density": 0.5},
        "target": {"area": (inner, side - inner, inner, side - inner)},
        "drive": {"frequency": 300.0}, "window": {"start": 0.01, "end": 0.03}, "design": design,
    })  # fmt: skip
    for frequency in rng.uniform(60, 600, 30):
        scene = scene.replace("drive.frequency", frequency)
        panel = FreePanel(scene)
        matrices = both_forms(panel, panel.start())
        ratios = np.sort(scipy.linalg.eigh(matrices[1], matrices[0], eigvals_only=True))[::-1]
        if ratios[2] > ratios[0] - 1e-9:  # each drive counts twice, with a lag of a quarter of a period
            break
    return scene


def varied_scene(number: int) -> Scene:
    """Return a scene with any objective, and more kinds of free numbers than :func:`designed_scene`."""
    rng, scene = np.random.default_rng([number, 51]), designed_scene(number, limited=False)
    tables = scene.model_dump(mode="json", exclude_none=True)
    design, effects = tables["design"], tables["effects"]
    design |= {"objective": str(rng.choice(STEADY + OTHERS)), "steady": bool(rng.random() < 0.4)}
    if design["objective"] in ("energy_target", "velocity", "displacement", "acceleration") and rng.random() < 0.5:
        design["effort"] = str(rng.choice(EFFORTS))
    used = {design["objective"], design.get("effort")}
    design["steady"] |= bool(used & {*STEADY}) or scene.steady
    if design["steady"] and rng.random() < 0.3:
        design["limits"] = {"power": 1.0, "sound": 60.0}
    whole = [0.0, scene.plate.size[0], 0.0, scene.plate.size[1]]
    if design["steady"] and not design.get("tolerance") and rng.random() < 0.3:
        row = tables["actuators"][0]
        tables["actuators"][0] = {key: row[key] for key in ("name", "area")} | COIL
        keys = ("force_factor", "suspension_stiffness", "suspension_damping", "moving_mass", "magnet_mass")
        design["free"] |= {f"actuators[0].{key}": [0.5 * COIL[key], 2 * COIL[key]] for key in keys}
    if design["steady"] and rng.random() < 0.2:
        effects["air"] = {"sides": "front"}
    if effects.get("oscillators"):
        value = effects["oscillators"][0]["damping"]
        design["free"]["effects.oscillators[0].damping"] = [0.3 * value, 3 * value]
    if effects.get("layers") and rng.random() < 0.7:
        design["places"]["effects.layers[0]"] = whole
    for name in ("density", "young_modulus"):
        if rng.random() < 0.3 and "orthotropic" not in effects:
            value = tables["plate"][name]
            design["free"][f"plate.{name}"] = [0.8 * value, 1.2 * value]
    if rng.random() < 0.2 and "thickness" not in design:
        design["free"]["plate.size[0]"] = [scene.plate.size[0], 1.1 * scene.plate.size[0]]
        design["objective"], used = (
            ("bound", set()) if "air" in effects or "sound" in used else (design["objective"], used)
        )
        effects.pop("air", None)
        design.pop("limits", None)
        if "effort" in design and (design["objective"] == "bound" or design["effort"] == "sound"):
            del design["effort"]
    scene = Scene.from_tables(tables)
    if not scene.design.limits.given:
        return scene
    panel = FreePanel(scene)
    # Limits near what the panel has.
    passed = np.maximum(1 + panel.evaluate(panel.start(), sloped=False).excess, 1e-15)
    # Without damping drives need no power but by rounding.
    sound, power = 60 + 10 * math.log10(passed[0]), max(float(passed[1]), 1e-9)
    return scene.replace("design.limits", {"sound": sound, "power": power})


def shaped_scene(number: int) -> Scene:
    """Return a scene with an outline, of which pieces are free."""
    rng = np.random.default_rng([number, 52])
    far, holes, supports, links = float(rng.uniform(0.17, 0.22)), [], [], {}
    kind = str(rng.choice(["disc", "ellipse", "polygon", "hole", "slot", "part", "support"]))
    spring = {"translation": float(10 ** rng.uniform(4, 6)), "rotation": float(10 ** rng.uniform(0, 2))}
    edges = {"outline": spring if rng.random() < 0.5 else str(rng.choice(["clamped", "supported", "free"]))}
    outline, half = {"rectangle": [far, 0.9 * far]}, far / 2
    if kind == "disc":
        outline, centred = {"disc": [half] * 3}, {"radius": half}
        links = {"radius": {"keys": [f"plate.outline.disc[{index}]" for index in range(3)]}}
    elif kind == "ellipse":
        outline, centred = {"ellipse": [half, half, half, 0.8 * half, 0.0]}, {"plate.outline.ellipse[3]": 0.8 * half}
    elif kind == "polygon":
        outline = {"polygon": [[0, 0], [far, 0], [0.95 * far, 0.8 * far], [0.3 * far, far], [0, 0.6 * far]]}
        centred = {"plate.outline.polygon[2][0]": 0.95 * far, "plate.outline.polygon[2][1]": 0.8 * far}
    elif kind == "hole":
        disc = [0.75 * far, 0.7 * far, 0.08 * far]
        holes = [{"disc": disc, "edge": str(rng.choice(["free", "clamped"]))}]
        centred = {f"plate.holes[0].disc[{index}]": at for index, at in enumerate(disc)}
    elif kind == "slot":
        size, centre = [0.25 * far, 0.05 * far], [0.7 * far, 0.25 * far]
        holes = [{"rectangle": size, "centre": centre, "corner_radius": 0.025 * far}]
        centred = {"plate.holes[0].centre[0]": centre[0], "plate.holes[0].rectangle[0]": size[0]}
    elif kind == "part":
        edges = {"outline": spring}
        edges["parts"] = [{"from_point": [0.25 * far, 0], "to_point": [0.6 * far, 0], "edge": "clamped"}]
        centred = {"edges.parts[0].to_point[0]": 0.6 * far}
    else:
        points, held = ((0.25, 0.65), (0.8, 0.7), (0.5, 0.25)), {"stiffness": 1e5} if rng.random() < 0.5 else {}
        edges, supports = {"outline": "free"}, [{"point": [far * x, far * y], **held} for x, y in points]
        centred = {f"supports[0].point[{axis}]": far * at for axis, at in enumerate(points[0])}
    free = {key: [value * part for part in (0.93, 1.07)] for key, value in centred.items()}
    if rng.random() < 0.5:
        free["plate.thickness"] = [8e-4, 1.2e-3]
    if isinstance(edges["outline"], dict):
        free["edges.outline.translation"] = [0.5 * spring["translation"], 2 * spring["translation"]]
    design = {"free": free, "objective": str(rng.choice(OTHERS)), "limits": {"mass": 0.2} if rng.random() < 0.5 else {}}
    discs = [{"name": str(part), "disc": [part * far, half, 0.06 * far]} for part in (0.35, 0.55)]
    return Scene.from_tables({
        "plate": {"outline": outline, "holes": holes, "thickness": 1e-3, "young_modulus": 7e10, "poisson_ratio": 0.3,
                  "density": 2700.0},
        "edges": edges, "supports": supports, "links": links, "actuators": discs, "design": design,
        "target": {"disc": [half, 0.6 * far, 0.15 * far]}, "effects": {"damping": {"viscous": 200.0}},
        "drive": {"frequency": float(rng.uniform(300, 1200))}, "window": {"start": 0.01, "end": 0.015},
        "grid": {"nodes": [21, 21], "modal_density": 0.6},
    })  # fmt: skip


def true_mass(scene: Scene) -> float:
    sides = [Side(scene, axis, 7) for axis in (0, 1)]
    weights = np.outer(sides[1].weights, sides[0].weights)
    plate = (weights * density_at(scene, sides[0].points, sides[1].points)).sum()
    return float(plate + sum(oscillator.mass for oscillator in scene.effects.oscillators))
