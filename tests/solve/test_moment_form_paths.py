"""The moment-form paths against ``reference.numpy_plate``: random mixes of effects and edges on every device."""

import numpy as np
import pytest

from support.oracle import (
    bending_load,
    check_run,
    check_same,
    random_area,
    random_edge,
    random_effects,
    reference,
    with_all_effects,
)
from warp_plate import PlateSolver
from warp_plate.plate.scheme import make_scheme

# Nodes and sides [m]: odd, even, oblong, and the smallest; cells are square in the first alone.
GRIDS = (
    ((5, 5), (0.2, 0.2)),
    ((13, 11), (0.2, 0.18)),
    ((12, 14), (0.21, 0.2)),
    ((33, 7), (0.24, 0.06)),
    ((6, 26), (0.05, 0.3)),
)
# A plate of several strips and tiles on CUDA.
LARGE = ((131, 71), (0.26, 0.14))
STEPS = 220


def random_drive(random, end, frequency):
    """Draw the [drive] table, with or without chirp, burst and squares, and the frequencies of three actuators."""
    drive = {"frequency": frequency}
    if random.random() < 0.4:
        drive["chirp"] = {"end_frequency": random.uniform(0.3, 1.5) * frequency, "duration": 0.7 * end}
    if random.random() < 0.4:
        drive["burst"] = {"start": 0.1 * end, "duration": 0.5 * end, "ramp": 0.1 * end}
    if random.random() < 0.4:
        drive["electrostatic"] = {"bias": random.choice([0.0, 2.0]), "gain": random.uniform(0.1, 2)}
    apart = random.random() < 0.5
    return drive, random.choice([frequency, 0.7 * frequency, 2 * frequency], 3) if apart else [None] * 3


@pytest.mark.parametrize("number", [n if n < 3 else pytest.param(n, marks=pytest.mark.slow) for n in range(24)])
def test_random_mixes(device, path, number, scene, random, phasors):
    """Every grid in both precisions, near the limit, with other effects each time; every third mix stretches.

    The last four are large plates without the effects that act on patches at every step; the last two are uniform.
    """
    nodes, size = GRIDS[number % len(GRIDS)] if number < 20 else LARGE
    precision, stretching = ("float64", "float32")[number % 2], number % 3 == 2
    asked = {"effects": random_effects(random, size, stretching), "edges": [random_edge(random) for _ in range(4)]}
    left_out = {"oscillators", "moving_load"} if number >= 20 else set()
    left_out |= {"layers", "variation"} if number >= 22 else set()
    asked["effects"] = {name: table for name, table in asked["effects"].items() if name not in left_out}
    asked["actuators"] = [random_area(random, size) for _ in range(3)]
    asked["load"] = ("overlap", "moments")[random.integers(2)]
    step = random.uniform(0.5, 0.9) * make_scheme(scene(nodes, size, **asked)).limit
    drive, frequencies = random_drive(random, STEPS * step, random.uniform(0.005, 0.05) / step)
    if stretching:
        drive.pop("electrostatic", None)  # squares of these drives would be far too large
    window = (STEPS / 3 * step, STEPS * step)
    made = scene(nodes, size, precision=precision, window=window, time_step=step, drive=drive, **asked)
    actuators = zip(made.model_dump()["actuators"], frequencies, strict=True)
    made = made.with_tables(actuators=[{**table, "frequency": frequency} for table, frequency in actuators])
    drives = phasors(2, 3) * (bending_load(made) if stretching else 1)
    times = np.sort(random.uniform(0, 1, 3)) * made.window.end
    points = [(0.0, 0.0), tuple(random.uniform(0, 1, 2) * size)]
    print(made.edges, made.effects, made.drive, made.actuators)
    solver, exact = PlateSolver(made, device, path), reference(made, drives)
    check_run(solver.run(drives, times), made, exact)
    check_run(solver.run(drives, times, points), made, exact, points)


def test_a_plate_does_not_depend_on_its_batch(device, path, scene, phasors):
    """All effects at once; alone, among others, in chunks, after NaN, and beside plates that are not finite."""
    made = with_all_effects(scene((16, 13), (0.2, 0.18), window=(0.002, 0.005)))
    drives, times = phasors(11, 3) * bending_load(made), (0.0, 0.002, 0.0045, 0.005)
    solver, exact = PlateSolver(made, device, path), reference(made, drives)
    together = solver.run(drives, times)
    check_run(together, made, exact)
    assert np.abs(exact[1]).max() > 0.3 * made.plate.thickness
    check_same(solver.run(drives[[10]], times), together, [10])
    check_same(PlateSolver(made, device, path, chunk=4).run(drives, times), together)
    spoiled = solver.run(np.full_like(drives, np.nan), times)
    assert not spoiled.finite.any()
    check_same(solver.run(drives, times), together)
    drives[3], drives[8] = np.nan, 1e300
    mixed, good = solver.run(drives, times), np.delete(np.arange(11), [3, 8])
    assert not mixed.finite[3]
    for name in ("energy", "displacement"):
        np.testing.assert_array_equal(getattr(mixed, name)[good], getattr(together, name)[good])
