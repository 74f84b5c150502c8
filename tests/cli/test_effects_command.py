"""``warp-plate effects``, the warnings of ``simulate`` and ``localize``, and the presets with effects."""

import json
import math

import pytest
from conftest import output_of, scene_of

from warp_plate import PlateSolver, Scene
from warp_plate.analysis import influence
from warp_plate.analysis.check import find_warnings, warning_texts
from warp_plate.analysis.influence import DRIVES, bare_scene, is_on, measure_influence
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.effects import Effects
from warp_plate.solve.specialize import effect_names

EFFECTS_OF_PRESETS = {
    "touch-panel": {"edges", "damping", "material_damping", "oscillators"},
    "cantilever-display": {"edges", "damping", "layers"},
    "composite-panel": {"damping", "material_damping", "orthotropic"},
    "large-amplitude": {"damping", "stretching"},
}
QUICK = ("--device", "cpu", "--no-pictures", "--no-estimate")


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Shorten timed runs, whose times are not checked."""
    monkeypatch.setattr(influence, "TIMED_NODE_STEPS", {"cpu": 1e4, "cuda": 1e6})
    monkeypatch.setattr(influence, "ROUNDS", 2)


@pytest.fixture
def panel(write_scene):
    """A small scene in a file of the working folder."""
    return write_scene(effects={"stretching": {}, "damping": {"viscous": 88.5}}, search={"iterations": 3})


def by_name(found):
    return {toggle.name: toggle for toggle in found.toggles}


def findings(scene, peak=0.0):
    return {finding.name: finding for finding in find_warnings(scene, peak)}


def test_json_and_table(command, panel):
    record = json.loads(output_of(command("effects", "panel.toml", "--device", "cpu", "--json")))
    effects = {row["name"]: row for row in record["effects"]}
    assert list(effects) == ["edges", *Effects.model_fields, "own_frequencies", *DRIVES]
    assert {name for name, row in effects.items() if row["on"]} == {"damping", "stretching"}
    assert effects.pop("signal")["alternative"] == "no typical value is known"
    assert all(math.isfinite(row["price"]) for row in effects.values())
    assert record["bare_step_seconds"] > 0
    assert len(record["numbers"]) == 5
    assert record["warnings"] == [number["sentence"] for number in record["numbers"] if number["exceeded"]]
    text = " ".join(command("effects", "panel.toml", "--device", "cpu")[1].split())
    sentences = [finding.sentence for finding in find_warnings(panel, 0.0)[1:]]
    for part in ("without stretching: left out", "with oscillators: a fingertip", *sentences):
        assert part in text


def test_influence_is_that_of_a_run_without_the_effect(panel):
    undamped = panel.with_tables(effects={"stretching": {}})
    run = PlateSolver(undamped, "cpu").run(scene_phasors(panel)[None])
    toggle = by_name(measure_influence(panel, "cpu"))["damping"]
    assert toggle.localization_factor == pytest.approx(run.energy[0, 1] / run.energy[0, 0], rel=1e-9)


def test_a_step_too_long_for_the_other_state_is_replaced():
    """Material damping lowers the limit below a step that is just stable without it."""
    limit = make_scheme(scene_of()).limit
    toggle = by_name(measure_influence(scene_of(time_step=limit), "cpu"))["material_damping"]
    assert "step of" in toggle.alternative
    assert toggle.steps > 1


def test_the_bare_plate_has_no_effects():
    scene = scene_of(edges=("free", "supported", {"rotation": 1.0}, "clamped"), damping=3.0)
    scene = scene.with_tables(drive={"frequency": 290.0, "burst": {"duration": 0.01}, "electrostatic": {"gain": 1.0}})
    bare = bare_scene(scene)
    assert effect_names(bare) == ()
    assert (bare.edges.left, bare.edges.bottom, bare.edges.right) == ("clamped", "supported", "clamped")
    for name in ("edges", "burst", "electrostatic"):
        assert (is_on(scene, name), is_on(bare, name)) == (True, False)


def test_displacement_against_thickness():
    scene, name = scene_of(), "displacement / thickness"
    thickness = scene.plate.thickness
    assert [findings(scene, peak * thickness)[name].exceeded for peak in (0.19, 0.21, math.nan)] == [False, True, True]
    stretched = findings(scene_of(effects={"stretching": {}}), 3 * thickness)[name]
    assert (stretched.value, stretched.exceeded) == (pytest.approx(3), False)
    assert any("[effects.stretching]" in sentence for sentence in warning_texts(scene, thickness))


def test_wavelengths_against_thickness_and_grid():
    """At the frequency of the mode (1, 1) of a supported square a straight wave is √2 times as long as a side."""
    first = natural_modes(scene_of((61, 61), edges=("supported",) * 4), 1).frequencies[0]
    found, wave = findings(scene_of((61, 61), frequency=first)), math.sqrt(2) * 0.2
    assert found["wavelength / thickness"].value == pytest.approx(wave / 5e-4, rel=1e-3)
    assert found["points a wavelength"].value == pytest.approx(wave / (0.2 / 60), rel=1e-3)
    assert [findings(scene_of((n, n)))["points a wavelength"].exceeded for n in (9, 41)] == [True, False]
    high = scene_of((101, 101), frequency=60_000.0, window=(0.0, 1e-3))
    assert [findings(s)["wavelength / thickness"].exceeded for s in (scene_of((15, 15)), high)] == [False, True]


@pytest.mark.parametrize(("both", "value"), [(False, 0.04), (True, 0.08)])
def test_added_mass(both, value):
    layer = {"area": (0.0, 0.1, 0.0, 0.2), "thickness": 2e-5, "young_modulus": 1e9, "density": 2000.0, "both": both}
    found = findings(scene_of(effects={"layers": [layer]}))["added mass / plate's mass"]
    assert (found.value, found.exceeded) == (pytest.approx(value), both)


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"damping": {"viscous": 100.0}},
        {"foundation": {"stiffness": 1.0, "damping": 100.0}},
        {"material_damping": {"time": 200 / (2 * math.pi * 290) ** 2}},
    ],
)
def test_start_up_motion_that_is_left(effects):
    """All three effects damp at 100 1/s: the plate has 0.5 kg/m² and the drive 290 Hz."""
    for start in (0.04, 0.05):
        found = findings(scene_of(effects=effects, window=(start, 0.1)))["start-up motion left"]
        assert found.value == pytest.approx(math.exp(-100 * start) if effects else 1)
        assert found.exceeded == (start == 0.04 or not effects)


@pytest.mark.parametrize("name", ["simulate", "localize"])
def test_a_plate_that_becomes_non_finite_is_reported_with_the_cause(command, panel, write_scene, name):
    """Stretching that is too stiff for the step; a shorter step, as the warning advises, keeps the plate finite."""
    # So thin and light that magnitudes of 1, as in a search, throw it far.
    light = {**panel.plate.model_dump(), "thickness": 1e-4, "density": 1.0}
    effects = {"stretching": {}, "damping": {"viscous": 0.01}}
    scene = panel.with_tables(plate=light, effects=effects, search={"particles": 2, "iterations": 2})
    step, causes = make_scheme(scene).time_step, []
    for part in (1, 8):
        write_scene(scene.with_tables(grid={**scene.grid.model_dump(), "time_step": step / part}))
        warnings = json.loads(command(name, "panel.toml", *QUICK, "--json")[1])["warnings"]
        text = " ".join(command(name, "panel.toml", *QUICK)[1].split())
        assert all(f"! {sentence}" in text for sentence in warnings)
        causes.append([line for line in warnings if "grew without bound by t = " in line])
    ((cause,), none) = causes
    assert f"{step:.3g} s" in cause
    assert not none


@pytest.mark.parametrize("name", EFFECTS_OF_PRESETS)
def test_presets_with_effects_are_steady_and_well_resolved(name):
    scene = Scene.load(name)
    assert {effect for effect in ("edges", *Effects.model_fields) if is_on(scene, effect)} == EFFECTS_OF_PRESETS[name]
    assert scene.grid.time_step is None
    found = findings(scene)
    for number in ("wavelength / thickness", "points a wavelength", "start-up motion left"):
        assert not found[number].exceeded
