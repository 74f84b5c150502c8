"""Hard cases inside a plate: jumps of thickness, free corners, extreme masses and springs, buckling, stretching."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hard_cases.case import Case, Measured, Where, both, grouped, largest_difference, scene_of, stepped
from support.numpy_plate import run_moment_form
from warp_plate import PlateSolver
from warp_plate.plate.bending import buckling_factor, make_bending
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.model import Scene

DRIVES = np.array([[1.0, 0.4j]])
# Of the plate's own material on both faces: 1 + 2·4.5 = 10 times as thick.
TEN_TIMES = {"thickness": 4.5 * 5e-4, "young_modulus": 1e9, "density": 1000.0, "both": True}
SPOT = (0.095, 0.105, 0.115, 0.125)
PLATE_MASS = 0.2 * 0.2 * 5e-4 * 1000


def thick(area: tuple[float, ...]) -> dict[str, object]:
    """A plate ten times as thick over an area."""
    return {"layers": [{"area": area, **TEN_TIMES}]}


INSIDES: dict[str, dict[str, object]] = {
    "thickness jumps 1 : 10 along a line": {"effects": thick((0.083, 0.2, 0.0, 0.2))},
    "thickness jumps 1 : 10 around a patch": {"effects": thick((0.06, 0.13, 0.05, 0.11)), "edges": ("free",) * 4},
    "free corners beside clamped edges": {"edges": ("clamped", "clamped", "free", "free")},
    "a point mass 1000 times the plate's": {
        "effects": {"oscillators": [{"area": SPOT, "mass": 1e3 * PLATE_MASS, "stiffness": 1e5}]}
    },
    "a spring 10⁶ times as stiff as the plate": {"effects": {"oscillators": [{"area": SPOT, "stiffness": 1e9}]}},
    "an edge 10⁶ times as stiff as the plate": {
        "edges": ("clamped", {"translation": 1e12, "rotation": 1e6}, "free", "clamped")
    },
}


def inside(name: str, where: Where) -> Measured:
    """Largest difference from the NumPy reference in float64, relative, over a short run; or infinite, where a long
    one is not bounded."""
    scene = stepped(scene_of((15, 13), **INSIDES[name]), 0.9, 400)  # type: ignore[arg-type]
    return _against_numpy(where, scene)


def _against_numpy(where: Where, scene: Scene, drives: np.ndarray = DRIVES, part: float = 0.9) -> Measured:
    run = where.solver(scene).run(drives, (scene.window.end,))
    exact = run_moment_form(scene, drives).displacement[:, -1]
    difference = largest_difference(run.displacement[:, 0], exact)
    long = stepped(scene, part, where.steps(100_000, 3000), scene.drive.frequency)
    kept = where.solver(long).run(drives, (), [(0.13, 0.05)])
    speed = np.abs(np.diff(kept.trace[0, 0]))
    tenth = len(speed) // 10
    bounded = kept.status[0] == "ok" and speed[-tenth:].max() < 3 * speed[: 3 * tenth].max()
    return Measured(difference if bounded else math.inf)


def pressed(where: Where) -> Measured:
    """The same at 99 % of the load that buckles the plate."""
    trial = scene_of((15, 13), effects={"tension": {"x": -1.0, "y": -0.4}})
    factor = 0.99 * buckling_factor(make_bending(trial))
    scene = scene_of((15, 13), effects={"tension": {"x": -factor, "y": -0.4 * factor}})
    return _against_numpy(where, stepped(scene, 0.9, 400))


def stretched(where: Where) -> Measured:
    """The same at an amplitude of three thicknesses, with half of the linear limit's step."""
    scene = stepped(scene_of((15, 13), effects={"stretching": {}}), 0.5, 400)
    linear = scene.with_tables(effects={"foundation": {"stiffness": 0.0}})
    amplitude = np.abs(PlateSolver(linear, "cpu").run(DRIVES, (scene.window.end,)).displacement).max()
    return _against_numpy(where, scene, DRIVES * 3 * scene.plate.thickness / amplitude, 0.5)


def rounding(nodes: int, where: Where) -> Measured:
    """Largest difference of displacements from those in float64, relative, on the paper's panel."""
    panel = Scene.load("paper").with_tables(
        grid={"nodes": (nodes, nodes)}, record={}, effects={"damping": {"viscous": 88.0}}
    )
    scene = stepped(panel, 0.9, where.steps(20_000, 800), 290.0)
    drives = np.array([[1.0, 0.3j, -0.5, 0.2]])
    end = (make_scheme(scene).window[1] * make_scheme(scene).time_step,)
    run = where.solver(scene).run(drives, end)
    exact = Where(where.device, "auto", "float64").solver(scene).run(drives, end)
    return Measured(largest_difference(run.displacement, exact.displacement))


CASES = grouped(
    "Inside the plate",
    [
        Case(
            name, "right to rounding, bounded over 10⁵ steps", "difference from NumPy, relative",
            partial(inside, name), both(1e-3, 1e-11), not name.startswith(("thickness jumps 1 : 10 around", "a point")),
        )
        for name in INSIDES
    ]
    + [
        Case(
            "compression at 99 % of buckling", "right to rounding, bounded over 10⁵ steps",
            "difference from NumPy, relative", pressed, both(1e-3, 1e-11), True,
        ),
        Case(
            "stretching at three thicknesses", "right to rounding, bounded over 10⁵ steps",
            "difference from NumPy, relative", stretched, both(1e-3, 1e-10),
        ),
    ]
    + [
        Case(
            f"rounding on {nodes} × {nodes} nodes", "float32 within 10⁻³ of float64 after 20 000 steps",
            "difference, relative",
            partial(rounding, nodes), both(1e-3, 1e-11), nodes > 65,
        )
        for nodes in (65, 129, 257, 513)
    ],
)  # fmt: skip
