"""Next to the stability limit: bounded below it, growing as theory says above it."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hard_cases.case import Case, Measured, Where, both, grouped, scene_of, stepped
from warp_plate.plate.bending import make_bending, system
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.model import Scene

SPRINGY = {"translation": 1e5, "rotation": 0.3}
LAYER = {"area": (0.05, 0.12, 0.03, 0.15), "thickness": 3e-4, "young_modulus": 3e9, "density": 2000.0}
OSCILLATORS = [
    {"area": (0.04, 0.09, 0.05, 0.12), "mass": 0.004, "stiffness": 900.0, "damping": 0.02},
    {"area": (0.11, 0.16, 0.1, 0.16), "stiffness": 500.0},
]
ALL = {
    "damping": {"viscous": 0.5},
    "material_damping": {"time": 1e-7},
    "tension": {"x": 5.0, "y": -0.3},
    "foundation": {"stiffness": 1e4, "damping": 0.5},
    "layers": [LAYER],
    "oscillators": OSCILLATORS,
}
# Scenes by name; what makes a kernel of its own is slow the first time.
SCENES: dict[str, dict[str, object]] = {
    "clamped": {"edges": ("clamped",) * 4},
    "supported": {},
    "free": {"edges": ("free",) * 4},
    "springs along the edges": {"edges": (SPRINGY,) * 4},
    "each edge another": {"edges": ("clamped", "free", SPRINGY, "supported")},
    "cells 1 : 10": {"nodes": (9, 15), "size": (0.2, 0.035)},
    "fourth order": {"edges": ("clamped", "supported", "clamped", "supported"), "grid": {"order": 4}},
    "damping, centred": {"effects": {"damping": {"viscous": 0.5}}},
    "damping, backward": {"effects": {"damping": {"viscous": 0.5, "scheme": "backward"}}},
    "material damping": {"effects": {"material_damping": {"time": 1e-7}}},
    "tension": {"effects": {"tension": {"x": 300.0, "y": 40.0}}},
    "bed": {"effects": {"foundation": {"stiffness": 1e6}}},
    "orthotropic": {"effects": {"orthotropic": {"Dx": 0.05, "Dy": 0.004, "D1": 0.003, "Dxy": 0.002}}},
    "layers": {"effects": {"layers": [LAYER]}},
    "oscillators": {"effects": {"oscillators": OSCILLATORS}},
    "all effects": {"edges": ("clamped", "free", SPRINGY, "supported"), "effects": ALL},
}
QUICK = ("clamped", "fourth order", "each edge another", "all effects")
LOSSLESS = ("clamped", "supported", "free", "each edge another", "tension", "layers", "oscillators, no damper")


def made(name: str) -> Scene:
    """A scene of the table on a small grid."""
    if name == "oscillators, no damper":
        free = [{**one, "damping": 0.0} for one in OSCILLATORS]
        return scene_of((13, 13), effects={"oscillators": free})
    return scene_of(**{"nodes": (13, 13), **SCENES[name]})  # type: ignore[arg-type]


def below(name: str, where: Where) -> Measured:
    """Largest speed in the last tenth over the largest in the first tenth, after a push of four steps, which has all
    motions in it up to the fastest."""
    steps = where.steps(100_000, 2000)
    scene = stepped(made(name), 0.999, steps)
    step = make_scheme(scene).time_step
    scene = scene.with_tables(drive={"frequency": scene.drive.frequency, "burst": {"duration": 4 * step}})
    run = where.solver(scene).run([[1.0, 0.4j]], (), [tuple(0.36 * side for side in scene.plate.size)])
    motion = np.abs(np.diff(run.trace[0, 0], prepend=0.0))  # speeds: a free plate may drift
    early, late = motion[: steps // 10].max(), motion[-steps // 10 :].max()
    value = float(late / early) if run.status[0] == "ok" else math.inf
    return Measured(value)


def above(name: str, where: Where) -> Measured:
    """Growth in a step at 1.01 of the true limit against theory: |measured/theory − 1| of the exponents."""
    scene = made(name)
    largest = true_largest(scene)
    part = 1.01 * (2 / math.sqrt(largest)) / make_scheme(scene).limit
    scene = stepped(scene, part, 1500)
    step, (nx, ny) = make_scheme(scene, allow_unstable=True).time_step, scene.grid.nodes
    x, y = (np.linspace(0, side, count) for side, count in zip(scene.plate.size, (nx, ny), strict=True))
    points = [(x[i], y[j]) for i in (nx // 2, nx // 2 + 1) for j in (ny // 2, ny // 2 + 1, 1)]
    run = where.solver(scene, allow_unstable=True).run([[1.0, 0.4j]], (), points)
    if run.status[0] != "grew without bound" or run.faults[0][1] > 500 * step:
        return Measured(math.inf)
    trace = run.trace[0][:, np.isfinite(run.trace[0]).all(axis=0)]
    # Second differences in time make the fastest motion stand out.
    size = np.abs(np.diff(trace, 2, axis=1)).max(axis=0)
    growth = math.log(size[-1] / size[-17]) / 16
    theory = 2 * math.acosh(step * math.sqrt(largest) / 2)
    return Measured(abs(growth / theory - 1))


def true_largest(scene: Scene) -> float:
    """Largest eigenvalue [1/s²] of the scene's matrices, all of them worked out."""
    stiffness, masses = system(make_bending(scene))
    root = np.sqrt(masses)
    return float(np.linalg.eigvalsh(stiffness.toarray() / root / root[:, None])[-1])


CASES = grouped(
    "The stability limit",
    [
        Case(
            f"0.999 of the limit: {name}", "bounded over 10⁵ steps", "largest speed, last tenth / first",
            partial(below, name), both(1.5, 1.5), name not in QUICK,
        )
        for name in SCENES
    ]
    + [
        Case(
            f"1.01 of the limit: {name}", "grows as predicted, and is reported in the plate's status",
            "growth a step, relative error", partial(above, name), both(0.02, 0.02),
            name not in ("clamped", "each edge another"),
        )
        for name in LOSSLESS
    ],
)  # fmt: skip
