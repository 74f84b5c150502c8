"""Energy that must stay, grow as a resonance does, or die: lossless runs, resonances, damping of any size."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from scipy.sparse.linalg import spsolve

from hard_cases.case import Case, Measured, Where, both, grouped, largest_difference, scene_of, stepped, with_end
from support.grid_modes import natural_modes
from warp_plate.plate.bending import make_bending, system
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.weights import bilinear, patches
from warp_plate.scene.model import Scene

FREE = {
    "clamped": {"edges": ("clamped",) * 4},
    "free edges and a layer": {
        "edges": ("free", "clamped", "free", "free"),
        "effects": {"layers": [{"area": (0, 0.1, 0, 0.2), "thickness": 5e-4, "young_modulus": 1e9, "density": 1e3}]},
    },
}  # fmt: skip
SAMPLES, DRAWN = 40, 16
FACTORS = np.array([0.0, 1e-3, 0.03, 1.0, 30.0, 1e3, 1e6])
KINDS = ("viscous", "viscous, backward", "of the material")
# The backward form is of first order in the step; explicit damping of the material takes its rate half a step early.
FOLLOWS = {"viscous": 1e-3, "viscous, backward": 0.006, "of the material": 2e-3}


def conserved(name: str, where: Where) -> Measured:
    """Largest change of the discrete energy, relative, of plates that a short burst left ringing without losses.

    In float32 it walks at random, so the root mean square of many plates is what another machine would find as well.
    """
    steps = where.steps(1_000_000, 3000)
    scene = stepped(scene_of((13, 13), **FREE[name]), 0.9, steps)  # type: ignore[arg-type]
    step = make_scheme(scene).time_step
    frequency = 1 / (41 * step)
    scene = scene.with_tables(drive={"frequency": frequency, "burst": {"duration": 20 * step}})
    bending = make_bending(scene)
    stiffness, masses = system(bending)
    at = np.unique(np.geomspace(100, steps - 1, SAMPLES).astype(int))
    random = np.random.default_rng(1)
    drives = random.normal(size=(DRAWN, 2)) + 1j * random.normal(size=(DRAWN, 2))
    run = where.solver(scene).run(drives, [n * step for one in at for n in (one, one + 1)])
    energies = []
    for displacement in run.displacement:
        moving = displacement[:, bending.moves]
        energies.append(_energy(stiffness, masses, moving[::2], moving[1::2], step))
    change = np.abs(np.array(energies) / np.array(energies)[:, :1] - 1)
    return Measured(float(_root_mean_square(change.max(axis=1))))


def _root_mean_square(values: np.ndarray) -> np.ndarray:
    """Return the root mean square of each row."""
    return np.sqrt((values**2).mean(axis=0))


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
    return Measured(abs(slope / exact - 1))


def damped(kind: str, where: Where) -> Measured:
    """Largest displacement over the static one, for damping from none to 10⁶ times critical, driven below resonance."""
    scene = scene_of((13, 13), areas=((0.05, 0.11, 0.06, 0.12),))
    lowest = natural_modes(with_end(scene, 1e-3), 1).frequencies[0]
    static = _static(scene)
    reached = []
    for factor in FACTORS:
        trial = _damped_run(scene, kind, factor, lowest, where.steps(400_000, 4000))
        run = where.solver(trial).run([[1.0]], (), [(0.08, 0.09)])
        reached.append(float(np.abs(run.trace).max()) / static if run.status[0] == "ok" else math.inf)
    return Measured(max(reached))


def followed(kind: str, where: Where) -> Measured:
    """The same runs: largest difference of the lowest mode's motion, from rest on, from that of the exact damped
    oscillator q̈ + γq̇ + ω²q = p cos Ωt, relative to its largest."""
    scene = scene_of((13, 13), areas=((0.05, 0.11, 0.06, 0.12),))
    found = natural_modes(with_end(scene, 1e-3), 1)
    lowest, shape = found.frequencies[0], found.shapes[0]
    turn = 2 * math.pi * lowest
    weight = shape / (shape**2).sum()  # nodes of a supported plate that move have equal masses
    push = float((weight * patches(scene)[0]).sum()) / make_scheme(scene).surface_density
    apart = []
    for factor in FACTORS:
        trial = _damped_run(scene, kind, factor, lowest, where.steps(40_000, 4000))
        scheme = make_scheme(trial)
        times = scheme.time_step * np.unique(np.linspace(1, scheme.window[1], SAMPLES).astype(int))
        run = where.solver(trial).run([[1.0]], times)
        motion = (weight * run.displacement[0]).sum(axis=(1, 2))
        exact = push * oscillator(times, 2 * turn * factor, turn, 2 * math.pi * 0.3 * lowest)
        apart.append(largest_difference(motion, exact))
    return Measured(max(apart))


def oscillator(times: np.ndarray, loss: float, turn: float, driven: float) -> np.ndarray:
    """(times,) solution of q̈ + loss·q̇ + turn²·q = cos(driven·t) from rest."""
    steady = 1 / (turn**2 - driven**2 + 1j * driven * loss)
    root = np.emath.sqrt(loss**2 / 4 - turn**2)
    # The slow one of the two, without the difference of large numbers.
    fast, slow = -loss / 2 - root, -(turn**2) / (loss / 2 + root)
    apart = slow - fast
    kick = (np.exp(slow * times) - np.exp(fast * times)) / apart if apart else times * np.exp(slow * times)
    start, speed = -steady.real, (-1j * driven * steady).real
    free = start * np.exp(slow * times) + (speed - slow * start) * kick
    return (steady * np.exp(1j * driven * times)).real + np.real(free)


def _damped_run(scene: Scene, kind: str, factor: float, lowest: float, most: int) -> Scene:
    """The scene with a part of the critical damping of its lowest mode [Hz], driven at 0.3 of that, over three of its
    periods, or the most steps where these must be short."""
    turn = 2 * math.pi * lowest
    effects = {
        "viscous": {"damping": {"viscous": 2 * 0.5 * turn * factor}},
        "viscous, backward": {"damping": {"viscous": 2 * 0.5 * turn * factor, "scheme": "backward"}},
        "of the material": {"material_damping": {"time": 2 / turn * factor}},
    }[kind]
    trial = scene.with_tables(effects=effects)
    limit = make_scheme(with_end(trial, 1e-6)).limit
    steps = min(most, math.ceil(3 / lowest / (0.9 * limit)))
    return stepped(trial, 0.9, steps, 0.3 * lowest)


def _decades() -> np.ndarray:
    return np.log10(np.maximum(FACTORS, 1e-5))


def _static(scene) -> float:
    """Static deflection [m] under the first actuator at its middle, from the stiffness matrix."""
    bending = make_bending(scene)
    stiffness, _ = system(bending)
    cell = bending.spacing[0] * bending.spacing[1]
    shape = np.zeros(bending.moves.shape)
    shape[bending.moves] = spsolve(stiffness.tocsc(), cell * patches(scene)[0][bending.moves])
    (corners,), (shares,) = bilinear([(0.08, 0.09)], scene.grid.nodes, scene.plate.size)
    return float(sum(shape[j, i] * share for (j, i), share in zip(corners, shares, strict=True)))


CASES = grouped(
    "Energy",
    [
        Case(
            f"lossless: {name}", "discrete energy constant over 10⁶ steps",
            f"largest relative change, root mean square of {DRAWN} drives",
            partial(conserved, name), both(3e-5, 1e-12), name != "clamped",
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
            f"damping {kind}, 0 to 10⁶ critical", "bounded by the overshoot of an undamped start",
            "largest u / static u", partial(damped, kind), both(2.3, 2.3), kind != "viscous",
        )
        for kind in KINDS
    ]
    + [
        Case(
            f"exact decay: damping {kind}, 0 to 10⁶ critical", "the motion of an exact oscillator from rest",
            "lowest mode, difference, relative", partial(followed, kind), both(FOLLOWS[kind], FOLLOWS[kind]),
            kind != "viscous, backward",
        )
        for kind in KINDS
    ],
)  # fmt: skip
