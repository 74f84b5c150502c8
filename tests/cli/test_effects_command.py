"""``warp-plate effects``, the warnings of ``simulate`` and ``localize``, and the presets that name effects."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver, Scene
from warp_plate.analysis import influence
from warp_plate.analysis.effect_toggles import DRIVES, bare_scene, is_on
from warp_plate.analysis.influence import measure_influence
from warp_plate.analysis.warnings import find_warnings, warning_texts
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.effects import Damping, Effects
from warp_plate.scene.search import Search
from warp_plate.solve.specialize import effect_names

NEW = {
    "touch-panel": {"edges", "damping", "material_damping", "oscillators"},
    "cantilever-display": {"edges", "damping", "layers"},
    "composite-panel": {"damping", "material_damping", "orthotropic"},
    "large-amplitude": {"damping", "stretching"},
}


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Short timed runs: what they show is not looked at."""
    monkeypatch.setattr(influence, "TIMED_NODE_STEPS", {"cpu": 1e4, "cuda": 1e6})
    monkeypatch.setattr(influence, "ROUNDS", 2)


@pytest.fixture
def panel(tmp_path, monkeypatch, scene):
    """A small scene in a file of the working folder."""
    monkeypatch.chdir(tmp_path)
    made = scene(damping=88.5, effects={"stretching": {}, "damping": {"viscous": 88.5}})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    return made


def by_name(found):
    return {switch.name: switch for switch in found.toggles}


def numbers(scene, peak=0.0):
    return {number.name: number for number in find_warnings(scene, peak)}


def test_json(command, panel):
    status, out, err = command("effects", "panel.toml", "--device", "cpu", "--json")
    assert (status, err) == (0, "")
    answer = json.loads(out)
    effects = {row["name"]: row for row in answer["effects"]}
    assert list(effects) == ["edges", *Effects.model_fields, "own_frequencies", *DRIVES]
    assert {name for name, row in effects.items() if row["on"]} == {"damping", "stretching"}
    assert effects.pop("signal")["alternative"] == "no typical value is known"
    assert all(math.isfinite(row["price"]) for row in effects.values())
    assert answer["bare_step_seconds"] > 0
    assert len(answer["numbers"]) == 5
    assert answer["warnings"] == [number["sentence"] for number in answer["numbers"] if number["exceeded"]]


def test_table(command, panel):
    status, out, err = command("effects", "panel.toml", "--device", "cpu")
    assert (status, err) == (0, "")
    text = " ".join(out.split())
    assert "without stretching: left out" in text
    assert "with oscillators: a fingertip" in text
    for number in find_warnings(panel, 0.0)[1:]:
        assert number.sentence in text


def test_influence_is_that_of_a_run_without_the_effect(panel):
    """Switched off by hand: the same numbers."""
    effects = panel.effects.model_copy(update={"damping": None})
    run = PlateSolver(panel.model_copy(update={"effects": effects}), "cpu").run(scene_phasors(panel)[None])
    switch = by_name(measure_influence(panel, "cpu"))["damping"]
    assert switch.localization_factor == pytest.approx(run.energy[0, 1] / run.energy[0, 0], rel=1e-9)


def test_a_strong_drive_stretches(scene):
    """Without stretching, displacements are in proportion to the drive; with it, a plate driven to twice its thickness
    moves less, and one driven weakly the same."""
    made = scene(effects={"stretching": {}}, frequency=35.0)
    weak, strong = (
        measure_influence(
            made.model_copy(
                update={"actuators": tuple(one.model_copy(update={"magnitude": pressure}) for one in made.actuators)}
            ),
            "cpu",
        )
        for pressure in (1e-6, 30.0)
    )
    assert by_name(weak)["stretching"].peak == pytest.approx(weak.peak, rel=1e-6)
    linear = by_name(strong)["stretching"].peak
    assert linear == pytest.approx(30.0 / 1e-6 * weak.peak, rel=1e-6)
    assert strong.peak < 0.9 * linear


def test_fourth_order_says_why_effects_are_refused(scene):
    found = by_name(measure_influence(scene(order=4, damping=10.0), "cpu"))
    assert found["damping"].price is not None
    for name in ("edges", "tension", "layers", "stretching"):
        assert found[name].price is None
        assert "grid.order = 4" in found[name].alternative


def test_a_step_too_long_for_the_other_state_is_replaced(scene):
    """Material damping lowers the limit below a step that is just right without it."""
    limit = PlateSolver(scene(), "cpu").specialized.scheme.limit
    switch = by_name(measure_influence(scene(time_step=limit), "cpu"))["material_damping"]
    assert "with its own time step of" in switch.alternative
    assert switch.steps > 1


def test_the_bare_plate_is_plain(scene):
    made = scene(edges=("free", "supported", {"rotation": 1.0}, "clamped"), damping=3.0)
    made = made.with_tables(drive={"frequency": 290.0, "burst": {"duration": 0.01}, "electrostatic": {"gain": 1.0}})
    bare = bare_scene(made)
    assert effect_names(bare) == ()
    assert (bare.edges.left, bare.edges.bottom, bare.edges.right) == ("clamped", "supported", "clamped")
    for name in ("edges", "burst", "electrostatic"):
        assert is_on(made, name)
        assert not is_on(bare, name)


def test_displacement_against_thickness(scene):
    thickness = scene().plate.thickness
    assert not numbers(scene(), 0.19 * thickness)["displacement / thickness"].exceeded
    assert numbers(scene(), 0.21 * thickness)["displacement / thickness"].exceeded
    assert numbers(scene(), math.nan)["displacement / thickness"].exceeded
    named = numbers(scene(effects={"stretching": {}}), 3 * thickness)["displacement / thickness"]
    assert named.value == pytest.approx(3)
    assert not named.exceeded
    assert any("[effects.stretching]" in sentence for sentence in warning_texts(scene(), thickness))


def test_wavelength_is_that_of_a_supported_plate_s_mode(scene):
    """At the frequency of the mode (1, 1) of a supported square the straight wave is √2 times as long as a side."""
    first = natural_modes(scene((61, 61), edges=("supported",) * 4), 1).frequencies[0]
    found = numbers(scene((61, 61), frequency=first))
    wave = math.sqrt(2) * 0.2
    assert found["wavelength / thickness"].value == pytest.approx(wave / 5e-4, rel=1e-3)
    assert found["points a wavelength"].value == pytest.approx(wave / (0.2 / 60), rel=1e-3)


def test_short_waves_and_coarse_grids_warn(scene):
    assert numbers(scene((9, 9)))["points a wavelength"].exceeded
    assert not numbers(scene((41, 41)))["points a wavelength"].exceeded
    assert not numbers(scene((15, 15), order=2))["wavelength / thickness"].exceeded
    high = scene((101, 101), frequency=60_000.0, window=(0.0, 1e-3))
    assert numbers(high)["wavelength / thickness"].exceeded


def test_added_mass(scene):
    def layer(thickness, both):
        return {
            "area": (0.0, 0.1, 0.0, 0.2), "thickness": thickness, "young_modulus": 1e9, "density": 2000.0, "both": both,
        }  # fmt: skip

    thin = numbers(scene(effects={"layers": [layer(2e-5, False)]}))["added mass / plate's mass"]
    thick = numbers(scene(effects={"layers": [layer(2e-5, True)]}))["added mass / plate's mass"]
    assert (thin.value, thin.exceeded) == (pytest.approx(0.04), False)
    assert (thick.value, thick.exceeded) == (pytest.approx(0.08), True)


@pytest.mark.parametrize(
    "effects",
    [
        {"damping": {"viscous": 100.0}},
        {"foundation": {"stiffness": 1.0, "damping": 100.0}},
        {"material_damping": {"time": 200 / (2 * math.pi * 290) ** 2}},
    ],
)
def test_start_up_motion_that_is_left(scene, effects):
    """All three damp at 100 1/s: the plate weighs 0.5 kg/m² and the drive has 290 Hz."""
    for start in (0.04, 0.05):
        found = numbers(scene(effects=effects, window=(start, 0.1)))["start-up motion left"]
        assert found.value == pytest.approx(math.exp(-100 * start))
        assert found.exceeded == (start == 0.04)
    assert numbers(scene())["start-up motion left"].value == 1


@pytest.mark.parametrize("name", ["simulate", "localize"])
def test_a_plate_that_leaves_the_finite_numbers_is_told_with_the_cause(command, panel, name):
    """Stretching that pulls harder than the step allows: a shorter step, as the sentence says, keeps it finite."""
    options = ("panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate", "--json")
    # So thin and light that magnitudes near one, which the search drives with, throw it far.
    light = panel.plate.model_copy(update={"thickness": 1e-4, "density": 1.0})
    damping = Damping(viscous=0.01)
    made = panel.model_copy(
        update={
            "plate": light,
            "effects": panel.effects.model_copy(update={"damping": damping}),
            "search": Search(particles=2, iterations=2),
        }
    )
    step, told = make_scheme(made).time_step, []
    for part in (1, 8):
        grid = made.grid.model_copy(update={"time_step": step / part})
        Path("panel.toml").write_text(dump_scene(made.model_copy(update={"grid": grid})), encoding="utf-8")
        status, out, _ = command(name, *options)
        assert status == 0
        grown = "has no energies, grew without bound by t = "
        told.append([line for line in json.loads(out)["warnings"] if grown in line])
    assert len(told[0]) == 1
    assert f"the time step of {step:.3g} s allows" in told[0][0]
    assert not told[1]


def test_too_long_a_step_is_told_with_the_cause(command, panel):
    step = 3 * make_scheme(panel).limit
    text = dump_scene(panel.model_copy(update={"grid": panel.grid.model_copy(update={"time_step": step})}))
    Path("panel.toml").write_text(text, encoding="utf-8")
    options = ("--device", "cpu", "--no-pictures", "--no-estimate", "--allow-unstable")
    status, out, _ = command("simulate", "panel.toml", *options)
    assert status == 0
    assert "! A plate has no energies, " in out
    assert f"the time step of {step:.6g} s is above the stability limit" in " ".join(out.split())


def test_too_strong_a_drive_is_told_with_the_cause_and_its_unit(scene):
    """A linear plate at a stable step: nothing but the drive can do that."""
    for made, unit in ((scene(), "N/m²"), (scene(drive={"frequency": 290.0, "electrostatic": {"gain": 1.0}}), "V")):
        assert f"(magnitudes are in {unit}," in warning_texts(made, math.nan)[0]


@pytest.mark.parametrize("name", ["simulate", "localize"])
def test_commands_print_warnings(command, panel, name):
    options = ("panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate")
    status, out, _ = command(name, *options, "--json")
    assert status == 0
    told = json.loads(out)["warnings"]
    assert told
    status, out, _ = command(name, *options)
    assert status == 0
    text = " ".join(out.split())
    assert all(f"! {sentence}" in text for sentence in told)


@pytest.mark.parametrize("name", NEW)
def test_presets_name_their_effects(name):
    """They are steady, on a grid that is fine enough, at the step that the program chooses."""
    scene = Scene.load(name)
    assert {one for one in ("edges", *Effects.model_fields) if is_on(scene, one)} == NEW[name]
    assert scene.grid.time_step is None
    found = numbers(scene)
    for number in ("wavelength / thickness", "points a wavelength", "start-up motion left"):
        assert not found[number].exceeded


def test_the_large_amplitude_preset_stretches():
    """It moves by more than its thickness, and a linear plate would move more than twice as far."""
    scene = Scene.load("large-amplitude")
    linear = scene.model_copy(update={"effects": scene.effects.model_copy(update={"stretching": None})})
    times = scene.window.end - np.arange(16) / 16 / scene.drive.frequency
    peaks = [
        np.abs(PlateSolver(one, "cpu").run(scene_phasors(one)[None], times.tolist()).displacement).max()
        for one in (scene, linear)
    ]
    assert peaks[0] > scene.plate.thickness
    assert peaks[1] > 2 * peaks[0]
