"""Launches that are put together and repeated do what they do one by one, whatever else the state ran in between."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from conftest import device_paths

from warp_plate import PlateSolver
from warp_plate.plate.designs import Designs, PerPlate
from warp_plate.solve import cuda, streaming
from warp_plate.solve.launches import repeat

DEVICES = sorted({device for device, _ in device_paths()})
KINDS = {
    "plain": {},
    "fourth order": {"order": 4},
    "with sums": {"effects": {"damping": {"viscous": 50.0}, "stretching": {}, "tension": {"x": 3.0, "y": 1.0}}},
}
ONE_BY_ONE = 10**9


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("device", DEVICES)
def test_together_they_change_no_bit(kind, device, scene, random, monkeypatch):
    """Waves that are shared and of the plates' own, fewer plates and more, traced and not, on one solver in turn."""
    made = scene((9, 9), time_step=5e-5, window=(0.001, 0.0042), drive={"frequency": 290.0}, **KINDS[kind])
    drives = random.uniform(-1, 1, (7, len(made.actuators), 2)) @ [1, 1j]
    own = np.tile(random.uniform(200, 400, (7, 1)), drives.shape[1])
    runs = [
        (drives, []),
        (drives, []),  # with CUDA's buffers turned
        (Designs(drives[:3], own[:3]), []),
        (Designs(drives, own), []),
        (drives[:3], []),
        (drives, [(0.05, 0.11)]),
        (Designs(drives[2:], own[2:]), [(0.05, 0.11)]),
        (drives, []),
    ]
    solvers = [PlateSolver(made, device, "streaming", per_plate=PerPlate(frequency=True)) for _ in range(2)]
    together = [solvers[0].run(given, points=points) for given, points in runs]
    monkeypatch.setattr(streaming, "STEPS", ONE_BY_ONE)
    monkeypatch.setattr(cuda, "LAUNCHES", ONE_BY_ONE)
    for run, (given, points) in zip(together, runs, strict=True):
        right = solvers[1].run(given, points=points)
        assert (right.energy > 0).all()
        np.testing.assert_array_equal(run.energy, right.energy)
        np.testing.assert_array_equal(run.trace, right.trace)
    kept = [[name for name in solver.states[0].beside if isinstance(name, tuple)] for solver in solvers]
    assert kept[0]
    assert not kept[1]


@wp.kernel
def add(before: wp.array[float], after: wp.array[float], more: float):
    after[0] = before[0] + more


@pytest.mark.parametrize("device", DEVICES)
def test_buffers_that_were_left_turned_and_other_numbers_are_told_apart(device):
    u, u_next = (wp.zeros(1, dtype=float, device=device) for _ in range(2))
    state = SimpleNamespace(u=u, u_next=u_next, has_plate_waves=False, beside={})
    wp.load_module(module=add.module, device=device)

    def launches(launch, state, count, more):
        for _ in range(count):
            launch(add, dim=1, inputs=[state.u], outputs=[state.u_next, float(more)], device=device)
            state.u, state.u_next = state.u_next, state.u

    total = 0
    for more in (1, 1, 5, 1, 5, 5, 1):
        repeat(wp.get_device(device), launches, state, 2, more)
        launches(wp.launch, state, 1, more)
        total += 3 * more
    assert state.u.numpy() == [total]
    assert len(state.beside) == 4
