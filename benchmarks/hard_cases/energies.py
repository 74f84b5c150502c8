"""Energy that must stay, grow as a resonance does, or die: lossless runs, resonances, damping of any size."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hard_cases.case import Case, Measured, Where, both, grouped, scene_of, stepped, with_end
from warp_plate.plate.bending import make_bending, system
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.scheme import make_scheme

FREE = {
    "clamped": {"edges": ("clamped",) * 4},
    "free edges and a layer": {
        "edges": ("free", "clamped", "free", "free"),
        "effects": {"layers": [{"area": (0, 0.1, 0, 0.2), "thickness": 5e-4, "young_modulus": 1e9, "density": 1e3}]},
    },
}  # fmt: skip
SAMPLES = 40
# What float32 may lose in 10⁶ steps; a plate that is held on one side alone swings wider and loses a little more.
LOST = {"clamped": 1e-5, "free edges and a layer": 2e-5}


def conserved(name: str, where: Where) -> Measured:
    """Largest change of the discrete energy, relative, of a plate that a short burst left ringing without losses."""
    steps = where.steps(1_000_000, 8000)
    scene = stepped(scene_of((13, 13), **FREE[name]), 0.9, steps)  # type: ignore[arg-type]
    step = make_scheme(scene).time_step
    frequency = 1 / (41 * step)
    scene = scene.with_tables(drive={"frequency": frequency, "burst": {"duration": 20 * step}})
    bending = make_bending(scene)
    stiffness, masses = system(scene, bending)
    at = np.unique(np.geomspace(100, steps - 1, SAMPLES).astype(int))
    run = where.solver(scene).run([[1.0, 0.4j]], [n * step for one in at for n in (one, one + 1)])
    moving = run.displacement[0][:, bending.moves]
    before, after = moving[::2], moving[1::2]
    energy = _energy(stiffness, masses, before, after, step)
    change = np.abs(energy / energy[0] - 1)
    return Measured(float(change.max()), (at, np.log10(np.maximum(change, 1e-17)), "step", "log₁₀ |E/E₀ − 1|"))


def _energy(stiffness, masses, before: np.ndarray, after: np.ndarray, step: float) -> np.ndarray:
    """½vᵀMv + ½uᵀKu⁺, which a lossless run keeps up to rounding."""
    speed = (after - before) / step
    return 0.5 * ((speed**2) @ masses + np.einsum("nk,nk->n", before, (stiffness @ after.T).T))


def resonance(where: Where) -> Measured:
    """Slope of the amplitude of an undamped plate driven at its lowest frequency, against p/(2ωρH), relative."""
    patch = (0.05, 0.11, 0.06, 0.12)
    scene = scene_of((27, 27), areas=(patch,))
    tables = {"grid": {"nodes": (27, 27), "load": "overlap"}}
    frequency = natural_modes(with_end(scene, 1e-3), 1).stepped[0]
    periods = where.steps(400, 12)
    scene = scene.with_tables(
        window={"start": 0.0, "end": periods / frequency}, drive={"frequency": frequency}, **tables
    )
    run = where.solver(scene).run([[1.0]], (), [(0.1, 0.1)])
    time, motion = run.trace_times, run.trace[0, 0]
    turn = 2 * math.pi * frequency
    terms = np.stack([time * np.sin(turn * time), time * np.cos(turn * time), np.sin(turn * time), np.cos(turn * time)])
    slope = np.linalg.lstsq(terms.T, motion, rcond=None)[0][0]
    x0, x1, y0, y1 = (math.cos(math.pi * place / 0.2) for place in patch)
    pressure = 4 / math.pi**2 * (x0 - x1) * (y0 - y1)
    scheme = make_scheme(scene)
    exact_turn = 2 * scheme.kappa * (math.pi / 0.2) ** 2
    exact = pressure / (2 * exact_turn * scheme.surface_density)
    every = max(1, len(time) // 400)
    return Measured(abs(slope / exact - 1), (time[::every], motion[::every], "t [s]", "u [m]"))


def damped(kind: str, where: Where) -> Measured:
    """Largest displacement over the static one, for damping from none to 10⁶ times critical, driven below resonance."""
    scene = scene_of((13, 13), areas=((0.05, 0.11, 0.06, 0.12),))
    lowest = natural_modes(with_end(scene, 1e-3), 1).frequencies[0]
    turn, static = 2 * math.pi * lowest, _static(scene)
    factors, reached = np.array([0.0, 1e-3, 0.03, 1.0, 30.0, 1e3, 1e6]), []
    for factor in factors:
        effects = {
            "viscous": {"damping": {"viscous": 2 * 0.5 * turn * factor}},
            "viscous, backward": {"damping": {"viscous": 2 * 0.5 * turn * factor, "scheme": "backward"}},
            "of the material": {"material_damping": {"time": 2 / turn * factor}},
        }[kind]
        trial = scene.with_tables(effects=effects)
        limit = make_scheme(with_end(trial, 1e-6)).limit
        # Three periods of the lowest mode, or as many steps as are quick where steps must be short.
        steps = min(where.steps(400_000, 4000), math.ceil(3 / lowest / (0.9 * limit)))
        run = where.solver(stepped(trial, 0.9, steps, 0.3 * lowest)).run([[1.0]], (), [(0.08, 0.09)])
        reached.append(float(np.abs(run.trace).max()) / static if run.status[0] == "ok" else math.inf)
    labels = np.log10(np.maximum(factors, 1e-5))
    return Measured(max(reached), (labels, np.array(reached), "log₁₀ c/c_crit", "largest u / static"))


def _static(scene) -> float:
    """Static deflection [m] under the first actuator at its middle, from the stiffness matrix."""
    from scipy.sparse.linalg import spsolve

    from warp_plate.plate.weights import bilinear, patches

    bending = make_bending(scene)
    stiffness, _ = system(scene, bending)
    cell = bending.spacing[0] * bending.spacing[1]
    shape = np.zeros(bending.moves.shape)
    shape[bending.moves] = spsolve(stiffness.tocsc(), cell * patches(scene)[0][bending.moves])
    (corners,), (shares,) = bilinear([(0.08, 0.09)], scene.grid.nodes, scene.plate.size)
    return float(sum(shape[j, i] * share for (j, i), share in zip(corners, shares, strict=True)))


CASES = grouped(
    "Energy",
    [
        Case(
            f"lossless: {name}", "discrete energy constant over 10⁶ steps", "largest relative change",
            partial(conserved, name), both(LOST[name], 1e-12), name != "clamped",
        )
        for name in FREE
    ]
    + [
        Case(
            "driven exactly at a resonance", "linear growth, slope within 1 % of exact", "slope, relative error",
            resonance, both(0.01, 0.01),
        )
    ]
    + [
        Case(
            f"damping {kind}, 0 to 10⁶ critical", "bounded: at most what an undamped start overshoots",
            "largest u / static u", partial(damped, kind), both(2.3, 2.3), kind != "viscous",
        )
        for kind in ("viscous", "viscous, backward", "of the material")
    ],
)  # fmt: skip
