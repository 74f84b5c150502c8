"""Searches under limits of sound: six scenes, whose bounds no drive of a hundred thousand passes and one reaches."""

import math

import numpy as np
import pytest

from support.scenes import refused, scene_of
from support.scenes_of_outlines import outlined
from warp_plate import sweep
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import Radiation, pressures
from warp_plate.plate.designs import Designs
from warp_plate.problem.methods import resolve_search
from warp_plate.problem.problem import make_problem
from warp_plate.quantities.sound_levels import a_weighting

DAMPED = {"effects": {"damping": {"viscous": 20.0}}}
FREE = {"magnitude": {"range": (0.0, 50.0)}, "phase": {}}
HELD = {"magnitude": {"range": (2.0, 20.0)}, "phase": {}}
PATCHES = [(0.08, 0.11, 0.06, 0.09), (0.12, 0.14, 0.12, 0.14), (0.05, 0.07, 0.1, 0.13)]
POINT = {"point": (0.1, 0.05, 0.4), "level": 12.0}
OTHER = {"point": (0.5, 0.1, 0.3), "level": 11.0}


def limited(objective, search=FREE, scene=scene_of, **limits):
    """Return a scene with an objective and limits on motion and sound."""
    made = {"frequency": 260.0, "modal_density": 0.5, "nodes": (9, 9), **DAMPED} if scene is scene_of else DAMPED
    return scene(search={**search, "objectives": [objective], "limits": limits}, **made)


def disc(**tables):
    return outlined({"disc": (0.1, 0.1, 0.1)}, actuators=PATCHES, frequency=400.0, modal_density=0.5, **tables)


SCENES = {
    "localization": lambda: limited({"kind": "localization"}, least_velocity=2e-4, sound=18.0),
    "localization at points": lambda: limited(
        {"kind": "localization"}, least_velocity=2e-4, pressures=[POINT, OTHER], sound=50.0
    ),
    "strong": lambda: limited({"kind": "velocity", "rest_limit": 1e-3}, sound=40.0, pressures=[OTHER]),
    "strong and ranged": lambda: limited(
        {"kind": "velocity"}, {"magnitude": {"range": (0.2, 2.0)}, "phase": {}}, sound=41.0
    ),
    "loud": lambda: limited({"kind": "sound", "weight": 0.5}, FREE, pressures=[POINT], power=50.0),
    "quiet disc": lambda: limited({"kind": "quietness"}, HELD, disc, sound=26.0),
}


class Judge:
    """Motion and sound of unit drives without the Gram matrices of the search."""

    def __init__(self, scene, plate=None, frequency=None):
        self.scene, frequency = scene, frequency or scene.drive.frequency
        plate = plate or solve_modes(scene, frequency)
        amplitudes = plate.respond(np.array([frequency]), plate.actuator_forces())[0]
        rates = 2j * math.pi * frequency * amplitudes
        self.forms = {
            name: rates.conj().T @ plate.kinetic_matrix(region) @ rates / 4
            for name, region in (("plate", "plate"), ("target", scene.target))
        }
        self.weighting = float(a_weighting(np.array([frequency]))[0])
        power = Radiation(plate, frequency).resistances(np.array([frequency]))[0]
        self.forms["sound"] = rates.conj().T @ power @ rates / 2
        at = {row.name: row for row in scene.search.limits.pressures}
        for name, row in at.items():
            rows = pressures(plate, np.array([frequency]), amplitudes[None], np.array([row.point]))[0]
            self.forms[name] = rows.conj().T @ rows / 2
        weights = make_problem(resolve_search(scene, "cpu", evaluator="modal")).objectives.sizes
        self.sizes, self.references = weights, {"sound": 1e-12, **dict.fromkeys(at, 4e-10)}

    def of(self, drives):
        """Return energies and sounds (drives,) by name."""
        return {name: np.einsum("na,ab,nb->n", drives.conj(), form, drives).real for name, form in self.forms.items()}

    def level(self, values, name):
        return 10 * np.log10(values[name] / self.references[name]) + self.weighting

    def objective(self, values):
        (term,) = self.scene.search.objectives
        velocity = np.sqrt(2 * values["target"] / self.sizes.masses[0])
        return {
            "localization": lambda: values["target"] / values["plate"],
            "velocity": lambda: velocity,
            "sound": lambda: self.level(values, "sound"),
            "quietness": lambda: (
                10 * np.log10(1.204 * 343.2 * self.sizes.areas[0] * velocity**2 / values["sound"]) - self.weighting
            ),
        }[term.kind]() * term.weight

    def passes(self, values):
        """Return the largest part (drives,) by which a limit is passed, in the unit of drives."""
        limits, (term,) = self.scene.search.limits, self.scene.search.objectives
        velocity = np.sqrt(2 * values["target"] / self.sizes.masses[0])
        parts = [np.zeros(len(velocity))]
        if limits.least_velocity is not None:
            parts.append(limits.least_velocity / velocity - 1)
        if limits.sound is not None:
            parts.append(10 ** ((self.level(values, "sound") - limits.sound) / 20) - 1)
        parts += [10 ** ((self.level(values, row.name) - row.level) / 20) - 1 for row in limits.pressures]
        if term.rest_limit is not None:
            rest = np.sqrt(2 * (values["plate"] - values["target"]) / self.sizes.masses[1])
            parts.append(rest / term.rest_limit - 1)
        return np.max(parts, axis=0)


def random_drives(scene, random, best):
    """Return drives of a search: some anywhere in its ranges, others near the best one."""
    low, high = scene.search.magnitude.range
    count, actuators = 50_000, len(scene.actuators)
    anywhere = random.uniform(low, high, (count, actuators)) * random.uniform(1e-2 if not low else 1, 1, (count, 1))
    drives = anywhere * np.exp(1j * random.uniform(0, 2 * math.pi, anywhere.shape))
    spread = np.abs(best).max() * 10 ** random.uniform(-5, 0, (count, 1))
    near = best + spread * (random.normal(size=anywhere.shape) + 1j * random.normal(size=anywhere.shape))
    near *= np.clip(np.abs(near), low, high) / np.abs(near)
    drives = np.concatenate([drives, near])
    most = scene.search.limits.power
    if most is not None:
        drives *= np.minimum(1, np.sqrt(most / (np.abs(drives) ** 2).sum(axis=1, keepdims=True)))
    return drives


@pytest.mark.parametrize("name", SCENES)
def test_a_drive_reaches_the_bound_and_none_passes_it(random, name):
    scene = SCENES[name]()
    problem = make_problem(resolve_search(scene, "cpu", evaluator="modal"))
    judge, bound = Judge(scene), problem.value_from_loss(problem.loss_bound.value)
    drive, size = problem.loss_bound.drive, abs(bound) if name != "loud" else 10.0
    values = judge.of(drive[None])
    assert judge.passes(values)[0] <= 1e-6
    assert judge.objective(values)[0] == pytest.approx(bound, abs=1e-3 * size)
    drives = random_drives(scene, random, drive)
    values = judge.of(drives)
    reached = judge.objective(values)[judge.passes(values) <= 0]
    assert reached.size > 100
    assert reached.max() <= bound + 1e-9 * size
    losses = problem.losses(problem.parametrization.positions_of(Designs(drive[None])))
    assert problem.value_from_loss(losses[0]) == pytest.approx(bound, abs=1e-3 * size)


def test_less_sound_leaves_less_localization():
    """The curve of the largest localization against the limit of sound, by a sweep."""
    scene = SCENES["localization"]()
    result = sweep(scene, ["search.limits.sound=16,18,20,40"], "localize", evaluator="modal")
    best, bound = result.shaped("best"), result.shaped("bound")
    assert (np.diff(bound) > 0).all()
    np.testing.assert_allclose(best, bound, rtol=1e-3)
    free = scene.replace("search.limits", {"sound": 200.0, "least_velocity": 2e-4})
    assert bound[-1] == pytest.approx(make_problem(resolve_search(free, "cpu", evaluator="modal")).bound)


def test_sweeps_of_sound():
    scene = scene_of(nodes=(9, 9), modal_density=0.5, **DAMPED)
    result = sweep(scene, ["drive.frequency=200,260"], "sound")
    judge = Judge(limited({"kind": "quietness"}))
    values = judge.of(np.ones((1, 3)))
    assert result.shaped("quietness")[1] == pytest.approx(judge.objective(values)[0], abs=1e-6)
    assert result.shaped("sound")[1] == pytest.approx(judge.level(values, "sound")[0], abs=1e-6)
    assert (result.shaped("bound") > result.shaped("quietness")).all()


def test_slopes_of_places_are_those_of_differences(random):
    scene = limited({"kind": "quietness"}, {**HELD, "position": {"clearance": 0.005}}, pressures=[POINT, OTHER])
    problem = make_problem(resolve_search(scene, "cpu", evaluator="modal"))
    position = problem.space.from_unit(0.2 + 0.6 * random.random((1, problem.space.dimension)))
    losses, slopes = problem.slopes(position, problem.space)
    assert losses == pytest.approx(problem.losses(position), rel=1e-9)
    steps = 1e-5 * np.diag(problem.space.span)
    ends = [problem.losses(position + sign * steps) for sign in (1, -1)]
    differences = (ends[0] - ends[1]) / (2 * np.diag(steps))
    np.testing.assert_allclose(slopes[0], differences, rtol=1e-5, atol=1e-5 * np.abs(slopes).max())


def test_the_sound_of_a_searched_frequency(random):
    scene = limited({"kind": "sound"}, {**HELD, "frequency": {"range": (200.0, 900.0)}})
    problem = make_problem(resolve_search(scene, "cpu", evaluator="modal"))
    assert problem.slopes is None
    positions = problem.space.from_unit(random.random((3, problem.space.dimension)))
    designs, found = problem.parametrization.designs(positions), -problem.losses(positions)
    for index, level in enumerate(found):
        judge = Judge(scene, problem.drive_solver.plate, float(designs.frequency[index, 0]))
        assert judge.objective(judge.of(designs.drives[[index]]))[0] == pytest.approx(level, abs=1e-9)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"drive": {"frequency": 260.0, "burst": {"start": 0.0, "duration": 0.01}}}, "delete drive.burst"),
        ({"effects": {"stretching": {}}}, "delete effects.stretching"),
    ],
)
def test_sound_is_that_of_steady_tones(tables, message):
    scene = limited({"kind": "velocity"}, sound=30.0)
    expected = f"search.limits.sound: sound is that of steady tones of linear plates; {message}"
    assert expected in refused(scene.with_tables, **tables)


def test_sound_is_not_stepped_in_time():
    scene = limited({"kind": "sound"}, power=1.0)
    expected = "search.objectives[0].kind: cannot be stepped in time"
    assert expected in refused(lambda: make_problem(resolve_search(scene, "cpu", evaluator="direct")))
