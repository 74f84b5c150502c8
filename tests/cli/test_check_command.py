"""``warp-plate check``, and ``--allow-unstable``: a step above the limit is refused with both numbers, or run to its
status."""

import json
import math

import numpy as np
import pytest

from warp_plate import PlateSolver, load_result
from warp_plate.analysis.check import check
from warp_plate.cli.main import main
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.stability_limit import find_limit
from warp_plate.scene.dump import dump_scene


@pytest.fixture
def call(capsys):
    """What a command says: (status, standard output, standard error)."""

    def run(*arguments):
        status = 0
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as left:
            status = left.code
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


@pytest.fixture
def too_long(scene, tmp_path):
    """A scene's file whose time step is 1.05 of the limit, and the limit."""
    limit = make_scheme(scene()).limit
    made = scene(time_step=1.05 * limit, window=(200 * limit, 1000 * limit))
    path = tmp_path / "too-long.toml"
    path.write_text(dump_scene(made), encoding="utf-8")
    return path, limit


def test_numbers_of_the_paper(call):
    status, out, err = call("check", "paper", "--device", "cpu", "--json")
    found = json.loads(out)
    assert (status, err) == (0, "")
    assert found["time_step"] == 8e-5
    assert found["limit"] == pytest.approx(9.633e-5, rel=1e-3)
    assert found["steps"] == 1250
    assert found["stable"] is True
    assert found["growth_a_step"] == 1
    assert sum(found["limit_shares"].values()) == pytest.approx(1)
    assert found["steps_a_period"] == pytest.approx(1 / (290 * 8e-5))
    # λ = 2π√(κ/ω) over the spacing.
    assert found["points_a_wavelength"] == pytest.approx(
        2 * math.pi * math.sqrt(0.15291 / (580 * math.pi)) / (0.2 / 26), rel=1e-3
    )
    assert found["condition"] == pytest.approx((found["fastest_frequency"] / found["slowest_frequency"]) ** 2)
    assert found["path"] == "resident"
    assert len(found["warnings"]) == 2


def test_words(call):
    status, out, err = call("check", "paper", "--device", "cpu")
    words = " ".join(out.split())
    assert (status, err) == (0, "")
    for phrase in (
        "0.83 of the limit of 9.63346e-05 s", "takes 1250 steps", "backward damping 0.851 %", "43.1 steps a period",
        "7.48 points a bending wavelength", "condition number", "26.5 kB a plate", "path resident", "! The grid has",
    ):  # fmt: skip
        assert phrase in words


def test_frequencies_are_those_of_the_grid(scene):
    """Against all modes of a small grid with springs and a hung mass."""
    hung = {"area": (0.05, 0.1, 0.05, 0.1), "mass": 0.01, "stiffness": 500.0}
    made = scene((9, 9), effects={"oscillators": [hung], "foundation": {"stiffness": 1e4}})
    found = check(made, "cpu")
    modes = natural_modes(made, 1000).frequencies
    assert found.slowest == pytest.approx(modes[0], rel=1e-9)
    assert found.fastest == pytest.approx(modes[-1], rel=1e-3)
    assert check(scene(edges=("free",) * 4), "cpu").slowest > 0


def test_amplitude_at_which_stretching_is_too_stiff(scene, device, path):
    """Thrown well below it, a plate is bounded; far above it, it grows, and its neighbours do not notice."""
    made = scene(edges=("supported",) * 4, effects={"stretching": {}}, window=(0.0, 0.02), frequency=37.0)
    solver = PlateSolver(made, device, path)
    words = check(made, device).sentences()
    assert words[-1].startswith("Stretching is not in the limit")
    amplitude = check(made, device).amplitude * made.plate.thickness
    drives = np.ones((3, 3))
    reach = np.abs(solver.run(1e-3 * drives, (0.005,)).displacement).max(axis=(1, 2, 3))[0]
    drives *= 1e-3 * 0.2 * amplitude / reach
    calm = solver.run(drives, (0.02,))
    assert list(calm.status[[0, 2]]) == ["ok", "ok"]
    drives[1] *= 1e4
    wild = solver.run(drives, (0.02,))
    assert list(wild.status) == ["ok", "grew without bound", "ok"]
    assert 0 < wild.growth_time[1] <= 0.02
    np.testing.assert_array_equal(wild.energy[[0, 2]], calm.energy[[0, 2]])
    np.testing.assert_array_equal(wild.displacement[[0, 2]], calm.displacement[[0, 2]])


@pytest.mark.parametrize("command", ["simulate", "localize", "check"])
def test_refused_with_both_numbers(command, call, too_long):
    path, limit = too_long
    status, out, err = call(command, path)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert f"grid.time_step = {1.05 * limit:g}" in err
    assert f"the stability limit of {limit:.6g} s" in err


def test_check_tells_the_growth(call, too_long):
    path, limit = too_long
    status, out, _ = call("check", path, "--allow-unstable", "--json", "--device", "cpu")
    found = json.loads(out)
    assert status == 0
    assert found["stable"] is False
    # λΔt² = 4·1.05²: the root of z + 1/z = 2 − λΔt² outside the unit circle.
    assert found["growth_a_step"] == pytest.approx(-np.roots([1, 4 * 1.05**2 - 2, 1]).min(), rel=1e-6)
    assert "too long" in found["sentences"][0]
    assert found["limit"] == pytest.approx(limit)


def test_simulate_tells_the_status(call, too_long, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path, limit = too_long
    status, out, _ = call("simulate", path, "--allow-unstable", "--json", "--no-pictures", "--device", "cpu")
    said = json.loads(out)
    assert status == 0
    assert said["status"].startswith("grew without bound by t = ")
    assert said["localization_factor"] is None
    assert said["status"] in said["warnings"][0]
    case = load_result(tmp_path / "too-long-simulate.h5").cases["drive"]
    assert case.status == said["status"]
    # Seen within a hundred steps of a thousand.
    assert float(said["status"].split()[-2]) < 150 * limit
    _, words, _ = call("simulate", path, "--allow-unstable", "--no-pictures", "--device", "cpu")
    assert "grew without bound by t" in words
    assert "nan" not in words


def test_a_run_that_is_well_says_ok(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, out, _ = call("simulate", "paper", "--json", "--no-pictures", "--no-estimate", "--device", "cpu")
    assert json.loads(out)["status"] == "ok"
    assert load_result(tmp_path / "paper-simulate.h5").cases["drive"].status == "ok"


def test_limit_of_check_is_the_solver_s(scene):
    made = scene(effects={"material_damping": {"time": 1e-5}})
    assert check(made, "cpu").limit.time_step == find_limit(made)[0].time_step == make_scheme(made).limit
