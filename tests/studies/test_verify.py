"""Measured drives against their results: sampled fields with seeded noise, another panel, bad files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from support.commands import error_of, output_of
from support.scenes import refused, scene_of
from warp_plate import save_result, simulate, verify
from warp_plate.analysis.motion import motions
from warp_plate.studies.verify import MeasuredField, average_readings

SIZE = (0.23, 0.17)


@pytest.fixture(scope="module")
def lossy_run():
    scene = scene_of(size=SIZE, effects={"loss_factor": {"eta": 0.05}}, grid={"modal_density": 0.5})
    return simulate(scene, estimate=False)


def field_of(lossy_run, count=12, scale=2.0):
    """Return velocities of a result at count × count points, read off its own motion by the nodes next to them."""
    (motion,) = motions(lossy_run.scene, {"drive": lossy_run.main_case})
    rows, columns = (np.unique(np.rint(np.linspace(1, n - 2, count)).astype(int)) for n in motion.rms_velocity.shape)
    (nx, ny), (width, height) = lossy_run.scene.grid.nodes, SIZE
    x, y = np.meshgrid(columns * width / (nx - 1), rows * height / (ny - 1))
    velocity = scale * motion.rms_velocity[np.ix_(rows, columns)].ravel().astype(float)
    return MeasuredField("data.csv", np.stack([x.ravel(), y.ravel()], axis=1), velocity, None)


def with_noise(field, share, random):
    """Return the velocities of a field with noise of a share of the largest."""
    sigma = np.full(field.velocity.size, share * field.velocity.max())
    return replace(field, velocity=np.abs(field.velocity + sigma * random.normal(size=sigma.size)), uncertainty=sigma)


def test_the_own_field_keeps_the_promise(lossy_run):
    found = verify(lossy_run, field_of(lossy_run))
    assert found.kept
    assert found.localization_factor == pytest.approx(found.promised_factor, abs=0.02)
    assert found.localization_factor - found.sampling == pytest.approx(found.promised_factor, abs=2e-3)
    assert found.scale == pytest.approx(2, rel=1e-3)
    assert found.correlation == pytest.approx(1, abs=1e-6)
    assert np.isnan(found.deviation)
    assert [line[:12] for line in found.warnings] == ["The noise is"]


def test_the_deviation_is_that_of_noise(lossy_run, random):
    """Intervals hold for nearly all noisy fields; noise does not shift the mean."""
    field = field_of(lossy_run)
    clean = verify(lossy_run, field).localization_factor
    found = [verify(lossy_run, with_noise(field, 0.05, random)) for _ in range(25)]
    factors = np.array([each.localization_factor for each in found])
    deviation = np.mean([each.deviation for each in found])
    assert deviation == pytest.approx(factors.std(ddof=1), rel=0.4)
    assert abs(factors.mean() - clean) < 4 * deviation / 5
    held = [low <= each.promised_factor <= high for each in found for low, high in [each.interval]]
    assert sum(held) >= 21


def test_another_panel_does_not(lossy_run):
    """A field that is even over the panel has the target's share of its area."""
    field = field_of(lossy_run)
    even = MeasuredField("data.csv", field.points, np.ones(len(field.points)), np.full(len(field.points), 0.01))
    found = verify(lossy_run, even)
    x0, x1, y0, y1 = lossy_run.scene.target.area
    share = (x1 - x0) * (y1 - y0) / (SIZE[0] * SIZE[1])
    assert found.localization_factor == pytest.approx(share, rel=0.05)
    assert found.correlation < 0.95


@pytest.mark.parametrize("part", [0, 1])
def test_intervals_hold_factors_alone(part, lossy_run):
    """Of a scan that moves in the target alone, or elsewhere alone."""
    field = field_of(lossy_run)
    x0, x1, y0, y1 = lossy_run.scene.target.area
    x, y = field.points.T
    inside = (x0 < x) & (x < x1) & (y0 < y) & (y < y1)
    velocity = np.where(inside == part, 1.0, 1e-3)
    low, high = verify(lossy_run, MeasuredField("data.csv", field.points, velocity, 0.5 * velocity)).interval
    assert 0 <= low <= part <= high + 0.1 <= 1.1


def test_intervals_of_a_single_point_that_moves_are_not_reversed(lossy_run):
    """Splines overshoot beside it, so that the factor itself is below 0."""
    field = field_of(lossy_run, 5)
    velocity = np.zeros(25)
    velocity[13] = 1.0
    found = verify(lossy_run, replace(field, velocity=velocity, uncertainty=0 * velocity))
    assert found.localization_factor < 0
    assert replace(found, sampling=0.0).interval == (0, 0)


@pytest.mark.parametrize("name", ["mirrored in x", "mirrored in y", "turned"])
def test_mirrored_scans_are_named(name, lossy_run, random):
    """The field has no symmetry; 2 % noise and missing points do not matter."""
    field = with_noise(field_of(lossy_run), 0.02, random)
    field.velocity[::17] = np.nan
    points = field.points.copy()
    for axis in {"mirrored in x": [0], "mirrored in y": [1], "turned": [0, 1]}[name]:
        points[:, axis] = SIZE[axis] - points[:, axis]
    found = verify(lossy_run, replace(field, points=points))
    assert found.mirrored == name
    assert f"The scan is {name}: the cosine of the velocities is then 0.99" in "".join(found.warnings)
    assert verify(lossy_run, field).mirrored is None


def test_points_that_were_not_seen_are_left_out(lossy_run, tmp_path):
    """NaN and empty cells; coordinates in millimetres."""
    field = field_of(lossy_run)
    velocity = field.velocity.copy()
    velocity[[3, 40]] = np.nan
    kept = np.isfinite(velocity)
    some = MeasuredField("", field.points[kept], velocity[kept], None)
    expected = verify(lossy_run, some).localization_factor
    assert verify(lossy_run, replace(field, velocity=velocity)).localization_factor == expected
    rows = (f"{1e3 * x!r};{1e3 * y!r};{'' if np.isnan(v) else repr(float(v))}" for (x, y), v in zip(
        field.points.tolist(), velocity, strict=True))  # fmt: skip
    (tmp_path / "a.csv").write_text("scan of 12 × 12\nx [mm];y [mm];velocity [m/s]\n" + "\n".join(rows))
    assert verify(lossy_run, tmp_path / "a.csv").localization_factor == pytest.approx(expected, rel=1e-9)


def test_readings_are_averaged(random):
    points = np.repeat([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], 50, axis=0)
    found = average_readings(MeasuredField("", points, 5 + random.normal(size=200), None))
    assert found.velocity == pytest.approx(np.full(4, 5.0), abs=0.6)
    assert found.uncertainty == pytest.approx(np.full(4, 1 / np.sqrt(50)), rel=0.4)


def test_readings_of_one_point_that_is_rounded_are_averaged(lossy_run):
    """So that small differences between places are no steep slopes of the field."""
    field = field_of(lossy_run)
    points = np.concatenate([field.points, field.points[:20] + 1e-10])
    velocity = np.concatenate([field.velocity, 0.8 * field.velocity[:20]])
    found = verify(lossy_run, MeasuredField("", points, velocity, None))
    assert len(found.promised) == len(field.points)
    assert found.localization_factor == pytest.approx(verify(lossy_run, field).localization_factor, abs=0.05)


def test_command(command, lossy_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_result(lossy_run, "panel.h5")
    field = field_of(lossy_run)
    table = np.column_stack([field.points, field.velocity])
    np.savetxt("data.csv", table, delimiter=",", header="x [m],y [m],velocity [m/s]", comments="")
    record = json.loads(output_of(command("verify", "panel.h5", "--data", "data.csv", "--json")))
    assert record["kept"]
    assert record["localization_factor"] == pytest.approx(verify(lossy_run, field).localization_factor, rel=1e-9)
    assert "The noise is not known" in output_of(command("verify", "panel.h5", "--data", "data.csv"))
    for case in ("x", ""):
        err = error_of(command("verify", "panel.h5", "--data", "data.csv", "--case", case))
        assert f"case = '{case}': must be one of drive" in err


NOISE = "".join(f"{x},{y},1,2\n" for x in (0.02, 0.1, 0.18) for y in (0.02, 0.1, 0.15))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y\n1,2\n", "has no column 'velocity'; the columns are: x, y"),
        ("x,y,velocity\n0.1,0.1,no\n", "line 2, velocity = 'no': must be a number, 0 or more"),
        ("x,y,velocity\n0.1,0.1,1_0\n", "line 2, velocity = '1_0': must be a number, 0 or more"),
        ("x,y,velocity\n0.1,0.1,٣\n", "line 2, velocity = '٣': must be a number, 0 or more"),
        ("x,y,velocity\n0.1,0.1,1e308\n", "line 2, velocity = '1e308': must be a number, 0 or more and below 1e+30"),
        ("x,y,velocity\n0.1,0.1,1e-308\n", "needs velocities that are not all 0"),
        (f"x,y,velocity,uncertainty\n{NOISE}", "velocities are not above their uncertainty; measure with less noise"),
        ("x,y,velocity\n0.1,0.1,0\n", "needs velocities that are not all 0"),
        ("x,y,velocity\n0.1,0.1,1\n", "1 points; 4 to 2000 are possible"),
        ("x,y,velocity\n0.1,0.1,1\n0.11,0.1,1\n0.12,0.1,1\n9,0.1,1\n", "a point is off the plate"),
        ("x,y,velocity\n0.1,0.1,1\n0.11,0.1,1\n0.12,0.1,1\n0.13,0.1,1\n", "all points lie on one line"),
        ("x,y,velocity\n0.01,0.013,1\n0.02,0.026,1\n0.03,0.039,2\n0.07,0.091,1\n", "all points lie on one line"),
    ],
)
def test_bad_files(text, message, lossy_run, tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(text, encoding="utf-8")
    assert message in refused(verify, lossy_run, path)
