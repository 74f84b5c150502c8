"""Drives without a search: transfer functions against traces, and what each drive is best at."""

import json
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver, SceneError, load_result
from warp_plate.cli.main import main
from warp_plate.plate.weights import REGIONS, localization_factor, region_weights
from warp_plate.scene.dump import dump_scene
from warp_plate.solve.response import measure_response
from warp_plate.studies.baselines import (
    BASELINES,
    REGULARISATION,
    baselines,
    inverse_filter,
    time_reversal,
    transfer_functions,
)

FREQUENCY = 290.0


@pytest.fixture(scope="module")
def solver():
    """Of a plate that is damped so much that its start is over long before the window's end."""
    from conftest import scene_of

    return PlateSolver(scene_of(damping=130.0, window=(0.06, 0.1), frequency=FREQUENCY), "cpu")


def test_transfer_functions_are_what_traces_show(solver, phasors):
    """u(t) = Re(Σ H_k Z_k exp(iωt)) at a node, over the last whole periods."""
    transfer, drive = transfer_functions(solver), phasors(1, 3)
    ny, nx = transfer.shape[1:]
    width, height = solver.scene.plate.size
    column, row = 4, 7
    point = (width * column / (nx - 1), height * row / (ny - 1))
    run = solver.run(drive, points=[point])
    late = run.trace_times > 0.1 - 4 / FREQUENCY
    steady = transfer[:, row, column] @ drive[0] * np.exp(2j * np.pi * FREQUENCY * run.trace_times[late])
    scale = np.abs(run.trace).max()
    np.testing.assert_allclose(run.trace[0, 0, late], steady.real, atol=2e-3 * scale)


def test_time_reversal_moves_the_targets_middle_most(solver, phasors):
    """No drive of the same power moves that point more (Cauchy and Schwarz)."""
    transfer = transfer_functions(solver)
    drive = time_reversal(solver.scene, transfer)
    others = phasors(50, 3)
    others *= np.linalg.norm(drive) / np.linalg.norm(others, axis=1, keepdims=True)
    # The target is the lower left quarter, and its middle the node a quarter of the way along both sides.
    point = tuple(side / 4 for side in solver.scene.plate.size)
    traces = solver.run(np.concatenate([drive[None], others]), points=[point]).trace[:, 0]
    swing = np.abs(traces[:, -40:]).max(axis=1)
    assert swing[0] >= 0.999 * swing[1:].max()
    assert np.abs(drive).max() == pytest.approx(1)


def test_inverse_filter_minimises_what_it_says(solver, phasors):
    """Σ W|HZ − b|² + λΣ|Z|² grows in every direction from its drive, at the best scale."""
    scene, transfer = solver.scene, transfer_functions(solver)
    weights = region_weights(scene)
    plate, target = (weights[REGIONS.index(name)].ravel() for name in ("plate", "target"))
    field = transfer.reshape(3, -1).T
    largest = np.linalg.svd(field * np.sqrt(plate)[:, None], compute_uv=False)[0]

    def cost(drives):
        error = (plate[:, None] * np.abs(field @ drives.T - (target / plate)[:, None]) ** 2).sum(axis=0)
        return error + (REGULARISATION * largest) ** 2 * (np.abs(drives) ** 2).sum(axis=1)

    drive = inverse_filter(scene, transfer)
    normal = field.conj().T @ (plate[:, None] * field) + (REGULARISATION * largest) ** 2 * np.eye(3)
    solution = np.linalg.solve(normal, field.conj().T @ target)
    np.testing.assert_allclose(drive, solution / np.abs(solution).max(), rtol=1e-9)
    around = solution + 0.1 * np.abs(solution).max() * phasors(200, 3)
    assert (cost(around) > cost(solution[None])).all()


def test_baselines_are_below_the_bound_and_named(solver):
    response = measure_response(solver)
    found = baselines(solver, response)
    assert list(found) == list(BASELINES)
    factors = localization_factor(solver.run(np.array(list(found.values()))).energy)
    assert (factors <= response.bound()).all()
    singles = localization_factor(solver.run(np.eye(3)).energy)
    assert factors[0] == pytest.approx(singles.max())


def test_the_actuators_own_frequency_counts(scene):
    """Where all actuators name one frequency, that of the drive says nothing."""
    made = scene(damping=130.0, window=(0.06, 0.1), frequency=FREQUENCY)
    named = made.model_dump(exclude_unset=True)
    named["drive"]["frequency"] = 100.0
    for actuator in named["actuators"]:
        actuator["frequency"] = FREQUENCY
    named["grid"]["time_step"] = PlateSolver(made, "cpu").specialized.scheme.time_step
    other = PlateSolver(type(made).model_validate(named), "cpu")
    same, reference = transfer_functions(other), transfer_functions(PlateSolver(made, "cpu"))
    np.testing.assert_allclose(same, reference, atol=1e-9 * np.abs(reference).max())


@pytest.mark.parametrize(
    ("tables", "word"),
    [
        ({"effects": {"stretching": {}}}, "effects.stretching"),
        ({"drive": {"frequency": 290.0, "burst": {"start": 0.0, "duration": 0.005}}}, "drive.burst"),
        ({"drive": {"frequency": 290.0, "chirp": {"end_frequency": 400.0, "duration": 0.01}}}, "drive.chirp"),
    ],
)
def test_other_scenes_are_refused_by_name(scene, tables, word):
    made = scene()
    other = type(made).model_validate({**made.model_dump(exclude_unset=True), **tables})
    with pytest.raises(SceneError, match=f"baselines: {word}"):
        transfer_functions(PlateSolver(other, "cpu"))


def test_different_frequencies_are_refused(scene):
    made = scene()
    actuators = [one.model_dump() for one in made.actuators]
    actuators[0]["frequency"] = 200.0
    other = type(made).model_validate({**made.model_dump(exclude_unset=True), "actuators": actuators})
    with pytest.raises(SceneError, match="frequencies differ"):
        transfer_functions(PlateSolver(other, "cpu"))


@pytest.fixture
def command(capsys, tmp_path, monkeypatch, scene):
    """Run ``localize --baselines`` on a small scene, with tables of its own: (status, standard output, error)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments, **tables):
        search = {"particles": 4, "iterations": 3}
        made = scene(damping=130.0, window=(0.03, 0.05), search=search, **tables)
        Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
        fixed = ("panel.toml", "--device", "cpu", "--baselines", "--no-pictures", "--no-estimate")
        try:
            main(["localize", *fixed, *arguments])
            status = 0
        except SystemExit as left:
            status = left.code or 0
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


def test_localize_shows_them_beside_the_drive_found(command):
    status, out, err = command("--json", record={"times": [0.04]})
    assert (status, err) == (0, "")
    factors = json.loads(out)["localization_factor"]
    assert set(factors) == {"equal", "single", "best", "bound", "time_reversal", "inverse_filter"}
    assert max(value for name, value in factors.items() if name != "bound") <= factors["bound"]
    result = load_result("panel-localize.h5")
    solver = PlateSolver(result.scene, "cpu")
    expected = baselines(solver, measure_response(solver))
    for name in ("time_reversal", "inverse_filter"):
        np.testing.assert_allclose(result.cases[name].phasors, expected[name], atol=1e-9)
        assert result.cases[name].localization_factor == factors[name]
    status, out, _ = command()  # without times of its own
    shapes = {case.displacement.shape for case in load_result("panel-localize.h5").cases.values()}
    assert len(shapes) == 1
    assert "time reversal to the target's middle" in out
    assert "regularised inverse filter" in out


def test_localize_refuses_them_before_it_searches(command):
    status, out, err = command(drive={"frequency": 290.0, "burst": {"start": 0.0, "duration": 0.005}})
    assert (status, out) == (2, "")
    assert "baselines: drive.burst is no steady drive" in err
    assert len(err.splitlines()) == 1
    assert not Path("panel-localize.h5").exists()
