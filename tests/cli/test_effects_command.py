"""``warp-plate effects``, the warnings of ``simulate`` and ``localize``, and the presets with effects."""

import json
import math

import pytest

from support.commands import error_of, output_of
from support.grid_modes import natural_modes
from support.scenes import scene_of
from warp_plate import PlateSolver
from warp_plate.analysis.influence import bare_scene, is_on, measure_effects, names, toggle
from warp_plate.analysis.warnings import find_warnings, warning_texts
from warp_plate.cli import output
from warp_plate.cli.check import print_influence
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.scheme import discretize, make_scheme
from warp_plate.solve.specialize import effect_names


def findings(scene, peak=0.0):
    return {finding.name: finding for finding in find_warnings(scene, peak)}


def test_costs_and_table(write_scene, capsys):
    """A few effects, in a scene with a time step that is just stable without material damping."""
    panel = write_scene(damping=88.5, time_step=make_scheme(scene_of(damping=88.5)).limit)
    names = ("damping", "material_damping", "loss_factor")
    influence = measure_effects(panel, "cpu", effects=names, rounds=2, node_steps=1e4)
    without, softer, lossy = influence.toggles
    run = PlateSolver(panel.with_tables(effects={}), "cpu").run(scene_phasors(panel)[None])
    assert (without.name, without.on) == ("damping", True)
    assert without.localization_factor == pytest.approx(run.energy[0, 1] / run.energy[0, 0], rel=1e-9)
    assert (softer.name, softer.on, softer.steps > 1) == ("material_damping", False, True)
    assert "step of" in softer.alternative
    assert (lossy.price, lossy.alternative[:7]) == (None, "refused")
    assert math.isfinite(without.price)
    assert math.isfinite(softer.price)
    assert influence.bare_step > 0
    assert influence.warnings == tuple(warning_texts(panel, influence.peak)) != ()
    print_influence(influence, output.console())
    text = " ".join(capsys.readouterr().out.split())
    for part in ("price of a step", "damping on", "without damping: left out", f"× {softer.steps:.3g}"):
        assert part in text


def test_a_plate_at_rest_has_no_factor(command, write_scene):
    write_scene(effects={"loss_factor": {"eta": 0.02}})
    zero = [word for index in range(3) for word in ("--set", f"actuators[{index}].magnitude=0")]
    rows = output_of(command("effects", "panel.toml", "foundation", "--device", "cpu", *zero)).splitlines()
    assert [row.split()[-2:] for row in rows if row.startswith(("the scene", "foundation"))] == [["none", "0"]] * 2
    assert "fondation: no such effect" in error_of(command("effects", "panel.toml", "fondation"))


@pytest.mark.parametrize("grid", [pytest.param("grid.accuracy=0.05", marks=pytest.mark.slow), "grid.nodes=[13, 13]"])
def test_a_scene_with_a_loss_factor_is_solved_by_modes(grid, command, write_scene):
    """It was refused, with the advice to use an evaluator that the command does not have."""
    write_scene(effects={"loss_factor": {"eta": 0.02}}, edges=("clamped", "free", "clamped", "free"))
    options = ("effects", "panel.toml", "edges", "foundation", "stretching", "--device", "cpu", "--set", grid)
    record = json.loads(output_of(command(*options, "--json")))
    edges, foundation, stretching = record["effects"]
    clamped = scene_of(effects={"loss_factor": {"eta": 0.02}})
    energy = ModalSolver(clamped, "cpu").run(scene_phasors(clamped)[None]).energy[0]
    assert edges["localization_factor"] == pytest.approx(energy[1] / energy[0], rel=0.01)
    assert foundation["localization_factor"] != record["localization_factor"]
    assert (edges["price"], edges["steps"], record["bare_step_seconds"]) == (None, None, None)
    assert (stretching["localization_factor"], stretching["alternative"][:7]) == (None, "refused")
    assert record["warnings"] == [number["sentence"] for number in record["numbers"] if number["exceeded"]]
    if "nodes" in grid:
        text = " ".join(output_of(command(*options)).split())
        assert "solved by modes" in text
        judged = [number for number in record["numbers"] if not number["exceeded"] and number["value"] is not None]
        parts = [f"! {warning}" for warning in record["warnings"]] + [f"{number['name']} " for number in judged]
        assert all(part in text for part in parts)


def test_every_effect_is_switched_both_ways():
    scene = scene_of(edges=("free", "supported", {"rotation": 1.0}, "clamped"), damping=3.0)
    scene = scene.with_tables(drive={"frequency": 290.0, "burst": {"duration": 0.01}, "electrostatic": {"gain": 1.0}})
    bare = bare_scene(scene)
    assert effect_names(discretize(bare)) == ()
    assert (bare.edges.left, bare.edges.bottom, bare.edges.right) == ("clamped", "supported", "clamped")
    assert {name for name in names() if is_on(scene, name)} == {"edges", "damping"}
    for name in names():
        on = toggle(bare, name)[0].with_tables()
        assert (is_on(bare, name), is_on(on, name), is_on(toggle(on, name)[0], name)) == (False, True, False)


def test_numbers_of_the_plate_and_its_waves():
    """At the frequency of the mode (1, 1) of a supported square a straight wave is √2 times as long as a side."""
    scene, name = scene_of(), "displacement / thickness"
    thickness = scene.plate.thickness
    assert [findings(scene, peak * thickness)[name].exceeded for peak in (0.19, 0.21, math.nan)] == [False, True, True]
    stretched = findings(scene_of(effects={"stretching": {}}), 3 * thickness)[name]
    assert (stretched.value, stretched.exceeded) == (pytest.approx(3), False)
    assert any("[effects.stretching]" in sentence for sentence in warning_texts(scene, thickness))
    first = natural_modes(scene_of((61, 61), edges=("supported",) * 4), 1).frequencies[0]
    found, wave = findings(scene_of((61, 61), frequency=first)), math.sqrt(2) * 0.2
    assert found["wavelength / thickness"].value == pytest.approx(wave / 5e-4, rel=1e-3)
    assert found["points a wavelength"].value == pytest.approx(wave / (0.2 / 60), rel=1e-3)
    assert [findings(scene_of((n, n)))["points a wavelength"].exceeded for n in (9, 41)] == [True, False]
    high = scene_of((101, 101), frequency=60_000.0, window=(0.0, 1e-3))
    assert [findings(s)["wavelength / thickness"].exceeded for s in (scene_of((15, 15)), high)] == [False, True]


def test_added_mass():
    """The plate has 0.5 kg/m²."""
    layer = {"area": (0.0, 0.1, 0.0, 0.2), "thickness": 2e-5, "young_modulus": 1e9, "density": 2000.0}
    for both, value in ((False, 0.04), (True, 0.08)):
        found = findings(scene_of(effects={"layers": [{**layer, "both": both}]}))["added mass / plate's mass"]
        assert (found.value, found.exceeded) == (pytest.approx(value), both)


def test_a_plate_that_becomes_non_finite_is_reported_with_the_cause(command, write_scene):
    """Stretching that is too stiff for the step; a shorter step, as the warning advises, keeps the plate finite."""
    effects = {"stretching": {}, "damping": {"viscous": 0.01}}
    scene = scene_of(effects=effects, search={"particles": 2, "iterations": 2})
    # So thin and light that magnitudes of 1, as in a search, throw it far.
    scene = scene.with_tables(plate={**scene.plate.model_dump(), "thickness": 1e-4, "density": 1.0})
    step, grid = make_scheme(scene).time_step, scene.grid.model_dump()
    for part, name in ((1, "simulate"), (1, "localize"), (8, "simulate"), (8, "localize")):
        write_scene(scene.with_tables(grid={**grid, "time_step": step / part}))
        words = (name, "panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate")
        warnings = json.loads(command(*words, "--json")[1])["warnings"]
        text = " ".join(command(*words)[1].split())
        assert all(f"! {sentence}" in text for sentence in warnings)
        causes = [line for line in warnings if "grew without bound by t = " in line]
        assert len(causes) == (part == 1)
        assert all(f"{step:.3g} s" in cause for cause in causes)
