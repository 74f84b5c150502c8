"""Launches that are recorded and repeated do what they do one by one, whatever else the state ran in between."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from conftest import device_paths

from warp_plate import PlateSolver
from warp_plate.plate.designs import Designs, PerPlate
from warp_plate.solve.streaming import repeat

DEVICES = sorted({device for device, _ in device_paths()})
KINDS = {
    "fourth order": {"order": 4},
    "with sums": {"effects": {"damping": {"viscous": 50.0}, "stretching": {}, "tension": {"x": 3.0, "y": 1.0}}},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("device", DEVICES)
def test_a_run_does_not_depend_on_recorded_launches(kind, device, scene, random):
    """Shared waves and waves per plate, fewer plates and more, traced and not: on one solver, and each on a new one."""
    made = scene((9, 9), time_step=5e-5, window=(0.001, 0.0042), drive={"frequency": 290.0}, **KINDS[kind])
    drives = random.uniform(-1, 1, (7, len(made.actuators), 2)) @ [1, 1j]
    frequency = np.tile(random.uniform(200, 400, (7, 1)), drives.shape[1])
    runs = [
        (drives, []),
        (drives, []),  # with CUDA's buffers in the other turn
        (Designs(drives[:3], frequency[:3]), []),
        (Designs(drives, frequency), []),
        (drives[:3], []),
        (drives, [(0.05, 0.11)]),
        (Designs(drives[2:], frequency[2:]), [(0.05, 0.11)]),
        (drives, []),
    ]
    solver = PlateSolver(made, device, "streaming", per_plate=PerPlate(frequency=True))
    for plates, points in runs:
        run = solver.run(plates, points=points)
        alone = PlateSolver(made, device, "streaming", per_plate=PerPlate(frequency=True)).run(plates, points=points)
        assert (alone.energy > 0).all()
        np.testing.assert_array_equal(run.energy, alone.energy)
        np.testing.assert_array_equal(run.trace, alone.trace)


@wp.kernel
def add(before: wp.array[float], after: wp.array[float], more: float):
    after[0] = before[0] + more


@pytest.mark.parametrize("device", DEVICES)
def test_recordings_differ_by_buffers_and_numbers(device):
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
