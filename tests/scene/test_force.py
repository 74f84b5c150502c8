"""``force`` of an actuator: the total force of its patch, in place of the pressure ``magnitude``."""

import numpy as np
import pytest

from support.scenes import PAPER, refusal, scene_of
from warp_plate import Scene, SceneError
from warp_plate.cli import output
from warp_plate.cli.tables import drive_json, print_drive
from warp_plate.plate.designs import patch_ends, scene_phasors, scene_with
from warp_plate.plate.scheme import discretize
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.case import Case
from warp_plate.result.export import make_drive_signal
from warp_plate.scene.keys import label_of, resolved_key, unit_of
from warp_plate.studies.simulate import simulate

PATCH = (0.03, 0.06, 0.05, 0.07)  # 6e-4 m²
AREA = 6e-4
PATCH_AREAS = np.array([AREA, 2.5e-3])


def pressed(force=None, magnitude=None, **tables):
    """Return a scene with this force [N] or magnitude [N/m²] on PATCH, beside an actuator of magnitude 1."""
    given = {key: value for key, value in (("force", force), ("magnitude", magnitude)) if value is not None}
    rows = [{"name": "a", "area": PATCH, **given}, {"name": "b", "area": (0.1, 0.15, 0.1, 0.15)}]
    return scene_of(**tables).with_tables(actuators=rows)


def test_a_force_is_the_pressure_times_the_area():
    made, same = pressed(force=-0.3), pressed(magnitude=-500.0)
    assert made.actuators[0].magnitude == pytest.approx(-500)
    np.testing.assert_allclose(scene_phasors(made), [-500, 1])
    # Patches by overlap keep the force: the sum of pressure times covered area over all nodes.
    grid = discretize(made)
    assert made.actuators[0].magnitude * grid.patches[0].sum() * grid.cell == pytest.approx(-0.3)
    energy, expected = (simulate(scene, device="cpu", estimate=False).cases["drive"].energy for scene in (made, same))
    assert energy == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("force", [0.0, 0.3, -1 / 3, 1e20])
def test_it_survives_dumps_and_copies(force):
    made = pressed(force=force)
    assert made.actuators[0].force == force
    for again in (made.with_tables(), Scene.parse(made.to_toml(), ""), made.with_values({})):
        assert again == made
    text = made.to_toml()
    assert ("force = " in text, text.count("magnitude = ")) == (True, 1)  # that of the other actuator
    assert Scene.from_tables(made.model_dump(mode="json")) == made


def test_it_is_varied_and_stays_when_the_patch_changes():
    for made in (pressed(force=0.3), pressed(magnitude=5.0)):
        changed = made.with_values({"actuators[0].force": 0.6}).actuators[0]
        assert (changed.force, changed.magnitude) == (0.6, pytest.approx(1000))
        changed = made.with_values({"actuators[0].magnitude": 7.0}).actuators[0]
        assert (changed.force, changed.magnitude) == (None, 7.0)
        with pytest.raises(SceneError, match=r"^actuators\[0\]\.force: .* beside magnitude = 7"):
            made.with_values({"actuators[0].force": 0.6, "actuators[0].magnitude": 7.0})
    wider = pressed(force=0.3).with_values({"actuators[0].area[1]": 0.09}).actuators[0]
    assert (wider.force, wider.magnitude) == (0.3, pytest.approx(250))
    key = resolved_key(made, "actuators.a.force")
    assert (key, unit_of(made, key), label_of(made, key)) == ("actuators[0].force", "N", "actuator a force")


def test_other_drives_places_and_scenarios():
    made = pressed(force=0.3, search={"robust": {"place": 0.01, "thickness": 0.05}})
    other = scene_with(made, magnitude=np.array([2.0, 3.0]))
    assert [(row.force, row.magnitude) for row in other.actuators] == [
        (pytest.approx(2 * AREA), pytest.approx(2.0)),
        (None, 3.0),
    ]
    moved = scene_with(made, centre=patch_ends(made.actuators).mean(axis=2) + 0.003).actuators[0]
    assert (moved.force, moved.magnitude) == (0.3, pytest.approx(500))
    for drawn in draw_scenarios(made, 3, 0):
        row = drawn.scene.actuators[0]
        assert row.area != PATCH
        assert (row.force, row.magnitude) == (0.3, pytest.approx(500))


@pytest.mark.parametrize(("magnitude", "heading"), [(None, "force (N)"), (1.0, "force or magnitude")])
def test_a_drive_comes_back_in_newtons(magnitude, heading, capsys):
    second = {"force": 1.0} if magnitude is None else {"magnitude": magnitude}
    made = pressed(force=0.3).with_tables(
        actuators=[{"name": "a", "area": PATCH, "force": 0.3}, {"name": "b", "area": (0.1, 0.15, 0.1, 0.15), **second}]
    )
    case = Case(np.array([500j, -250]), {}, np.zeros(0), np.zeros(0))
    print_drive(case, made, output.console(width=80))
    lines = [line.split("  ") for line in capsys.readouterr().out.splitlines() if line.strip()]
    _, headings, *rows = [[cell.strip() for cell in line if cell] for line in lines]
    assert headings[1] == heading
    amplitudes = [float(row[1].split()[0]) for row in rows]
    assert amplitudes == pytest.approx([0.3, 0.625 if magnitude is None else 250])
    assert drive_json(case, made)[0] == {
        "actuator": "a",
        "force": pytest.approx(0.3),
        "phase": pytest.approx(1.5 * np.pi),
    }
    assert ("magnitude" in drive_json(case, made)[1]) == (magnitude is not None)
    again = Scene.parse(scene_with(made, case.magnitude, case.phase).to_toml(), "")
    np.testing.assert_allclose(scene_phasors(again), case.phasors, rtol=1e-12, atol=1e-9)
    signal = make_drive_signal(made, case, 48000, 0.1)
    factors = (PATCH_AREAS if magnitude is None else 1) * case.phasors
    assert signal.unit == ("N" if magnitude is None else "N/m²")
    np.testing.assert_allclose(signal.phasors * signal.full_scale, factors, rtol=1e-12)
    # The limit that the scene says is full scale, although force / area · area may be more in its last digit.
    full_scale = float(np.abs(factors).max()) * (1 - 1e-15)
    assert make_drive_signal(made, case, 48000, 0.1, full_scale).full_scale == pytest.approx(full_scale)


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ("force = 1.0\nmagnitude = 1.0", "actuators[4].force: 1 N, beside magnitude = 1; delete one of them"),
        ("force = 1e28", "actuators[4].force: 1e+28 N on 0.0001 m² press with 1e+32 N/m²"),
        ("force = inf", "actuators[4].force = inf: must be a finite number"),
        ("force = 1.0\n[drive.electrostatic]\ngain = 1.0", "actuators[4].force: 1 N, but drive.electrostatic"),
    ],
)
def test_refusals(keys, line):
    assert refusal(f"{PAPER}[[actuators]]\nname = 'more'\narea = [0.09, 0.1, 0.09, 0.1]\n{keys}").startswith(line)


def test_a_wrong_area_is_the_fault_reported():
    text = f"{PAPER}[[actuators]]\nname = 'more'\nforce = 1.0\narea = "
    assert refusal(text + "[0.1, 0.1, 0.0, 0.1]").startswith("actuators[4].area")
    assert refusal(text + "[0.1, 0.1]").startswith("actuators[4].area")
