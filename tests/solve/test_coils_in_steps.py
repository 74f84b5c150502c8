"""Coils in time steps: against the plain NumPy plate, at the stability limit, and against modes."""

import numpy as np
import pytest

from support.coils import COILS, LOSSLESS_COILS, panel
from support.oracle import check_run, check_same, reference, run_on_a_block
from support.scenes import refused
from warp_plate import PlateSolver
from warp_plate.effects.coil import Coil, catalogue
from warp_plate.modal.coils_in_time import in_time
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.motion import trace
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.coils import rational_keys
from warp_plate.plate.scheme import make_scheme

DRIVES = np.random.default_rng(4).normal(size=(3, 4, 2)) @ [1, 1j]


def edges(*conditions):
    return dict(zip(("left", "bottom", "right", "top"), conditions, strict=True))


def stepped(nodes=(15, 12), steps=150, part=0.8, actuators=LOSSLESS_COILS, precision="float64", **tables):
    """Return a panel with coils on a grid, stepped at a part of its limit."""
    made = panel(actuators).with_tables(grid={"nodes": nodes, "precision": precision}, **tables)
    step = part * make_scheme(made).limit
    grid = {"nodes": nodes, "precision": precision, "time_step": step}
    return made.with_tables(grid=grid, window={"start": step * steps / 3, "end": step * steps})


EFFECTS = {
    "alone": {},
    "all": {
        "damping": {"viscous": 30.0, "scheme": "backward"},
        "material_damping": {"time": 1e-6},
        "tension": {"x": 20.0, "y": 10.0},
        "oscillators": [{"area": (0.03, 0.09, 0.03, 0.09), "mass": 0.003, "stiffness": 300.0, "damping": 0.5}],
    },
}


@pytest.mark.parametrize(("effects", "precision"), [("alone", "float32"), ("all", "float64")])
def test_coils_step_as_in_the_plain_plate(device, path, effects, precision):
    made = stepped(precision=precision, effects=EFFECTS[effects], edges=edges("free", "clamped", "supported", "free"))
    exact, times, points = reference(made, DRIVES), [0.5 * made.window.end, made.window.end], [(0.05, 0.06)]
    solver = PlateSolver(made, device, path)
    run = solver.run(DRIVES, times, points)
    check_run(run, made, exact, points)
    check_same(solver.run(DRIVES[[2]], times), solver.run(DRIVES, times), [2])


@pytest.mark.parametrize("planes", [(), pytest.param(("rate", "squares", "u"), marks=pytest.mark.slow)])
def test_the_block_path_steps_coils(monkeypatch, planes):
    run_on_a_block(monkeypatch, planes)
    made = stepped((9, 8), 40, effects=EFFECTS["all"])
    check_run(PlateSolver(made, "cpu").run(DRIVES, [made.window.end]), made, reference(made, DRIVES))


def random_coil(random, name, place):
    """Return a coil with numbers over several decades, driven by a voltage or a current."""
    magnet = random.choice(["fixed", "free", "sprung"])
    keys = {"magnet_mass": 10 ** random.uniform(-4, -1), "magnet_stiffness": 10 ** random.uniform(1, 5)}
    keys["magnet_damping"] = random.uniform(0, 3)
    used = dict(list(keys.items())[: {"fixed": 0, "free": 1, "sprung": 3}[magnet]])
    return {
        "name": name,
        "kind": "coil",
        "disc": (*place, 0.012),
        "force_factor": random.uniform(-9, 9),
        "resistance": 10 ** random.uniform(-1, 2),
        "inductance": random.choice([0.0, 10 ** random.uniform(-6, -2)]),
        "eddy_branches": (10 ** random.uniform((-2, -6), (2, -2), (random.integers(4), 2))).tolist(),
        "moving_mass": random.choice([0.0, 10 ** random.uniform(-5, -1)]),
        "suspension_stiffness": 10 ** random.uniform(1, 6),
        "suspension_damping": random.uniform(0, 3),
        "magnet": magnet,
        random.choice(["voltage", "current"]): 1.0,
        **used,
    }


@pytest.mark.parametrize("seed", [n if n < 2 else pytest.param(n, marks=pytest.mark.slow) for n in range(30)])
def test_random_coils_step_as_in_the_plain_plate(device, path, seed):
    random = np.random.default_rng(seed)
    places = [(0.04, 0.05), (0.1, 0.11), (0.16, 0.05)]
    made = stepped((15, 12), 100, 0.999, [random_coil(random, str(index), at) for index, at in enumerate(places)])
    run = PlateSolver(made, device, path).run(DRIVES[:, :3], [made.window.end])
    check_run(run, made, reference(made, DRIVES[:, :3]))


# Without losses; the suspension of the last, on a plate of 86 g, sets the limit.
LIMITED = {
    "soft": {"suspension_stiffness": 3e3, "moving_mass": 2e-3, "magnet": "free", "magnet_mass": 0.05},
    "stiff": {"suspension_stiffness": 4e6, "moving_mass": 5e-3},
    "framed": {
        "suspension_stiffness": 2e6,
        "moving_mass": 5e-3,
        "magnet": "sprung",
        "magnet_mass": 1e-3,
        "magnet_stiffness": 2e6,
    },
}


@pytest.mark.parametrize("inductance", [0.0, 1e-3])
@pytest.mark.parametrize("limited", LIMITED)
def test_the_limit_is_exact(limited, inductance):
    """Over 100 000 steps just below it, motion stays bounded; just above it, it grows."""
    keys = {"name": "0", "kind": "coil", "disc": (0.1, 0.08, 0.03), "voltage": 1.0, "force_factor": 0.05}
    coil = {**keys, "resistance": 50.0, "inductance": inductance, **LIMITED[limited]}
    tables = {"effects": {}, "edges": edges(*("supported",) * 4)}
    made = stepped((9, 8), 100_000, 0.999, [coil], **tables)
    limit = make_scheme(made).stability
    assert (limit.shares.get("coils", 0.0) > 0.5) == (limited != "soft")
    energies = []
    for steps in (1_000, 100_000):
        window = {"start": 0.0, "end": steps * made.grid.time_step}
        energies.append(PlateSolver(made.with_tables(window=window), "cpu").run([[1.0]]).energy[0, 0])
    assert energies[1] < 4 * energies[0]
    above = made.with_tables(
        grid={"nodes": (9, 8), "precision": "float64", "time_step": 1.01 * limit.time_step},
        window={"start": 0.0, "end": 3_000 * limit.time_step},
    )
    grown = PlateSolver(above, "cpu", allow_unstable=True).run([[1.0]]).energy[0, 0]
    assert not grown < 1e6 * energies[0]


def test_steps_meet_the_modes_at_second_order():
    """With halved spacings and quartered steps, traces differ from those by modes by a quarter; two of the coils have
    shunted inductors, one of them a further inductance."""
    tables = {"edges": edges("clamped", "supported", "clamped", "supported")}
    tables |= {"drive": {"frequency": 60.0, "ramp": 0.01}, "window": {"start": 0.0, "end": 0.03}}
    coils = [{**row, "eddy_branches": [(0.4, 2e-4), (2.0, 1e-4)]} if "model" in row else row for row in COILS]
    points, drive = [(0.1, 0.08), (0.05, 0.04)], np.array([[2.0, 2.0, 0.3, 300.0]])
    errors = []
    for nodes in ((21, 17), (41, 33)):
        made = panel(coils).with_tables(grid={"nodes": nodes, "precision": "float64", "modal_density": 0.5}, **tables)
        run = PlateSolver(made, "cpu").run(drive, [], points)
        exact = ModalSolver(made, "cpu").run(drive, [], points)
        np.testing.assert_allclose(run.trace_times, exact.trace_times)
        errors.append(np.abs(run.trace - exact.trace).max() / np.abs(exact.trace).max())
    assert errors[1] < 0.03
    assert 3 < errors[0] / errors[1] < 6


def test_shunted_inductors_stand_for_a_lossy_inductance():
    """Motion long after the start is the steady one of the powers, but for the error of the circuit."""
    keys, error = rational_keys(Coil(**catalogue()["DAEX25FHE-4"]), 20.0, 2000.0, count=4)
    assert error < 0.003
    coil = {"kind": "coil", "name": "0", "model": "DAEX25FHE-4", "voltage": 2.0, "disc": (0.07, 0.09, 0.012)}
    lossy, circuit = (panel([{**coil, **more}], damping=200.0) for more in ({}, keys))
    omega, phasors = 2 * np.pi * 290.0, np.array([2.0])
    motion = [
        solve_modes(made, 290.0).respond_to_drive(np.array([290.0]), phasors)[0, :, 0] for made in (lossy, circuit)
    ]
    assert np.linalg.norm(motion[1] - motion[0]) < error * np.linalg.norm(motion[0])
    plate, times = in_time(solve_modes(circuit, 290.0).part(np.arange(60))), np.linspace(0.4, 0.41, 21)
    found, steady = (
        trace(plate, phasors[None], [(0.05, 0.06)], times)[0],
        solve_modes(circuit, 290.0).part(np.arange(60)),
    )
    amplitude = steady.at_points([(0.05, 0.06)]).T @ steady.respond_to_drive(np.array([290.0]), phasors)[0, :, 0]
    expected = (amplitude[:, None] * np.exp(1j * omega * times)).real
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_powers_that_no_passive_circuit_has_leave_an_error():
    _, error = rational_keys(Coil(**catalogue()["XT25-4"]), 20.0, 2000.0, 8)
    assert error > 0.3


def test_a_lossy_inductance_is_not_stepped():
    made = panel().with_tables(grid={"nodes": (15, 12)})
    line = refused(make_scheme, made)
    assert line == (
        "actuators[0].eddy_resistance: a lossy inductance cannot be stepped in time; use the evaluator "
        '"modal", or write eddy_branches in place of eddy_resistance and eddy_reactance'
    )


def test_coils_that_share_nodes_are_not_stepped():
    beside = {**LOSSLESS_COILS[2], "name": "beside", "disc": (0.145, 0.06, 0.01)}
    line = refused(stepped, actuators=[LOSSLESS_COILS[2], beside])
    assert line == (
        "actuators[1].kind: the coil shares nodes of the grid with that of actuators[0]; move them apart, use more "
        'nodes, or the evaluator "modal"'
    )
