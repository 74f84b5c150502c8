"""Commands on scenes with coils: impedance of frf with its files, localize, simulate, sound and sweep."""

import csv
import json
import math

import numpy as np
import pytest

from support.coils import COILS, LOSSLESS_COILS, panel
from support.commands import error_of, output_of
from support.scenes import refused
from support.scenes_of_outlines import outlined
from warp_plate import localize, simulate, specify
from warp_plate.fitting.fit import fit_responses
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.focusing.focus import focus
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.designs import scene_phasors
from warp_plate.studies.frequency_response import frf, respond_to_drive
from warp_plate.studies.sound import sound


@pytest.fixture(scope="module")
def found():
    return frf(panel(), quantity="impedance", frequency_range=(30.0, 120.0))


def test_impedances_follow_the_coils_that_are_named(found):
    assert found.labels[:4] == ["free", "free → sprung", "free → fixed", "sprung → free"]
    assert found.unit == "Ω"
    impedance, _ = solve_modes(panel(), 120.0).coils.impedance(2 * math.pi * found.frequencies)
    np.testing.assert_allclose(found.responses, impedance.mT.reshape(-1, 9).T, rtol=1e-9)
    assert [found.labels[index] for index in found.distinct] == [
        "free", "free → sprung", "free → fixed", "sprung", "sprung → fixed", "fixed"
    ]  # fmt: skip
    part = frf(panel(), ["fixed", "free"], quantity="impedance", frequency_range=(30.0, 120.0))
    np.testing.assert_allclose(part.responses, found.responses[[8, 6, 2, 0]], rtol=1e-9)
    np.testing.assert_allclose(part.mean_square_velocity, found.mean_square_velocity[[2, 0]], rtol=1e-9)


def test_error_bars_hold_the_impedance_of_a_finer_plate(found):
    finer = panel().replace("grid", {"modal_density": 1.8})
    plate = solve_modes(finer, 120.0)
    impedance, _ = plate.coils.impedance(2 * math.pi * found.frequencies)
    low, high = found.band("responses")
    values = np.abs(impedance.mT.reshape(-1, 9).T)
    assert np.all((low <= values) & (values <= high) | np.isnan(low))


def test_coils_under_the_drive_meet_ohms_law(found):
    """With one coil alone, its current is its voltage by its impedance."""
    made = panel(COILS[:1])
    alone = frf(made, quantity="impedance", frequency_range=(200.0, 400.0))
    np.testing.assert_allclose(alone.coils.current[0], 2.0 / alone.responses[0], rtol=1e-9)
    np.testing.assert_allclose(alone.coils.electrical_power[0], 2.0 * (1 / alone.responses[0]).real, rtol=1e-9)
    assert made.drive.frequency in alone.frequencies
    mobility = frf(made, frequency_range=(200.0, 400.0)).coils
    np.testing.assert_allclose(mobility.stroke, alone.coils.stroke)


def test_a_coil_around_a_hole():
    """Its middle is off the plate, and a hole much smaller than its foot changes little."""
    coil = {**COILS[0], "disc": (0.09, 0.07, 0.02)}
    holed = outlined({"rectangle": (0.2, 0.16)}, holes=[{"disc": (0.09, 0.07, 0.004)}], damping=20.0, modal_density=0.6)
    whole = frf(
        outlined({"rectangle": (0.2, 0.16)}, damping=20.0, modal_density=0.6).with_tables(actuators=[coil]),
        quantity="impedance",
        frequency_range=(50.0, 90.0),
    )
    around = frf(holed.with_tables(actuators=[coil]), quantity="impedance", frequency_range=(50.0, 90.0))
    np.testing.assert_allclose(around.coils.current[0], 2.0 / around.responses[0], rtol=1e-9)
    np.testing.assert_allclose(around.responses[0, 0], whole.responses[0, 0], rtol=0.02)


def test_json_files_and_text(command, found, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "coils.toml").write_text(panel().to_toml(), encoding="utf-8")
    words = ["frf", str(tmp_path / "coils.toml"), "--quantity", "impedance", "--range", "30:120", "--out", "z.svg"]
    record = json.loads(output_of(command(*words, "--json", "--to", "csv", "--to", "hdf5")))
    assert record["unit"] == "Ω"
    assert record["pairs"][1] == {"from": "free", "at": [0.12, 0.115]}
    np.testing.assert_allclose(
        np.array(record["real"]) + 1j * np.array(record["imaginary"]), found.responses, rtol=1e-6
    )
    coils = record["coils"]
    assert coils["names"] == ["free", "sprung", "fixed"]
    np.testing.assert_allclose(coils["current"]["real"], found.coils.current.real, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(coils["electrical_power"], found.coils.electrical_power, rtol=1e-6)
    with open("z.csv", encoding="utf-8") as file:
        heading, first, *_ = csv.reader(file)
    row = dict(zip(heading, map(float, first), strict=True))
    assert row["Re free → sprung [Ω]"] == pytest.approx(found.responses[1, 0].real, rel=1e-6)
    assert row["Im stroke, fixed [m]"] == pytest.approx(found.coils.stroke[2, 0].imag, rel=1e-6)
    out = output_of(command("frf", str(tmp_path / "coils.toml"), "--range", "200:400", "--no-pictures"))
    for part in ("Coils under the scene's drive at 290 Hz", "stroke (mm)", "sprung"):
        assert part in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--at", "0.1,0.1"), "--at (0.1, 0.1): the impedance is that of terminals of coils; leave out points"),
        (("--from", "pressed"), "--from pressed: is no coil; there are free, sprung, fixed"),
    ],
)
def test_what_has_no_impedance_is_named(command, tmp_path, words, message):
    (tmp_path / "coils.toml").write_text(panel().to_toml(), encoding="utf-8")
    line = error_of(command("frf", str(tmp_path / "coils.toml"), "--quantity", "impedance", *words))
    assert line == f"warp-plate: {message}\n"


def test_a_scene_without_coils_has_no_impedance():
    line = refused(frf, panel(COILS[3:]), quantity="impedance")
    assert line == 'quantity = "impedance": no actuator is a coil; write kind = "coil" for one of them'
    assert frf(panel(COILS[3:]), frequency_range=(50, 100)).coils is None


def test_localize_reaches_the_bound_of_frf():
    rows = [{**row, "current": None, "voltage": 1.0} for row in COILS[:3]]
    made = panel(rows).with_accuracy(0.01)
    result = localize(made, device="cpu")
    response = frf(made, frequency_range=(280.0, 300.0))
    at = int(np.searchsorted(response.frequencies, 290.0))
    assert result.main_case.localization_factor == pytest.approx(response.bound[at], rel=1e-3)
    own = simulate(made, device="cpu", estimate=False)
    assert own.main_case.localization_factor == pytest.approx(response.localization_factor[at], rel=1e-3)


def test_other_studies_take_the_drive_of_coils():
    made = panel()
    heard = sound(made, frequency_range=(280.0, 300.0))
    response = frf(made, frequency_range=(280.0, 300.0))
    factor = np.interp(290.0, response.frequencies, response.localization_factor)
    assert heard.localization_factor[heard.at_drive] == pytest.approx(factor, rel=1e-6)
    velocity, of_sweep, _ = respond_to_drive(made, np.array([290.0]))
    assert of_sweep[0] == pytest.approx(factor, rel=1e-4)
    doubled = [row.model_dump() for row in made.actuators]
    for row in doubled:
        for key in ("voltage", "current", "force"):
            row[key] = row[key] and 2 * row[key]
    assert respond_to_drive(panel(doubled), np.array([290.0]))[0][0] == pytest.approx(4 * velocity[0], rel=1e-9)


def test_units_without_a_common_scale_are_not_searched():
    line = refused(localize, panel(), device="cpu")
    assert line.startswith("actuators: magnitudes in V or A or N/m² have no common scale; ")


def test_coils_beside_piezo_patches():
    """Beside a coil without mass and current, a piezo patch acts as alone."""
    patch = {"name": "piezo", "kind": "piezo", "area": (0.02, 0.06, 0.03, 0.08), "magnitude": 10.0}
    patch |= {"d31": -1.9e-10, "thickness": 2e-4, "young_modulus": 6.3e10}
    idle = {"name": "idle", "kind": "coil", "disc": (0.12, 0.1, 0.01), "voltage": 0.0, "force_factor": 1.0}
    both = panel([patch, {**idle, "resistance": 1e9}])
    alone = panel([patch])
    responses = [respond_to_drive(made, np.array([70.0, 290.0])) for made in (both, alone)]
    np.testing.assert_allclose(responses[0][0], responses[1][0], rtol=1e-6)


LIMITS = {"voltage": 3.0, "current": 0.4, "heat": 0.5, "stroke": 2e-4, "force": 1.0, "power": 0.5}


def specified(limits, level=0.1, **keys):
    rows = {"level": {"acceleration_g": level}, "limits": limits, **keys}
    return panel().with_tables(target={"area": (0.05, 0.08, 0.04, 0.07)}, specification=rows)


def test_margins_of_coils_are_those_of_the_driven_scene():
    """Discs and all: what is answered by other functions is that of enough of the usual ones."""
    scene = specified(LIMITS, elsewhere={"relative_db": 0.0, "measure": "mean"})
    answer = specify(scene.replace("grid", {"modal_density": 1.2}))
    margins = {row.requirement: row.reached for row in answer.margins}
    driven = frf(answer.driven_scene(), frequency_range=(289.0, 291.0))
    at = int(np.searchsorted(driven.frequencies, 290.0))
    coils, names = driven.coils, ("free", "sprung", "fixed")
    assert [margins[f"current of {name}"] for name in names[:2]] == pytest.approx(
        np.abs(coils.current[:2, at]), rel=3e-4
    )
    assert margins["voltage of fixed"] == pytest.approx(abs(coils.voltage[2, at]), rel=3e-4)
    strokes = [margins[f"stroke of {name}"] for name in names]
    assert strokes == pytest.approx(1e3 * np.abs(coils.stroke[:, at]), rel=3e-4)
    # The heat of a coil is what its electrical power leaves over.
    heat = coils.electrical_power[:, at] - coils.mechanical_power[:, at]
    assert [margins[f"heat of {name}"] for name in names] == pytest.approx(heat, rel=3e-4)
    plate, phasors = solve_modes(answer.driven_scene(), 290.0), scene_phasors(answer.driven_scene())
    velocity = 2j * math.pi * 290.0 * plate.respond_to_drive(np.array([290.0]), phasors)[0, :, 0]
    pressed = (np.conj(plate.actuator_forces()[:, 3] * phasors[3]) @ velocity).real / 2
    assert margins["power"] == pytest.approx(coils.mechanical_power[:, at].sum() + pressed, rel=3e-4)
    assert answer.units == ("V", "V", "A", "N")


@pytest.mark.parametrize("key", ["current", "heat", "stroke", "voltage"])
def test_a_limit_of_coils_bounds_the_level(key):
    """A small one is in the way, with a proof."""
    answer = specify(specified({**dict.fromkeys(LIMITS, 1e3), key: 1e-6}, level=5.0))
    assert not answer.feasible
    assert answer.proved


def test_large_limits_of_coils_allow_the_level():
    assert specify(specified(dict.fromkeys(LIMITS, 1e3), level=5.0)).feasible


def test_limits_of_coils_need_coils():
    line = refused(
        panel(COILS[3:]).with_tables, specification={"level": {"acceleration_g": 1.0}, "limits": {"heat": 1.0}}
    )
    assert line == "specification.limits.heat: not of actuators that press; write force"


def test_studies_without_coils_say_so():
    made = panel(COILS[:1]).with_accuracy(0.01)
    with_fit = made.with_tables(
        fit={"free": {"plate.density": (500.0, 2000.0)}}, measurement=[{"point": (0.05, 0.05), "force_at": (0.1, 0.1)}]
    )
    measured = MeasuredResponses("x", np.array([100.0, 200.0]), np.ones((1, 2), dtype=complex), None)
    line = refused(fit_responses, with_fit, measured)
    assert line == "actuators[0].kind: responses are fitted without coils; measure the panel before they are mounted"
    table = {"points": [(0.05, 0.05)], "highest": 500.0}
    line = refused(focus, panel(COILS[:1]).with_tables(focus=table))
    assert line.startswith("actuators[0].eddy_resistance: has no motion in time; write eddy_branches in place of")
    line = refused(focus, panel(LOSSLESS_COILS[:3:2]).with_tables(focus=table))
    assert line == "actuators: waveforms in V or A have no common scale; focus by actuators of one unit"
