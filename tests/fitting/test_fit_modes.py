"""Numbers of panels from natural frequencies that exact solutions give, with seeded noise; bad input."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from support.commands import error_of, output_of
from support.levy import isotropic, levy_frequencies
from support.scenes import MATERIAL, refused, scene_of
from support.series import wavenumber_squared
from warp_plate import Scene, SceneError, modes
from warp_plate.fitting.fit import fit_modes
from warp_plate.fitting.least_squares import exchangeable
from warp_plate.fitting.measured_modes import MeasuredModes, read_modes
from warp_plate.modal.modes import solve_modes

SIZE, MODULUS, VISCOUS = (0.23, 0.17), MATERIAL["young_modulus"], 2.0
SURFACE_DENSITY = MATERIAL["density"] * MATERIAL["thickness"]
RIGIDITY = MODULUS * MATERIAL["thickness"] ** 3 / 12 / (1 - MATERIAL["poisson_ratio"] ** 2)
MODULI = {"plate.young_modulus": (0.5 * MODULUS, 1.5 * MODULUS)}


def stiff_panel(**fit):
    """Return a supported panel whose own modulus is a tenth too high."""
    made = scene_of(size=SIZE, edges=("supported",) * 4, damping=1.0, fit={"starts": 1, **fit})
    return made.replace("plate.young_modulus", 1.1 * MODULUS)


def measured(random, noise=1e-3, count=12, damping_noise=None):
    """Return Navier's frequencies, and damping ratios c/2ρHω, both with relative noise."""
    waves = [wavenumber_squared((m, n), SIZE) for m in range(1, 9) for n in range(1, 9)]
    frequencies = np.sort(waves)[:count] * math.sqrt(RIGIDITY / SURFACE_DENSITY) / (2 * math.pi)
    damping = VISCOUS / SURFACE_DENSITY / (4 * math.pi * frequencies)
    damping = damping * (1 + damping_noise * random.normal(size=count)) if damping_noise else damping * math.nan
    return MeasuredModes("data.csv", frequencies * (1 + noise * random.normal(size=count)), damping)


def test_rigidity(random):
    """Five standard deviations of the estimate are 0.3 %; the interval is as wide as the noise makes it."""
    panel = stiff_panel(free=MODULI).replace("grid.modal_density", 1.0)
    found = fit_modes(panel, measured(random))
    assert found.scene.plate.rigidity == pytest.approx(RIGIDITY, rel=5e-3)
    assert found.values == pytest.approx([found.scene.plate.young_modulus], rel=1e-12)
    assert repr(found) == f"<ModeFit plate.young_modulus = {found.values[0]:.5g}>"
    # 2.2 · 2 · 0.1 % / √12 to either side, and what χ² of 11 numbers leaves open.
    assert 0.3 * 1.27e-3 < (found.high - found.low)[0] / 2 / MODULUS < 2 * 1.27e-3
    exact = fit_modes(panel, measured(random, noise=0))
    assert exact.values == pytest.approx([MODULUS], rel=2e-5)


def test_what_cannot_be_told_apart_is_named(random):
    """Modulus and density by frequencies alone; an actuator's place; their ratio is still right."""
    free = {**MODULI, "plate.density": (500.0, 2000.0), "actuators.0.area[0]": (0.0, 0.05)}
    found = fit_modes(stiff_panel(free=free), measured(random))
    assert found.inseparable == (("plate.young_modulus", "plate.density"), ("actuators[0].area[0]",))
    assert "plate.young_modulus and plate.density: cannot be distinguished" in found.warnings[0]
    assert np.isnan([*found.low, *found.high]).all()
    assert found.values[0] / found.values[1] == pytest.approx(MODULUS / MATERIAL["density"], rel=5e-3)


def test_damping_separates_modulus_and_density(random):
    """c/2ρHω falls with the density; damping is measured a hundred times worse, and the intervals know it."""
    free = {**MODULI, "plate.density": (500.0, 2000.0)}
    data = measured(random, noise=1e-4, damping_noise=1e-2, count=16)
    panel = stiff_panel(free=free).replace("effects.damping.viscous", VISCOUS)
    found = fit_modes(panel.replace("grid.modal_density", 1.0), data)
    assert found.inseparable == ()
    assert found.values == pytest.approx([MODULUS, MATERIAL["density"]], rel=0.02)
    assert (found.high - found.low) / found.values == pytest.approx(2 * 2.13 * 0.01 / 4, rel=0.7)
    assert found.correlations[0, 1] > 0.99


@pytest.mark.parametrize("named", [False, True])
def test_missing_modes(named, random):
    """Modes that were not seen are found by the nearest frequencies, or by the numbers of the others."""
    seen = np.array([1, 2, 4, 5, 8, 9, 11])
    every = measured(random, noise=3e-4).frequencies[seen - 1]
    data = MeasuredModes("data.csv", every, np.full(7, math.nan), seen if named else None)
    found = fit_modes(stiff_panel(free=MODULI, starts=8, pairing="order" if named else "nearest"), data)
    np.testing.assert_array_equal(found.numbers, seen)
    assert found.values == pytest.approx([MODULUS], rel=5e-3)


@pytest.mark.slow
def test_intervals_hold_and_a_spring_is_found(random):
    """Lévy's frequencies of a panel with one edge on springs: 95 % intervals of 20 sets of noise hold seven times
    in eight, of 19 in 20 on average."""
    spring, sides = 3e3, ("free", "supported", {"translation": 1e3, "rotation": 0.0}, "supported")
    exact = levy_frequencies(lambda x: isotropic(**MATERIAL), SIZE, ("free", (spring, 0.0)), 400.0)[:14]
    free = {**MODULI, "edges.right.translation": (1e2, 1e5)}
    scene = scene_of(size=SIZE, edges=sides, fit={"free": free, "starts": 4}, modal_density=1.0)
    truth = (MODULUS, spring)
    held = []
    for _ in range(20):
        noisy = np.sort(exact * (1 + 2e-3 * random.normal(size=14)))
        found = fit_modes(scene, MeasuredModes("data.csv", noisy, np.full(14, math.nan)))
        held += [low < value < high for low, value, high in zip(found.low, truth, found.high, strict=True)]
    assert sum(held) >= 35
    assert found.values == pytest.approx(truth, rel=0.1)


def test_linked_springs_are_fitted_as_one():
    """Lévy's frequencies of equal springs along two edges."""
    spring, sides = 3e3, ({"translation": 1e3}, "supported", {"translation": 1e3}, "supported")
    keys = ["edges.left.translation", "edges.right.translation"]
    scene = scene_of(size=SIZE, edges=sides, links={"gasket": {"keys": keys}}, fit={"free": {"gasket": (1e2, 1e5)}})
    exact = levy_frequencies(lambda x: isotropic(**MATERIAL), SIZE, ((spring, 0.0), (spring, 0.0)), 400.0)[:10]
    found = fit_modes(scene, MeasuredModes("data.csv", exact, np.full(10, np.nan)))
    assert found.values == pytest.approx([spring], rel=1e-3)
    assert found.scene.edges.left.translation == found.scene.edges.right.translation == found.values[0]


def test_command(command, write_scene, random):
    write_scene(stiff_panel(free=MODULI))
    Path("data.csv").write_text(
        "# by hammer\nfrequency [Hz];mode;note\n"
        + "".join(f"{value};{mode};\n" for mode, value in enumerate(measured(random).frequencies, 1)),
        encoding="utf-8",
    )
    record = json.loads(output_of(command("fit", "panel.toml", "--data", "data.csv", "--json")))
    assert record["verdict"]["describes"]
    parameter = record["parameters"]["plate.young_modulus"]
    assert parameter["low"] < parameter["value"] < parameter["high"]
    assert record["files"] == ["panel.fitted.toml", "panel.fitted.png", "panel.fitted.svg"]
    fitted = Scene.load("panel.fitted.toml")
    assert fitted.plate.young_modulus == parameter["value"]
    assert fitted == stiff_panel(free=MODULI).replace("plate.young_modulus", parameter["value"])
    more = ("--set", "fit.free.plate.density=[500, 2000]", "--no-pictures")
    out = " ".join(output_of(command("fit", "panel.toml", "--data", "data.csv", *more)).split())
    assert "plate.young_modulus and plate.density: cannot be distinguished" in out
    Path("mine.toml").write_text("mine = 1", encoding="utf-8")
    assert "--force" in error_of(command("fit", "panel.toml", "--data", "data.csv", "--out", "mine.toml"))
    assert "no.csv: no such file" in error_of(command("fit", "panel.toml", "--data", "no.csv"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "data.csv: is empty; its first line names the columns"),
        ("f,mode\n1,2\n", "needs 1 to 200 numbers in a column 'frequency'; the columns are: f, mode"),
        ("frequency,damping\n10\n", "line 2 has 1 columns; the first line names 2"),
        ("frequency,frequency [Hz]\n1,2\n", "line 1 names two columns alike"),
        ("frequency\n10\n-5\n", "line 3, frequency = '-5': must be a number above 1e-30"),
        ("frequency\nnan\n", "line 2, frequency = 'nan'"),
        ("frequency\nten\n", "line 2, frequency = 'ten'"),
        ("frequency,damping\n10,\n20,2\n", "line 3, damping = '2': must be a ratio above 1e-30 and below 1, or empty"),
        ("frequency\n1e300\n", "line 2, frequency = '1e300': must be a number above 1e-30 and below 1e+30"),
        ("frequency,damping\n10,1e-300\n", "line 2, damping = '1e-300'"),
        ("frequency,shape 0 0\n10,1e200\n", "line 2, shape 0 0 = '1e200': must be a number of at most 1e+30"),
        ("frequency,mode\n10,1\n20,1\n", "line 3, mode = '1': must be a whole number"),
        ("frequency,mode\n10,1.5\n", "line 2, mode = '1.5'"),
    ],
)
def test_bad_data(text, message, tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(text, encoding="utf-8")
    assert message in refused(read_modes, path)


@pytest.mark.parametrize(
    ("fit", "message"),
    [
        ({"free": {}}, "fit.free: is empty"),
        ({"free": {"plate.density": (2, 1)}}, "fit.free: plate.density = [2.0, 1.0]: the lowest value comes first"),
        ({"free": {"plate.density": [2]}}, "fit.free.'plate.density' = [2]: must be a list of 2 numbers"),
        ({"free": {"plate.densty": (1, 2)}}, "fit.free: plate.densty: is not a key"),
        ({"free": {"drive.frequency": (1, 2)}}, "fit.free: drive.frequency: is no real number of plate, edges"),
        ({"free": 3}, "fit.free = 3: must be a table"),
    ],
)
def test_bad_tables(fit, message):
    assert message in refused(scene_of().with_tables, fit=fit)


def test_too_few_data_and_ranges_beyond_the_scene(random):
    free = {**MODULI, "plate.thickness": (1e-4, 1e-3)}
    with pytest.raises(SceneError, match="2 numbers do not determine 2 free ones"):
        fit_modes(stiff_panel(free=free), measured(random, count=2))
    with pytest.raises(SceneError, match="fit: is missing"):
        fit_modes(scene_of(), measured(random))
    with pytest.raises(SceneError, match="a range reaches too far: plate"):
        fit_modes(stiff_panel(free={"plate.thickness": (0.1, 1.0)}), measured(random))


CROSSING = (0.2, 0.19)


def pulled(tension, order):
    """Return Navier's frequencies and shapes of a supported plate pulled along x, in an order of the half-waves."""
    points = np.random.default_rng(4).uniform(0.02, 0.17, (12, 2))
    rows = []
    for m, n in order:
        along = np.pi * np.array([m, n]) / CROSSING
        stiffness = RIGIDITY * (along @ along) ** 2 + tension * along[0] ** 2
        shape = np.prod(np.sin(along * points), axis=1)
        rows.append((math.sqrt(stiffness / SURFACE_DENSITY) / (2 * math.pi), shape))
    frequencies, shapes = (np.array(column) for column in zip(*rows, strict=True))
    return frequencies, shapes, points


@pytest.mark.parametrize("pairing", ["mac", "order"])
def test_modes_that_cross(pairing, random):
    """Tension raises the mode of two half-waves along x beyond that of two along y, which was missed."""
    tension, waves = 6.0, [(1, 1), (2, 1), (1, 2), (2, 2), (3, 1), (1, 3)]
    frequencies, shapes, points = pulled(0.0, waves)
    assert frequencies[1] < frequencies[2]
    frequencies, shapes, points = pulled(tension, waves)
    seen = np.argsort(frequencies)[[0, 2, 3, 4, 5]]
    assert seen[1] == 1
    noisy = frequencies[seen] * (1 + 5e-4 * random.normal(size=5))
    blurred = shapes[seen] * (1 + 0.02 * random.normal(size=(5, 12)))
    data = MeasuredModes("data.csv", noisy, np.full(5, math.nan), None, blurred, points)
    free = {**MODULI, "effects.tension.x": (0.01, 20.0)}
    scene = scene_of(size=CROSSING, edges=("supported",) * 4, effects={"tension": {"x": 0.01, "y": 0.0}})
    found = fit_modes(scene.with_tables(fit={"starts": 1, "free": free, "pairing": pairing}), data)
    assert (found.numbers.tolist() == [1, 3, 4, 5, 6]) == (pairing == "mac")
    if pairing == "mac":
        assert found.values == pytest.approx([MODULUS, tension], rel=0.03)


def test_shapes_are_needed_for_the_mac(random):
    with pytest.raises(SceneError, match="has no shapes with points"):
        fit_modes(stiff_panel(free=MODULI, pairing="mac"), measured(random))


@pytest.mark.slow
@pytest.mark.parametrize("ranges", [((1.0, 100.0), (1.0, 100.0)), ((1.0, 10.0), (8.0, 100.0))])
def test_springs_of_opposite_edges_are_named(ranges):
    """Frequencies do not tell left from right, unless their ranges do."""
    springs = [{"translation": 1e6, "rotation": value} for value in (3.0, 20.0)]
    rotations = {f"edges.{side}.rotation": pair for side, pair in zip(("left", "right"), ranges, strict=True)}
    scene = scene_of(size=SIZE, edges=(springs[0], "supported", springs[1], "supported"), modal_density=1.0)
    exact = modes(scene, count=10).frequencies
    data = MeasuredModes("data.csv", exact, np.full(10, math.nan))
    found = fit_modes(scene.with_tables(fit={"starts": 6, "free": {**MODULI, **rotations}}), data)
    assert found.mirrored == ((tuple(rotations),) if ranges[0] == ranges[1] else ())
    assert sorted(found.values[1:]) == pytest.approx([3.0, 20.0], rel=1e-2)


@pytest.mark.parametrize("unknowns", [(0.7, 0.3), (0.6, 0.4), (0.5, 0.5), (0.2, 0.0)])
def test_mirror_images_are_found_wherever_the_optimum_lies(unknowns):
    for weights, alike in (((1.0, 1.0), True), ((1.0, 2.0), False)):
        problem = SimpleNamespace(residuals=lambda u, w=weights: np.array([np.dot(w, u), np.dot(w, u**2)]))
        found = SimpleNamespace(unknowns=np.array(unknowns), problem=problem)
        assert exchangeable(found, [(0, 1)]) is alike


@pytest.mark.parametrize(
    ("rigid", "numbers"),
    [([1e-5, 3e-3], None), ([], None), ([1.3e-5, 2.1e-4, 3.4e-3], range(1, 10))],
)
def test_rigid_motions_are_skipped(rigid, numbers):
    """NAFEMS FV12, a free square plate of steel; modes are numbered from the lowest bending mode on."""
    bending = [1.622, 2.36, 2.922, 4.233, 4.233, 7.416]
    plate = {"size": (10.0, 10.0), "thickness": 0.05, "density": 8000.0, "young_modulus": 170e9, "poisson_ratio": 0.3}
    area = {"area": (1.0, 2.0, 1.0, 2.0)}
    scene = scene_of(edges=("free",) * 4).with_tables(
        plate=plate, target=area, actuators=[{"name": "a", **area}], drive={"frequency": 5.0},
        fit={"starts": 1, "free": {"plate.young_modulus": (150e9, 260e9)}},
    )  # fmt: skip
    data = MeasuredModes("a.csv", np.array([*rigid, *bending]), np.full(len(rigid) + 6, math.nan))
    found = fit_modes(scene, data if numbers is None else replace(data, numbers=np.array(numbers)))
    np.testing.assert_array_equal(found.numbers, np.arange(1, 7))
    assert found.values == pytest.approx([200e9], rel=0.01)
    assert found.remarks == ((f"{len(rigid)} modes up to {rigid[-1]:.3g} Hz are rigid motions, which are not fitted",)
                             if rigid else ())  # fmt: skip


def changed_modes(fault, random):
    """Return Navier's frequencies with a fault, and the cause that the verdict names."""
    data = measured(random)
    frequencies = {
        "none": data.frequencies,
        "missing mode": np.delete(data.frequencies, 3),
        "further mode": np.sort([*data.frequencies[:-1], 1.13 * data.frequencies[4]]),
        "unit": 2 * np.pi * data.frequencies,
        "range": 3 * data.frequencies,
    }[fault]
    return MeasuredModes("data.csv", frequencies, np.full(len(frequencies), math.nan))


@pytest.mark.parametrize(
    "fault",
    ["none", "missing mode", "unit", *(pytest.param(f, marks=pytest.mark.slow) for f in ("further mode", "range"))],
)
def test_verdict(fault, random):
    found = fit_modes(stiff_panel(free=MODULI), changed_modes(fault, random))
    assert found.verdict.describes == np.isfinite(found.low).all() == (fault == "none")
    assert found.verdict.cause == (None if fault == "none" else fault)
    assert bool(found.warnings) == (fault != "none")
    assert found.warnings[:1] == found.verdict.lines


def test_a_thick_plate_is_named():
    """NAFEMS FV52, a supported plate whose sides are ten thicknesses long, at a tenth of its size."""
    area = {"area": (0.1, 0.2, 0.1, 0.2)}
    steel = {"size": (1.0, 1.0), "thickness": 0.1, "density": 8000.0, "young_modulus": 200e9, "poisson_ratio": 0.3}
    scene = scene_of(edges=("supported",) * 4).with_tables(
        plate=steel, target=area, actuators=[{"name": "a", **area}], drive={"frequency": 500.0},
        fit={"starts": 1, "free": {"plate.young_modulus": (100e9, 300e9)}},
    )  # fmt: skip
    frequencies = 10 * np.array([45.897, 109.44, 109.44, 167.89, 204.51, 204.51, 256.5, 256.5])
    verdict = fit_modes(scene, MeasuredModes("a.csv", frequencies, np.full(8, math.nan))).verdict
    assert (verdict.describes, verdict.cause) == (False, "thick")
    assert "% too high for the highest fitted frequency, 2565 Hz: shear and rotary inertia" in verdict.text
    lowest = fit_modes(scene, MeasuredModes("a.csv", frequencies[:3], np.full(3, math.nan))).verdict
    assert lowest.describes
    assert lowest.text.startswith("Thin-plate theory is")


@pytest.mark.parametrize(
    ("cause", "move"),
    [
        pytest.param("mirrored in x", lambda x, y: (SIZE[0] - x, y), marks=pytest.mark.slow),
        ("mirrored in y", lambda x, y: (x, SIZE[1] - y)),
        (None, None),
    ],
)
def test_shapes_at_mirrored_points_are_named(cause, move, random):
    edges, points = ("clamped", "free", "free", "supported"), random.uniform(0.01, 0.16, (12, 2))
    scene = scene_of(size=SIZE, edges=edges, fit={"starts": 1, "pairing": "mac", "free": MODULI})
    true = solve_modes(scene, highest=0.0, count=6)
    shapes = true.at_points(points)
    written = points if move is None else np.array([move(x, y) for x, y in points])
    data = MeasuredModes("a.csv", true.frequencies[:6], np.full(6, math.nan), None, shapes[:6], written)
    verdict = fit_modes(scene, data).verdict
    assert (verdict.describes, verdict.cause) == (cause is None, cause)
