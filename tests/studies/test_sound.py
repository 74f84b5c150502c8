"""The sound of a drive: levels of a mode in resonance, reciprocity, outlines, the A-weighting, and the command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from support.commands import error_of, output_of
from support.scenes import refused, scene_of
from support.scenes_of_outlines import outlined
from warp_plate import Scene, specify
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import Air
from warp_plate.quantities.sound_levels import a_weighting
from warp_plate.studies.frequency_response import frf
from warp_plate.studies.sound import sound

# Frequencies [Hz] and values [dB] of IEC 61672-1, table 3.
A_WEIGHTING = {31.5: -39.4, 63: -26.2, 125: -16.1, 250: -8.6, 1000: 0.0, 2000: 1.2, 4000: 1.0, 8000: -1.1}
POINT = (0.3, -0.1, 0.8)


def test_the_a_weighting_is_that_of_the_standard():
    exact = np.array([1000 * 10 ** (round(10 * math.log10(f / 1000)) / 10) for f in A_WEIGHTING])
    np.testing.assert_allclose(a_weighting(exact), list(A_WEIGHTING.values()), atol=0.06)
    assert a_weighting(np.array([1000.0])) == pytest.approx(0, abs=1e-6)


def test_a_small_plate_is_a_point_source():
    """Far away and at low frequencies, the pressure is that of the volume that it moves."""
    made = scene_of(size=(0.02, 0.02), damping=50.0, frequency=100.0)
    found = sound(made, [(0.01, 0.01, 3.0)], (50.0, 200.0))
    level, power = np.abs(found.pressures[0, found.at_drive]), found.power[found.at_drive]
    air = Air()
    assert power == pytest.approx(level**2 / (2 * air.density * air.sound_speed) * 2 * math.pi * 9.0, rel=1e-3)
    assert np.ptp(found.directivity) < 0.1
    assert found.power_level[found.at_drive] == pytest.approx(10 * math.log10(power / 1e-12))


def test_levels_follow_the_drive():
    made = scene_of(damping=20.0, modal_density=0.4)
    loud = made
    for index in range(3):
        loud = loud.replace(f"actuators[{index}].magnitude", 10 * made.actuators[index].magnitude)
    quiet, loud = (sound(scene, [POINT], (100.0, 400.0)) for scene in (made, loud))
    np.testing.assert_allclose(loud.power_level - quiet.power_level, 20.0)
    np.testing.assert_allclose(loud.pressure_levels - quiet.pressure_levels, 20.0)
    np.testing.assert_allclose(loud.efficiency, quiet.efficiency)
    assert quiet.frequencies[quiet.at_drive] == made.drive.frequency
    assert np.all((quiet.efficiency > 0) & (quiet.efficiency < 1.2))


def test_a_disc_sounds_the_same_to_all_sides():
    made = outlined({"disc": (0.1, 0.1, 0.1)}, actuators=[(0.09, 0.11, 0.09, 0.11)], modal_density=0.8, damping=10.0)
    found = sound(made, [(0.4, 0.1, 0.5), (0.1, -0.2, 0.5)], (280.0, 300.0))
    np.testing.assert_allclose(found.pressures[0], found.pressures[1], rtol=1e-6)
    np.testing.assert_allclose(found.directivity[0], found.directivity[1], atol=1e-6)


def test_json_files_picture_and_text(command, write_scene):
    pytest.importorskip("matplotlib")
    made = write_scene(damping=10.0, modal_density=0.4)
    asked = ("--at", "0.3,-0.1,0.8", "--range", "100:400")
    expected = sound(made, [POINT], (100.0, 400.0))
    record = json.loads(output_of(command("sound", "panel.toml", *asked, "--json", "--to", "csv", "--out", "s.svg")))
    for name in ("frequencies", "power", "power_level", "efficiency", "localization_factor"):
        assert record[name] == pytest.approx(getattr(expected, name).tolist(), rel=1e-6)
    assert record["pressure_levels"] == [pytest.approx(expected.pressure_levels[0].tolist())]
    assert record["files"] == ["s.csv", "s.svg"]
    rows = np.loadtxt("s.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, 1], expected.power, rtol=1e-6)
    for words in ("sound power", "A-weighted", "frequency [Hz]", "(0.3, −0.1, 0.8) m"):
        assert f"<!-- {words} -->" in Path("s.svg").read_text(encoding="utf-8")
    out = output_of(command("sound", "panel.toml", *asked, "--no-pictures", "--out", "s.h5"))
    for part in ("100 to 400 Hz", "the drive's", "0.3,-0.1,0.8", "wrote s.h5"):
        assert part in out


def test_a_panel_without_a_baffle_by_the_command(command, write_scene):
    made = write_scene(damping=10.0, modal_density=0.4, frequency=60.0)
    asked = ("--at", "0.3,-0.1,0.8", "--range", "55:65", "--unbaffled", "--no-pictures")
    record = json.loads(output_of(command("sound", "panel.toml", *asked, "--json", "--out", "s.csv")))
    expected = sound(made, [POINT], (55.0, 65.0), baffle=False)
    assert record["power"] == pytest.approx(expected.power.tolist(), rel=1e-6)
    assert record["pressure_levels"] == [pytest.approx(expected.pressure_levels[0].tolist())]
    in_baffle = json.loads(output_of(command("sound", "panel.toml", *asked[:-2], "--no-pictures", "--json")))
    assert record["power"] != pytest.approx(in_baffle["power"], rel=0.1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--at", "0.1,0.1"), "--at 0.1,0.1: must be X,Y,Z in metres"),
        (("--at", "0,0,1", "--at", "0.1,0.1,-1"), "--at 0.1,0.1,-1: must lie in front of the plate"),
        (("--range", "20:100"), "must hold the drive's frequency of 290 Hz"),
        (("--range", "400:100"), "--range 400:100: must be LOW:HIGH"),
    ],
)
def test_what_is_refused(command, write_scene, words, message):
    write_scene(damping=10.0, modal_density=0.4)
    assert message in error_of(command("sound", "panel.toml", *words))
    assert [path.name for path in Path().iterdir()] == ["panel.toml"]


def test_nonlinear_scenes_are_refused():
    assert "effects.stretching" in refused(sound, scene_of(effects={"stretching": {}}))


@pytest.fixture(scope="module")
def quiet_console():
    """The answer for the console with a limit of sound."""
    keys = ["specification.frequency=225.0", "specification.guard=0.03", "specification.limits.sound=45.0"]
    keys.append("specification.limits.pressures=[{point=[0.1,0.1,1.0],level=50}]")
    return specify(Scene.load("console", [*keys, "specification.elsewhere.relative_db=3", "grid={modal_density=0.6}"]))


def test_limits_of_sound_are_those_in_the_air_of_the_scene():
    """The radiated power and the pressure at a point are those that ``sound`` computes in a heavier gas."""
    keys = ["specification.frequency=225.0", "specification.limits.sound=90.0", "effects.air={density=6.0}"]
    keys.append("grid={modal_density=0.6}")
    point = {"point": (0.1, 0.05, 0.5), "level": 90.0}
    scene = Scene.load("console", keys).replace("specification.limits.pressures", [point])
    answer = specify(scene, tolerances=False)
    heard = sound(answer.driven_scene(), [point["point"]], (224.0, 226.0))
    levels = np.array([heard.power_level, heard.pressure_levels[0]]) + heard.weighting
    reached = [row.reached for row in answer.margins if row.unit == "dB(A)"]
    np.testing.assert_allclose(reached, levels[:, heard.at_drive], atol=0.02)


def test_the_drive_of_a_specification_keeps_its_limit_of_sound(quiet_console):
    margin = next(margin for margin in quiet_console.margins if margin.requirement == "sound")
    heard = sound(quiet_console.driven_scene(), [(0.1, 0.1, 1.0)], (224.0, 226.0))
    level = heard.power_level[heard.at_drive] + heard.weighting[heard.at_drive]
    assert margin.reached == pytest.approx(level, abs=0.01)
    assert margin.reached <= 45.0 + 1e-5
    margin = next(margin for margin in quiet_console.margins if margin.requirement == "sound at 0.1,0.1,1 m")
    level = heard.pressure_levels[0, heard.at_drive] + heard.weighting[heard.at_drive]
    assert margin.reached == pytest.approx(level, abs=0.01)
    assert margin.unit == "dB(A)"
    assert quiet_console.bound_db == pytest.approx(quiet_console.contrast_db, abs=1e-4)


def test_no_quiet_drive_has_less_than_the_proved_contrast(quiet_console, random):
    """By Rayleigh's double integral over nodes 5 mm apart, for 3000 drives near the best and far from it."""
    scene = quiet_console.scene
    plate = solve_modes(scene, 225.0)
    (width, height), air, omega = scene.plate.size, Air(), 2 * math.pi * 225.0
    x, y = np.linspace(0, width, 63), np.linspace(0, height, 27)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    amplitudes = plate.respond(np.array([225.0]), plate.actuator_forces())[0] / scene.unit_drives
    motion = -(omega**2) * plate.at_points(points).T @ amplitudes
    distances = np.linalg.norm(points[:, None] - points, axis=-1)
    k, ends = omega / air.sound_speed, [np.where((at == 0) | (at == at[-1]), 0.5, 1.0) for at in (y, x)]
    weights = np.outer(*ends).ravel() * width * height / (62 * 26)
    kernel = air.density * air.sound_speed * k**2 / (2 * math.pi) * np.sinc(k * distances / math.pi)
    kernel *= np.outer(weights, weights)
    velocity = motion / (1j * omega)
    power = velocity.conj().T @ kernel @ velocity / 2
    x0, x1, y0, y1 = scene.target.area
    beyond = np.maximum(np.maximum([x0, y0] - points, points - [x1, y1]), 0)
    aside = np.hypot(*beyond.T)
    turn = np.linspace(0, 2 * math.pi, 241)
    corners = np.column_stack([np.where(np.cos(turn) > 0, x1, x0), np.where(np.sin(turn) > 0, y1, y0)])
    rim = corners + 0.03 * np.column_stack([np.cos(turn), np.sin(turn)])  # of the guard
    on_rim = -(omega**2) * plate.at_points(rim).T @ amplitudes
    inside, outside = motion[aside < 1e-9], np.concatenate([motion[aside > 0.03 - 1e-9], on_rim])
    best = quiet_console.drive
    spread = 10 ** random.uniform(-4, 1, (3000, 1)) * np.abs(best).max()
    drives = best + spread * (random.normal(size=(3000, 6)) + 1j * random.normal(size=(3000, 6)))
    at_target = inside @ drives.T
    in_phase = (at_target * np.exp(-1j * np.angle(at_target.mean(axis=0)))).real.min(axis=0)
    drives *= (9.80665 / np.maximum(in_phase, 1e-9))[:, None]
    limit = 10 ** ((45.0 - a_weighting(np.array(225.0))) / 10) * 1e-12
    radiated = np.einsum("di,ij,dj->d", drives.conj(), power, drives).real
    permitted = (np.abs(drives) <= 0.5).all(axis=1) & (radiated <= limit)
    contrast = 20 * np.log10(np.abs(outside @ drives.T).max(axis=0) / 9.80665)
    assert permitted.sum() > 20
    assert contrast[permitted].min() >= quiet_console.bound_db - 0.1  # a maximum between nodes is up to 0.1 dB higher


SOUNDS = ("sound_power", "radiation_efficiency", "sound_pressure")


@pytest.fixture(scope="module", params=[True, False], ids=["baffle", "open"])
def spectra(request):
    """A scene of one actuator, its sound, and its responses by quantity; in a baffle or without one."""
    made = scene_of(damping=20.0, actuators=[(0.05, 0.09, 0.06, 0.11)], modal_density=0.4, frequency=40.0)
    options = {"frequency_range": (35.0, 45.0), "baffle": request.param}
    heard = sound(made, [POINT], **options)
    found = {
        name: frf(made, points=[POINT] if name == "sound_pressure" else (), quantity=name, **options) for name in SOUNDS
    }
    return made, heard, found


def test_responses_of_sound_are_the_sound_of_one_newton(spectra):
    """The sound of a drive is that of its force, by the responses that ``frf`` computes."""
    made, heard, found = spectra
    force = made.actuators[0].magnitude * made.actuators[0].patch_area
    at = [np.searchsorted(heard.frequencies, one.frequencies) for one in found.values()]
    power, efficiency, pressure = (one.responses[0] for one in found.values())
    np.testing.assert_allclose(power * force**2, heard.power[at[0]], rtol=1e-9)
    np.testing.assert_allclose(efficiency, heard.efficiency[at[1]], rtol=1e-9)
    np.testing.assert_allclose(pressure * force, heard.pressures[0, at[2]], rtol=1e-9)
    level = found["sound_power"].level(np.abs(power)) + 20 * math.log10(force)
    np.testing.assert_allclose(level, heard.power_level[at[0]], atol=1e-9)
    level = found["sound_pressure"].level(np.abs(pressure)) + 20 * math.log10(force)
    np.testing.assert_allclose(level, heard.pressure_levels[0, at[2]], atol=1e-9)
    assert [one.unit for one in found.values()] == ["W/N²", "1", "Pa/N"]
    assert [one.labels for one in found.values()] == [["0"], ["0"], ["0 → 0.3,-0.1,0.8"]]


def test_error_bars_hold_the_sound_of_a_finer_plate(spectra):
    made, heard, found = spectra
    for name, one in found.items():
        points = [POINT] if name == "sound_pressure" else ()
        finer = frf(made.replace("grid.modal_density", 0.8), points=points, frequency_range=(35.0, 45.0),
                    quantity=name, baffle=heard.baffle)  # fmt: skip
        values = np.interp(one.frequencies, finer.frequencies, np.abs(finer.responses[0]))
        low, high = one.band("responses")
        assert np.all((low[0] <= values) & (values <= high[0] * 1.01) | np.isnan(low[0]))


@pytest.mark.parametrize("quantity", SOUNDS)
def test_responses_of_sound_by_the_command(command, write_scene, quantity):
    pytest.importorskip("matplotlib")
    made = write_scene(damping=10.0, modal_density=0.4)
    asked = ["--from", "0", "--range", "50:100", "--quantity", quantity]
    expected = frf(made, ["0"], (), (50.0, 100.0), quantity)
    words = ["--json", "--to", "csv", "--to", "hdf5", "--out", "s.svg"]
    record = json.loads(output_of(command("frf", "panel.toml", *asked, *words)))
    size = np.abs(expected.responses).max()
    assert record["real"] == [pytest.approx(expected.responses[0].real.tolist(), abs=1e-6 * size)]
    of_plate = quantity != "sound_pressure"
    assert record["pairs"] == [{"from": "0", "at": [] if of_plate else [0.05, 0.05, 1.0]}]
    assert ("level" in record) == (quantity != "radiation_efficiency")
    words = {"sound_power": "sound power level", "radiation_efficiency": "radiation efficiency [1]"}
    drawn = Path("s.svg").read_text(encoding="utf-8")
    assert f"<!-- {words.get(quantity, 'sound pressure level')} -->" in drawn
    assert ("<!-- phase [°] -->" in drawn) != of_plate
    out = output_of(command("frf", "panel.toml", *asked, "--no-pictures"))
    assert (quantity.replace("_", " ") in out, "phase" in out) == (True, not of_plate)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("sound_power", "--at", "0.1,0.1"), "the sound_power is that of the whole plate; leave out points"),
        (("sound_pressure", "--at", "0.1,0.1"), "--at 0.1,0.1: must be X,Y,Z in metres"),
        (("sound_pressure", "--at", "0.1,0.1,-1"), "--at 0.1,0.1,-1: must lie in front of the plate"),
        (("mobility", "--unbaffled"), "--quantity mobility: only sound is that of plates without a baffle"),
    ],
)
def test_what_responses_of_sound_refuse(command, write_scene, words, message):
    write_scene(damping=10.0)
    assert message in error_of(command("frf", "panel.toml", "--no-pictures", "--quantity", *words))
