"""The load's work equals the energy stored and lost, in the scheme's own energy, step by step.

Multiply a step M (v⁺ − v)/Δt = f − K u − (losses) by Δt v̄, v̄ = (v⁺ + v)/2 = (u⁺ − u⁻)/2Δt: since
vᵀMv changes by 2Δt v̄ᵀM(v⁺ − v)/Δt, and K is symmetric, it says without remainder

    E_{n+½} − E_{n−½} = Δt fᵀv̄ − Δt v̄ᵀ(losses),   E_{n+½} = ½ v⁺ᵀMv⁺ + ½ uᵀKu⁺

for plate and oscillators together. The losses are C v̄ (viscous damping, centred), C v (backward), τK_b v (material)
and, in each damper, d times the last half-step's difference of rates. All is computed from the displacements of all
steps of a run. With stretching, E also has the potential ¼ B (uᵀLu)(u⁺ᵀLu⁺) of N = B uᵀLu, whose change is N's work
only up to the square of the step.
"""

import numpy as np
import pytest

from support.numpy_plate import inverse, make_matrices
from support.oracle import random_edge, random_effects
from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.travelling import moving_weights
from warp_plate.plate.weights import patches, region_weights

STEPS = 400
PARTS = np.linspace(0.05, 1, 20)  # of a run, at which its reach is sampled
SIZES = (((9, 13), (0.2, 0.24)), ((10, 13), (0.05, 0.2)))


@pytest.fixture
def mix(scene, random):
    """A factory of (make, drive); make(step as part of the limit, steps) always makes the same mix."""

    def draw(number, **more):
        nodes, size = SIZES[number % len(SIZES)]
        effects = {**random_effects(random, np.array(size), False, 1.0), **more}
        asked = {"edges": [random_edge(random) for _ in range(4)], "effects": effects}
        asked["load"] = ("overlap", "moments")[random.integers(2)]
        limit, turn = make_scheme(scene(nodes, size, frequency=1.0, **asked)).limit, random.uniform(0.01, 0.05)
        factors = np.array([1.0, 0.6, 1.0])

        def make(part=0.9, steps=STEPS):
            step = part * limit
            frequency = turn * STEPS / steps / step
            made = scene(nodes, size, window=(0.0, steps * step), time_step=step, frequency=frequency, **asked)
            pairs = zip(made.model_dump()["actuators"], factors * frequency, strict=True)
            return made.with_tables(actuators=[{**table, "frequency": tone} for table, tone in pairs])

        return make, random.normal(size=(2, 3)).T @ [1, 1j]

    return draw


def attached_masses(m, u, v, step):
    """Return (steps + 1, oscillators) displacements and last rates of the attached masses, by their equation of motion.

    u, v: (steps + 1, nodes) of the plate, v beginning with that before the first step.
    """
    z, pace = np.zeros((len(u), len(m.attached))), np.zeros((len(u), len(m.attached)))
    for n in range(len(u) - 1):
        push = m.springs * (z[n] - m.shares @ u[n]) + m.dampers * (pace[n] - m.shares @ v[n])
        pace[n + 1] = pace[n] - step * inverse(m.attached) * push
        z[n + 1] = z[n] + step * pace[n + 1]
    return z, pace


def balance(made, drive, device, path):
    """Return (steps,) energy at the half-steps, work done until then and energy lost until then [J]."""
    scheme = make_scheme(made)
    m, step, (nx, ny) = make_matrices(made, scheme), scheme.time_step, scheme.nodes
    run = PlateSolver(made, device, path).run(drive[None], list(step * np.arange(scheme.steps + 1)))
    u = run.displacement[0].reshape(-1, nx * ny)
    v = np.concatenate([np.zeros((1, nx * ny)), np.diff(u, axis=0) / step])
    before, after, centred = v[:-1], v[1:], (v[:-1] + v[1:]) / 2
    z, pace = attached_masses(m, u, v, step)
    apart, rates = z - u @ m.shares.T, pace - v @ m.shares.T
    slopes = np.einsum("nk,nk->n", u, u @ m.slopes)
    stored = 0.5 * (m.mass * after**2).sum(axis=1) + 0.5 * (m.attached * pace[1:] ** 2).sum(axis=1)
    # The window of the run's energy is the whole run.
    cells = scheme.spacing[0] * scheme.spacing[1] * region_weights(made)[0] * scheme.bending.mass
    np.testing.assert_allclose(run.energy[0, 0], 0.5 * (cells.ravel() * after**2).sum() / len(after), rtol=1e-9)
    stored += 0.5 * np.einsum("nk,nk->n", u[:-1] @ (m.bending + m.other), u[1:])
    stored += 0.5 * (m.springs * apart[:-1] * apart[1:]).sum(axis=1) + m.berger / 4 * slopes[:-1] * slopes[1:]
    late = before if scheme.backward else centred
    lost = (m.viscous * centred * late).sum(axis=1)
    lost += m.retardation * np.einsum("nk,nk->n", centred @ m.bending, before)
    lost += (m.dampers * (rates[:-1] + rates[1:]) / 2 * rates[:-1]).sum(axis=1)
    forces = run_forces(made, scheme, drive)
    work = (forces * centred).sum(axis=1)
    return stored, step * np.cumsum(work), step * np.cumsum(lost)


def run_forces(made, scheme, drive):
    """Return (steps, nodes) forces [N] of the actuators under one tone or two, and of the moving load."""
    cell, turns = scheme.spacing[0] * scheme.spacing[1], 2j * np.pi * scheme.time_step * np.arange(scheme.steps)
    frequencies = [actuator.frequency or made.drive.frequency for actuator in made.actuators]
    waves = np.exp(np.outer(turns, frequencies))
    waves[0] /= 2
    forces = cell * np.tensordot((waves * drive).real, patches(made), axes=1)
    if made.effects.moving_load is not None:
        wave, along_x, along_y = moving_weights(made, scheme.time_step, scheme.steps)
        forces += cell * np.einsum("n,nj,ni->nji", wave, along_y, along_x)
    return forces.reshape(scheme.steps, -1)


@pytest.mark.parametrize("number", range(2))
def test_work_is_energy_stored_and_lost(device, path, number, mix):
    """Energy balances to 1e-10 of the work at every step, for linear effects drawn at random."""
    make, drive = mix(number)
    stored, work, lost = balance(make(), drive, device, path)
    scale = np.abs(work).max()
    assert np.abs(work - stored - lost).max() < 1e-10 * scale
    # Below the stability limit no energy is negative.
    assert stored.min() > -1e-12 * scale
    assert work[-1] > 0


def test_work_with_stretching_to_the_order_of_the_step(device, path, mix):
    """The remainder falls with the square of the step; at some thicknesses of motion it is not rounding."""
    make, drive = mix(0, stretching={}, moving_load=None)
    small = PlateSolver(make(), device, path).run(1e-9 * drive[None], list(PARTS * make().window.end))
    drive = drive * 1e-9 * 2 * make().plate.thickness / np.abs(small.displacement).max()
    remainder = []
    for halved in (2, 4):
        stored, work, lost = balance(make(1 / halved, STEPS // 2 * halved), drive, device, path)
        remainder.append(np.abs(work - stored - lost).max() / np.abs(work).max())
    assert 1e-10 < remainder[0] < 0.05
    assert remainder[1] < 0.35 * remainder[0]
