"""Searches under limits of coils: bounds that a drive reaches and none of 100,000 passes; refusals."""

import math

import numpy as np
import pytest

from support.coils import EXCITER, LOSSLESS_COILS, SPRUNG, dense_motion, panel
from support.scenes import refused, scene_of
from warp_plate import localize
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.designs import Designs
from warp_plate.problem.methods import resolve_search
from warp_plate.problem.problem import make_problem

VOLTS = [
    {**EXCITER, "name": "fixed", "disc": (0.05, 0.06, 0.012)},
    {**EXCITER, **SPRUNG, "name": "sprung", "area": (0.11, 0.13, 0.1, 0.13), "inductance": 2e-4},
    {**EXCITER, "name": "far", "disc": (0.15, 0.04, 0.01), "resistance": 6.0},
]
AMPERES = [{**row, "voltage": None, "current": 0.3} for row in VOLTS]
FREE = {"magnitude": {"range": (0.0, 20.0)}, "phase": {}}


def limited(actuators, objective, search=FREE, **limits):
    """Return a panel of coils whose search has one objective and limits."""
    return panel(actuators).with_tables(search={**search, "objectives": [objective], "limits": limits})


SCENES = {
    "stroke": lambda: limited(VOLTS, {"kind": "localization"}, least_velocity=5e-3, stroke=3e-6),
    "current and heat": lambda: limited(
        VOLTS, {"kind": "contrast"}, least_velocity=0.02, current=0.015, heat=4e-4, voltage=0.2
    ),
    "velocity": lambda: limited(VOLTS, {"kind": "velocity", "rest_limit": 0.1}, stroke=4e-5, heat=0.05),
    "driven by currents": lambda: limited(AMPERES, {"kind": "velocity"}, voltage=1.0, stroke=8e-5, sound=90.0),
}


class Judge:
    """Motion of unit drives by one system of modes, magnets and currents, without the Gram matrices of the search."""

    def __init__(self, scene):
        self.scene, self.limits = scene, scene.search.limits
        plate, self.omega = solve_modes(scene), 2 * math.pi * scene.drive.frequency
        self.forms, columns = {}, []
        for unit in np.eye(len(scene.actuators)):
            alone = scene
            for actuator, value in zip(scene.actuators, unit.tolist(), strict=True):
                alone = alone.replace(
                    f"actuators.{actuator.name}.{'voltage' if actuator.voltage else 'current'}", value
                )
            columns.append([value.ravel() for value in self.motion_of(alone)])
        modes, self.stroke, self.current, self.voltage = (np.stack(part, axis=1) for part in zip(*columns, strict=True))
        for name, region in (("plate", "plate"), ("target", scene.target)):
            self.forms[name] = self.omega**2 * modes.conj().T @ plate.kinetic_matrix(region) @ modes / 4
        sizes = make_problem(resolve_search(scene, "cpu", evaluator="modal")).objectives.sizes
        self.areas, self.masses = sizes.areas, sizes.masses
        self.resistance = [row.coil.blocked_impedance(np.array([self.omega]))[0].real for row in scene.actuators]

    def motion_of(self, scene):
        """Return modes, strokes, currents and voltages of the coils under the scene's drive."""
        plate = solve_modes(scene)
        modes, magnets, currents = dense_motion(plate, self.omega)
        stroke = plate.coils.means.T @ modes - magnets
        rows = [actuator.coil for actuator in scene.actuators]
        blocked = np.array([coil.blocked_impedance(np.array([self.omega]))[0] for coil in rows])
        factor = np.array([coil.force_factor for coil in rows])
        return modes, stroke, currents, blocked * currents + 1j * self.omega * factor * stroke

    def objective(self, drives):
        """Return the values (drives,) of the objective, and of velocities of target and rest."""
        plate, target = (
            np.einsum("na,ab,nb->n", drives.conj(), self.forms[name], drives).real for name in ("plate", "target")
        )
        velocity, rest = np.sqrt(2 * np.stack([target, plate - target]) / self.masses[:, None])
        contrast = 10 * np.log10(target / self.areas[0] / (plate - target) * self.areas[1])
        kinds = {"localization": target / plate, "contrast": contrast, "velocity": velocity}
        return kinds[self.scene.search.objectives[0].kind], velocity, rest

    def passes(self, drives):
        """Return the largest part (drives,) by which a limit is passed, in the unit of drives."""
        _, velocity, rest = self.objective(drives)
        limits, (term,) = self.limits, self.scene.search.objectives
        heat = np.abs(drives @ self.current.T) * np.sqrt(np.array(self.resistance) / 2)
        parts = [np.zeros(len(drives))]
        for value, limit in (
            (np.abs(drives @ self.voltage.T), limits.voltage),
            (np.abs(drives @ self.current.T), limits.current),
            (np.abs(drives @ self.stroke.T), limits.stroke),
            (heat, limits.heat and math.sqrt(limits.heat)),
            (rest[:, None], term.rest_limit),
        ):
            if limit is not None:
                parts.append(value.max(axis=1) / limit - 1)
        if limits.least_velocity is not None:
            parts.append(limits.least_velocity / velocity - 1)
        return np.max(parts, axis=0)


def random_drives(random, best):
    """Return drives: some anywhere, others near the best one."""
    anywhere = random.normal(size=(50_000, best.size)) + 1j * random.normal(size=(50_000, best.size))
    drives = np.abs(best).max() * 10 ** random.uniform(-2, 0.5, (50_000, 1)) * anywhere
    spread = np.abs(best).max() * 10 ** random.uniform(-5, 0, (50_000, 1))
    return np.concatenate([drives, best + spread * np.roll(anywhere, 1, axis=0)])


@pytest.mark.parametrize("name", SCENES)
def test_a_drive_reaches_the_bound_and_none_passes_it(random, name):
    scene = SCENES[name]()
    problem, judge = make_problem(resolve_search(scene, "cpu", evaluator="modal")), Judge(scene)
    bound, drive = problem.value_from_loss(problem.loss_bound.value), problem.loss_bound.drive
    free = scene.with_tables(search={**scene.search.model_dump(), "limits": {"power": 1e6, "least_velocity": 1e-9}})
    unlimited = make_problem(resolve_search(free, "cpu", evaluator="modal")).loss_bound.value
    assert bound < problem.value_from_loss(unlimited) * (1 - 1e-3)  # some limit counts
    assert judge.passes(drive[None])[0] <= 1e-6
    assert judge.objective(drive[None])[0][0] == pytest.approx(bound, rel=1e-3)
    drives = random_drives(random, drive)
    reached = judge.objective(drives)[0][judge.passes(drives) <= 0]
    assert reached.size > 100
    assert reached.max() <= bound * (1 + 1e-9)
    losses = problem.losses(problem.parametrization.positions_of(Designs(drive[None])))
    assert problem.value_from_loss(losses[0]) == pytest.approx(bound, rel=1e-3)


def test_the_result_shows_what_coils_bear():
    scene = SCENES["velocity"]()
    result, judge = localize(scene, evaluator="modal", device="cpu"), Judge(scene)
    driven = result.driven_scene(result.cases["best"]).actuators
    drive = np.array([row.magnitude * np.exp(-1j * row.phase) for row in driven])
    for index, row in enumerate(scene.actuators):
        stroke = abs(judge.stroke[index] @ drive)
        assert result.objective_values[f"stroke of {row.name}"] == pytest.approx(stroke, rel=1e-6)
        heat = judge.resistance[index] / 2 * abs(judge.current[index] @ drive) ** 2
        assert result.objective_values[f"heat of {row.name}"] == pytest.approx(heat, rel=1e-6)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"drive": {"frequency": 260.0, "ramp": 0.01}}, "search.limits.stroke: the motion of coils is that of steady"),
        ({"effects": {"stretching": {}}}, "delete effects.stretching"),
        ({"search": {"limits": {"heat": -1.0}}}, "search.limits.heat = -1.0: must be greater than 0"),
    ],
)
def test_what_is_refused(tables, message):
    scene = limited(LOSSLESS_COILS[:2], {"kind": "velocity"}, stroke=1e-4)
    assert message in refused(scene.with_tables, **tables)


def test_limits_of_coils_need_coils():
    expected = 'search.limits.current: no actuator is a coil; write kind = "coil", or delete it'
    assert expected in refused(scene_of().with_tables, search={"limits": {"current": 1.0}})
