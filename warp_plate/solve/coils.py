"""Numbers of a scene's coils for the kernels, in their scaled units; see ``kernels.coils``."""

from collections.abc import Sequence

import numpy as np

from warp_plate.kernels.coils import BRANCH, NUMBERS
from warp_plate.plate.coils import MountedCoil
from warp_plate.plate.scheme import Scheme


def coil_numbers(scheme: Scheme, coils: Sequence[MountedCoil], pressure_gain: np.ndarray) -> np.ndarray:
    """Return (coils, numbers) of coils where a pressure of one adds ``pressure_gain`` (ny, nx) to the rates."""
    step, cell = scheme.time_step, scheme.spacing[0] * scheme.spacing[1]
    mass = 1 / (scheme.surface_density * cell)  # per kilogram
    damping, stiffness = step * mass, step**2 * mass  # per N·s/m and N/m
    rows, most = [], max((len(mounted.branches) for mounted in coils), default=0)
    for mounted in coils:
        coil, inductive = mounted.coil, mounted.by_voltage and mounted.coil.inductance > 0
        memory = 2 * coil.inductance / step if inductive else 0.0
        halves = [shunt * step / (2 * inductance) for shunt, inductance in mounted.branches]
        weights = [shunt / (1 + half) for (shunt, _), half in zip(mounted.branches, halves, strict=True)]
        conductance = 1 / (coil.resistance + memory + sum(weights)) if mounted.by_voltage else 0.0
        induced = coil.force_factor**2 * conductance
        half = (coil.suspension_damping + induced) * damping / 2
        magnet, own = coil.magnet_mass * mass, coil.magnet_damping * damping / 2
        inverse = 1 / (magnet + own + half) if magnet else 0.0
        resistance = coil.moving_mass * mass + half - inverse * half**2
        response = float((mounted.share**2 * pressure_gain).sum())
        numbers = {
            "stiffness": coil.suspension_stiffness * stiffness,
            "half_damping": half,
            "moving_mass": coil.moving_mass * mass,
            "force": coil.force_factor * (conductance if mounted.by_voltage else 1.0) / cell,
            "memory": memory,
            "magnet": inverse,
            "magnet_decay": magnet - own - half,
            "magnet_stiffness": coil.magnet_stiffness * stiffness,
            "response": response,
            "implicit": 1 / (1 + response * resistance),
            "resistance": resistance,
            "current": conductance,
            "induced": coil.force_factor * scheme.load_scale / step,
            "follow": 2.0 if inductive else 1.0,
        }
        branches = np.zeros((most, BRANCH))
        branches[: len(weights)] = [(weight, 2 * a / (1 + a)) for weight, a in zip(weights, halves, strict=True)] or 0
        rows.append([*(numbers[name] for name in NUMBERS), *branches.ravel()])
    return np.array(rows).reshape(-1, len(NUMBERS) + BRANCH * most)


def largest_rates(scheme: Scheme, coils: Sequence[MountedCoil], pressure_gain: np.ndarray) -> np.ndarray:
    """Return (coils,) norms of the rates that a volt or ampere at each coil adds in a step."""
    numbers = coil_numbers(scheme, coils, pressure_gain)
    forces = np.abs(numbers[:, NUMBERS.index("force")] * numbers[:, NUMBERS.index("implicit")])
    return np.array([force * np.linalg.norm(c.share * pressure_gain) for c, force in zip(coils, forces, strict=True)])
