"""The same plate in other units and shapes: its dimensionless answer must not change, nor numbers overflow."""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from hard_cases.case import PANEL, Case, Measured, Where, both, grouped, largest_difference, scene_of
from support.numpy_plate import run_moment_form
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.model import Scene

STEPS = 600
# Copies of the drives and runs of which the shortest counts, where runs are timed.
COPIES, REPEATS = 128, 20
DRIVES = np.array([[1.0, 0.4j], [0.2 - 0.5j, 1.0]])
SIZES = {
    "thickness 10 µm to 10 mm": ("thickness", np.geomspace(1e-5, 1e-2, 7)),
    "E 1 MPa to 1 TPa": ("young_modulus", np.geomspace(1e6, 1e12, 7)),
    "density 1 to 10⁵ kg/m³": ("density", np.geomspace(1.0, 1e5, 6)),
    "drives 10⁻¹⁵ to 10¹⁵": ("drive", np.geomspace(1e-15, 1e15, 7)),
}
KINDS: dict[str, dict[str, object]] = {
    "": {"edges": ("clamped", "supported", "clamped", "supported")},
    ", free edges": {"edges": ("free", "clamped", "free", "free")},
}


def like(kind: str, plate: dict[str, float]) -> Scene:
    """The same scene in other units: its frequencies, window and step follow √(D/ρH)."""
    tables = {"nodes": (13, 13), **KINDS[kind], "plate": plate}
    trial = scene_of(**tables, window={"start": 0.0, "end": 1e-9}, drive={"frequency": 1.0})  # type: ignore[arg-type]
    kappa = make_scheme(trial).kappa
    unit = 0.2**2 / kappa  # time
    end = 0.3 * unit
    return scene_of(
        **tables, window={"start": 0.6 * end, "end": end}, drive={"frequency": 12 / unit},
        grid={"time_step": end / STEPS},
    )  # type: ignore[arg-type]  # fmt: skip


def answer(where: Where, scene: Scene, drives: np.ndarray) -> np.ndarray:
    """Localization factors and displacements in units of drive / (ρH ω²), in one line."""
    run = where.solver(scene).run(drives, (scene.window.end / 2, scene.window.end))
    scheme = make_scheme(scene)
    unit = np.abs(drives).max() / (scheme.surface_density * scheme.angular_frequency**2)
    return np.concatenate([localization_factor(run.energy), (run.displacement / unit).ravel()])


def slowdown(where: Where, usual: tuple[Scene, np.ndarray], other: tuple[Scene, np.ndarray]) -> float:
    """Time of one scene with its drives, many times over, over another's: the shortest runs of each, by turns."""
    # A GPU's time is the clock's; a CPU's own leaves out what other programs take.
    clock = time.perf_counter if where.device.startswith("cuda") else time.process_time
    taken: tuple[list[float], list[float]] = [], []
    pairs = [(where.solver(scene), np.tile(drives, (COPIES, 1))) for scene, drives in (usual, other)]
    for _ in range(REPEATS):
        for (solver, drives), times in zip(pairs, taken, strict=True):
            started = clock()
            solver.run(drives)
            times.append(clock() - started)
    return min(taken[1]) / min(taken[0])


def scaled(name: str, kind: str, where: Where) -> Measured:
    """Largest difference from the panel as it is, relative; and, of a long form, the longest time over the panel's."""
    key, sizes = SIZES[name]
    own = like(kind, dict(PANEL))
    base = answer(where, own, DRIVES)
    found, taken = [], []
    for size in sizes:
        scene = own if key == "drive" else like(kind, {**PANEL, key: size})
        drives = DRIVES * (size if key == "drive" else 1.0)
        found.append(largest_difference(answer(where, scene, drives), base))
        taken += [slowdown(where, (own, DRIVES), (scene, drives))] if where.long else []
    found = np.array(found)
    return Measured(float(found.max()), max(taken, default=None))


SHAPES: dict[str, dict[str, object]] = {
    "aspect 1 : 50": {"nodes": (101, 7), "size": (1.0, 0.02)},
    "cells 1 : 10": {"nodes": (7, 31), "size": (0.3, 0.15)},
}


def shaped(name: str, where: Where) -> Measured:
    """Largest difference from the NumPy reference, relative; a soft bed makes the reference of all effects serve."""
    made = scene_of(**SHAPES[name], effects={"foundation": {"stiffness": 1.0}})  # type: ignore[arg-type]
    limit = make_scheme(made.with_tables(window={"start": 0.0, "end": 1e-6}, drive={"frequency": 1.0})).limit
    step = 0.9 * limit
    made = made.with_tables(
        grid={**made.grid.model_dump(exclude={"accuracy"}), "time_step": step}, drive={"frequency": 1 / (80 * step)},
        window={"start": 0.0, "end": STEPS * step},
    )  # fmt: skip
    run = where.solver(made).run(DRIVES, (STEPS * step,))
    exact = run_moment_form(made, DRIVES)
    return Measured(largest_difference(run.displacement[:, 0], exact.displacement[:, -1]))


CASES = grouped(
    "Units and shapes",
    [
        Case(
            name + kind, "the same dimensionless answer, no overflow, no slow-down",
            "largest relative difference (longest time / the panel's own)",
            partial(scaled, name, kind), both(1e-5, 1e-13), bool(kind) or name.startswith("density"),
        )
        for kind in KINDS
        for name in SIZES
    ]
    + [
        Case(name, "right to rounding", "difference from NumPy, relative", partial(shaped, name), both(3e-4, 1e-11))
        for name in SHAPES
    ],
)  # fmt: skip
