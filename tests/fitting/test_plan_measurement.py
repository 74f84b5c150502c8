"""Plans of measurements: against all choices of places, against fits of noisy data, and what is refused."""

import json
from itertools import combinations

import numpy as np
import pytest

from support.commands import error_of, output_of
from support.scenes import scene_of
from warp_plate import Scene, SceneError, plan_measurement
from warp_plate.fitting.fit import fit_responses
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.plan_measurement import choose_places
from warp_plate.studies.frequency_response import frf

SIZE, ETA = (0.23, 0.17), 0.03


def lossy_panel(**free):
    made = scene_of(size=SIZE, effects={"loss_factor": {"eta": ETA}}, grid={"modal_density": 0.5})
    modulus = made.plate.young_modulus
    ranges = {"plate.young_modulus": (0.8 * modulus, 1.2 * modulus), "effects.loss_factor.eta": (0.01, 0.1), **free}
    return made.with_tables(fit={"free": ranges, "starts": 1})


def test_places_are_the_best_of_all(random):
    jacobians = random.normal(size=(9, 2, 3))
    jacobians[3] = jacobians[7]
    information = np.einsum("cfi,cfj->cij", jacobians, jacobians)

    def size(rows):
        return np.linalg.det(12 * np.eye(3) + information[list(rows)].sum(axis=0))

    best = max(size(rows) for rows in combinations(range(9), 4))
    found = choose_places(information, 4)
    assert len(set(found)) == 4
    assert size(found) == pytest.approx(best, rel=0.02)


@pytest.mark.slow
def test_intervals_are_those_of_fits(random):
    """The intervals of a plan are the spread of fits to noisy responses of its sensors."""
    plan = plan_measurement(lossy_panel(), 2, 0.02)
    points = [row.point for row in plan.scene.measurement]
    low, high = plan.frequencies[[0, -1]]
    frequencies = np.linspace(low, high, 100)
    exact = frf(plan.scene, [plan.actuator], points, (low, high), "accelerance")
    clean = np.array([np.interp(frequencies, exact.frequencies, np.log(np.abs(row))) for row in exact.responses])
    phase = np.array([np.interp(frequencies, exact.frequencies, np.unwrap(np.angle(row))) for row in exact.responses])
    values = []
    for _ in range(12):
        noise = 0.02 * random.normal(size=(2, *clean.shape)) / np.sqrt(2)
        responses = np.exp(clean + 1j * phase + noise[0] + 1j * noise[1])
        values.append(fit_responses(plan.scene, MeasuredResponses("data", frequencies, responses)).values)
    # A quarter of the lines doubles the deviations, and the plan takes small responses for noisier.
    spread = 2 * 1.96 * np.std(np.log(values), axis=0, ddof=1)
    expected = 2 * np.log(plan.high / plan.low)
    assert np.all(spread < 1.6 * expected)
    assert np.all(spread > 0.3 * expected)


def test_command(command, write_scene):
    write_scene(lossy_panel(**{"actuators[0].area[0]": (0.0, 0.01)}))
    record = json.loads(output_of(command("plan-measurement", "panel.toml", "--sensors", "3", "--json")))
    planned = Scene.load("panel.plan.toml")
    np.testing.assert_allclose([row.point for row in planned.measurement], record["points"])
    assert {row.actuator for row in planned.measurement} == {record["actuator"]}
    assert record["random"] > 1 < min(record["actuators"].values())
    known = record["parameters"]["plate.young_modulus"]
    assert 0 < known["high"] - known["low"] < 0.02 * known["value"]
    out = output_of(command("plan-measurement", "panel.toml", "--sensors", "1"))
    assert "Random places: intervals" in out
    assert "sensors = 900: must be from 1 to" in error_of(command("plan-measurement", "panel.toml", "--sensors", "900"))


def test_bad_plans():
    with pytest.raises(SceneError, match="fit: is missing"):
        plan_measurement(scene_of())
    rows = [{"actuator": "0", "point": (0.1, 0.1)}]
    gains = lossy_panel().with_tables(measurement=rows, fit={"free": {"measurement[0].gain": (0.5, 2.0)}})
    with pytest.raises(SceneError, match=r"fit.free: measurement\[0\].gain: is of a sensor"):
        plan_measurement(gains)
    with pytest.raises(SceneError, match="effects: responses of a panel without damping"):
        plan_measurement(lossy_panel().with_tables(effects={}, fit={"free": {"plate.density": (900.0, 1100.0)}}))
