"""Frequency responses of panels by time stepping alone.

A loss factor has no motion in time, and the grid's damping has an error of its own. Neither is stepped: with

    s² = (ic ω / ρH − ω²) / (1 + iη),     K (1 + iη) + iω C − ω² M = (1 + iη) (K + s² M),

so the response of a plate with viscous damping c or a loss factor η is 1 / (1 + iη) times the transfer function of the
*undamped* plate at the complex frequency s: the ratio of the Laplace transforms of sensor and force in one run from
rest, whose end e^(−st) makes small. (Springs have no loss, so that panels with springs have η = 0.) Leapfrog steps have
(2/Δt · sinh(sΔt/2))² in place of s²; taken at the s for which that is right, they have no error in time.

The error of the grid moves resonances. So responses of several grids are continued to h² = 0 by rational functions, and
frequencies at which the finest grids do not agree with all of them are left out.
"""

import math

import numpy as np

from fits.panels import Panel
from warp_plate import PlateSolver, Scene

# Cells of the grids in a cell of the lattice, and poles of the rational functions of h².
GRIDS, POLES = (4, 5, 6, 7), 2
# What is left of the motion at the end of a run; steps transformed at a time.
REST, BLOCK = 1e-4, 512
# Most that responses of all grids and of the finest three may differ by, relative.
TOLERANCE = 1e-3


def stepped_responses(panel: Panel, device: str = "cpu") -> tuple[np.ndarray, np.ndarray, float]:
    """Return the frequencies (n,) that are kept [Hz], accelerances (sensors, n), and how far the grids differ (rms)."""
    scene, omega = panel.scene, 2 * math.pi * panel.frequencies
    effects, plate = scene.effects, scene.plate
    loss = 1 + 1j * (effects.loss_factor.eta if effects.loss_factor else 0.0)
    decay = effects.damping.viscous / (plate.density * plate.thickness) if effects.damping else 0.0
    frequency = np.sqrt((1j * decay * omega - omega**2) / loss)
    end = -math.log(REST) / frequency.real.min()
    grids = [_lossless(panel, cells, end) for cells in GRIDS]
    found = [transfer_functions(grid, frequency, device) for grid in grids]
    best, finest = (extrapolated(GRIDS[first:], found[first:]) for first in (0, 1))
    apart = np.abs(np.log(best / finest))
    kept = apart.max(axis=0) < TOLERANCE
    return panel.frequencies[kept], (-(omega**2) * best / loss)[:, kept], float(np.sqrt(np.mean(apart[:, kept] ** 2)))


def _lossless(panel: Panel, cells: int, end: float) -> Scene:
    """Return the scene without damping on a grid."""
    return panel.scene.with_tables(
        grid={"nodes": [1 + cells * count for count in panel.lattice], "precision": "float64"},
        window={"start": 0.0, "end": end},
        drive={"frequency": float(np.median(panel.frequencies))},
        effects={},
    )


def transfer_functions(scene: Scene, frequency: np.ndarray, device: str = "cpu") -> np.ndarray:
    """Return the receptances (sensors, n) of a scene's grid at complex frequencies s (n,) [rad/s]."""
    solver = PlateSolver(scene, device, threads=1)
    step, (x0, x1, y0, y1) = solver.scheme.time_step, scene.actuators[0].area
    motion = solver.run([[1.0]], points=[each.point for each in scene.measurement]).trace[0]
    force = (x1 - x0) * (y1 - y0) * np.cos(2 * math.pi * scene.drive.frequency * step * np.arange(motion.shape[1]))
    force[0] /= 2  # the first step, from rest, counts half
    stepped = 2 / step * np.arcsinh(frequency * step / 2)
    late = np.exp(-stepped * step)  # traces begin with the end of the first step
    return late * laplace(motion, step, stepped) / laplace(force[None], step, stepped)


def laplace(signals: np.ndarray, step: float, frequency: np.ndarray) -> np.ndarray:
    """Return Σ x_j exp(−s j Δt) of signals (count, steps) at complex frequencies s (n,)."""
    blocks = np.pad(signals, ((0, 0), (0, -signals.shape[1] % BLOCK))).reshape(len(signals), -1, BLOCK)
    inside = np.exp(-step * frequency * np.arange(BLOCK)[:, None])
    starts = np.exp(-step * BLOCK * frequency * np.arange(blocks.shape[1])[:, None])
    return np.einsum("cbn,bn->cn", blocks @ inside, starts)


def extrapolated(cells: tuple[int, ...], found: list[np.ndarray]) -> np.ndarray:
    """Return responses (sensors, n) at h² = 0 from those of grids.

    At each frequency the responses of all sensors are P(h²) / Q(h²) with a common denominator, that of resonances which
    move with h. Q, of degree POLES with Q(0) = 1, makes the highest divided differences of Q times the responses
    smallest, which should be zero; P interpolates.
    """
    spacing = (cells[-1] / np.array(cells)) ** 2
    others = [np.delete(spacing, index) for index in range(len(spacing))]
    divided = [1 / np.prod(each - rest) for each, rest in zip(spacing, others, strict=True)]
    at_zero = [np.prod(rest / (rest - each)) for each, rest in zip(spacing, others, strict=True)]
    powers = spacing ** np.arange(POLES + 1)[:, None]
    responses = np.array(found)
    differences = np.einsum("pg,g,gsn->nsp", powers, divided, responses)
    differences /= np.abs(responses).mean(axis=(0, 2))[:, None]
    poles = -(np.linalg.pinv(differences[..., 1:]) @ differences[..., :1])[..., 0]
    denominators = 1 + poles @ powers[1:]
    return np.einsum("g,ng,gsn->sn", at_zero, denominators, responses)
