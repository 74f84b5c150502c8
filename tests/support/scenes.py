"""Small scenes, and the operator of their grids."""

import math

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.operator import LARGEST
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.load import preset_text

# The plate of the source paper.
MATERIAL = {"thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1000.0}
PAPER = preset_text("paper")
SIDES = ("left", "bottom", "right", "top")
# Three actuators without any symmetry; x0, x1, y0, y1 as fractions of the sides of the plate.
THREE_PATCHES = ((0.15, 0.3, 0.2, 0.35), (0.6, 0.85, 0.15, 0.4), (0.25, 0.65, 0.55, 0.8))
# A covering array: every pair of sides (left, bottom, right, top) has every pair of kinds in one of the five.
EDGE_MIXES = [("clamped",) * 4] + [
    tuple("clamped" if side == only else "supported" for side in range(4)) for only in range(4)
]


def scene_of(
    nodes=(13, 13),
    size=(0.2, 0.2),
    edges=("clamped",) * 4,
    damping=None,
    scheme="centred",
    precision="float64",
    window=(0.004, 0.012),
    actuators=None,
    load="overlap",
    time_step=None,
    frequency=290.0,
    order=2,
    modal_density=0.5,
    **tables,
):
    """Return a small scene of the paper's material; edges: left, bottom, right, top; actuators: their areas [m].

    Its modes are few (``modal_density``), which tests of accuracy raise.
    """
    if actuators is None:
        actuators = [tuple(np.array(shares) * np.repeat(size, 2)) for shares in THREE_PATCHES]
    grid = {"nodes": nodes, "order": order, "load": load, "precision": precision, "time_step": time_step}
    grid["modal_density"] = modal_density
    return Scene.model_validate(
        {
            "plate": {"size": size, **MATERIAL},
            "edges": dict(zip(SIDES, edges, strict=True)),
            "grid": grid,
            "window": {"start": window[0], "end": window[1]},
            "drive": {"frequency": frequency},
            "target": {"area": (0.0, size[0] / 2, 0.0, size[1] / 2)},
            "effects": {} if damping is None else {"damping": {"viscous": damping, "scheme": scheme}},
            "actuators": [{"name": str(index), "area": area} for index, area in enumerate(actuators)],
            **tables,
        }
    )


def areas_of(scene):
    """Return the ends (actuators, axis, 2) of a scene's patches [m]."""
    return np.array([actuator.area for actuator in scene.actuators]).reshape(-1, 2, 2)


def edges_id(edges):
    """Return CSCC for clamped, supported, clamped, clamped."""
    return "".join(edge[0].upper() for edge in edges)


def refused(call, *arguments, **keys):
    """Return the one-line error message of a call."""
    with pytest.raises(SceneError) as caught:
        call(*arguments, **keys)
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    return line


def refusal(text):
    """Return the one-line error message of a scene text, without the name of the file."""
    line = refused(Scene.parse, text, "panel.toml")
    assert line.startswith("panel.toml: ")
    return line.removeprefix("panel.toml: ")


def point_scene(nodes, size=(0.2, 0.2), edges=("clamped",) * 4, precision="float64", order=2, **changes):
    """Return a scene with an actuator on every inner node, row by row, so that any field can be the load; undamped and
    two steps long by default."""
    x, y = (np.linspace(0, length, count)[1:-1] for length, count in zip(size, nodes, strict=True))
    half_x, half_y = (length / (count - 1) / 4 for length, count in zip(size, nodes, strict=True))
    areas = [(i - half_x, i + half_x, j - half_y, j + half_y) for j in y for i in x]
    rigidity = MATERIAL["young_modulus"] * MATERIAL["thickness"] ** 3 / 12 / (1 - MATERIAL["poisson_ratio"] ** 2)
    kappa = math.sqrt(rigidity / (MATERIAL["density"] * MATERIAL["thickness"]))
    step = 0.95 * 2 / (kappa * LARGEST[order] * (1 / (4 * half_x) ** 2 + 1 / (4 * half_y) ** 2))
    # With four steps a period, the load is cos(0) = 1 at the first step and cos(π/2) = 6e-17 at the second.
    two_steps = {"time_step": step, "window": (0.0, 2 * step), "frequency": 1 / (4 * step)}
    options = {"precision": precision, "order": order, "load": "nodes", "actuators": areas, **two_steps, **changes}
    return scene_of(nodes, size, edges, **options)


def discrete_operator(scene):
    """Return the (inner nodes, inner nodes) matrix of ∇⁴ [1/m⁴], row by row, by kernels that serve any grid.

    The scene is a two-step ``point_scene``, and each plate has one unit load. It is at rest at t = 0, so u(Δt) has the
    shape of the load, and no load acts at the second step: u(2Δt) − u(Δt) = u(Δt) − (κΔt)²∇⁴u(Δt), which gives ∇⁴u.
    """
    scheme, count = make_scheme(scene), len(scene.actuators)
    run = PlateSolver(scene, "cpu", "streaming").run(np.eye(count), times=(scheme.time_step, 2 * scheme.time_step))
    first, second = np.moveaxis(run.displacement[..., 1:-1, 1:-1].reshape(count, 2, count), 1, 0)
    return ((2 * first - second) / (scheme.kappa * scheme.time_step) ** 2 / np.diag(first)[:, None]).T
