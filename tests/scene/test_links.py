"""Keys that hold one number: set, varied, read and refused as one."""

import pytest

from warp_plate import Scene, SceneError
from warp_plate.analysis.influence import _alternative
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.resolve import resolve
from warp_plate.scene.keys import label_of, unit_of, value_of


def test_a_link_sets_all_of_its_keys():
    scene = Scene.load("console", ["gasket=3e6"])
    assert {edge.translation for _, edge in scene.edges} == {3e6}
    softer = scene.replace("gasket", 1e6)
    assert {edge.translation for _, edge in softer.edges} == {1e6}
    assert {edge.rotation for _, edge in softer.edges} == {5.0}
    assert value_of(softer, "gasket") == 1e6
    assert (label_of(softer, "gasket"), unit_of(softer, "gasket")) == ("gasket", "N/m²")
    assert Scene.parse(softer.to_toml(), "softer") == softer


def test_a_linked_key_is_a_free_number_of_a_fit():
    assert Scene.load("console", ["fit.free={gasket=[1e6,1e7]}"]).fit is not None
    with pytest.raises(SceneError, match=r"fit.free: edges.left.translation: is there twice"):
        Scene.load("console", ["fit.free={gasket=[1e6,1e7],edges={left={translation=[1e6,1e7]}}}"])


@pytest.mark.parametrize("table", ["search.robust", "specification"])
def test_a_link_and_one_of_its_keys_have_no_tolerances_both(table):
    with pytest.raises(SceneError, match=rf"{table}.tolerance: gasket: is there twice"):
        Scene.load("console", [f"{table}.tolerance={{'edges.left.translation'=0.1,gasket=0.3}}"])


def test_links_of_themselves_are_refused_when_they_are_set():
    with pytest.raises(SceneError, match=r"links.gasket.keys: gasket: is not a key"):
        Scene.load("console", ["links.gasket.keys=['gasket']", "gasket=3"])


def test_scenarios_and_switched_effects_need_not_keep_links():
    """Thickness, oscillators and edges change, which links or tolerances name."""
    mass = "mass=1e-3,stiffness=1e3"
    attached = f"effects.oscillators=[{{area=[0.1,0.11,0.05,0.06],{mass}}},{{area=[0.2,0.21,0.05,0.06],{mass}}}]"
    masses = "links.mass={keys=['effects.oscillators[0].mass','effects.oscillators[1].mass']}"
    moduli = "links.modulus={keys=['plate.young_modulus','effects.layers[0].young_modulus']}"
    layer = "effects.layers=[{area=[0.1,0.15,0.02,0.06],thickness=1e-4,young_modulus=70e9,density=2500}]"
    named = "specification.tolerance={mass=0.1}"
    robust = "search.robust={young_modulus=0.1,without_oscillators=1.0,tolerance={gasket=0.1}}"
    keys = ["plate.young_modulus=70e9", layer, attached, masses, moduli, named, robust, "grid={nodes=[13,13]}"]
    scene = Scene.load("console", keys)
    (scenario,) = draw_scenarios(scene, 1, seed=0, stepped=False)
    assert scenario.scene.plate.young_modulus != 70e9
    other, text = _alternative(resolve(scene, "cpu", path="modal"), "edges")
    assert other is not None, text


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("links.f={keys=['actuators.A1.force']}", "links.f.keys: actuators[0].force: is no property of the panel"),
        ("links.f={keys=['actuators[0].area[0]']}", "links.f.keys: actuators[0].area[0]: is no property of the panel"),
        ("links.f={keys=['drive.frequency']}", "links.f.keys: drive.frequency: is no property of the panel"),
        ("links={'ä'={keys=['plate.thickness']}}", "links.ä: write a name of letters, digits and _"),
        ("specification.tolerance={drive={frequency=0.1}}", "specification.tolerance: drive.frequency: is no real num"),
        ("search.robust.tolerance={search={weight=0.1}}", "search.robust.tolerance: search.weight: is no"),
        ("edges.left.translation=3", "links.gasket.keys: hold different numbers, edges.left.translation = 3.0, "),
        ("links.plate={keys=['plate.thickness']}", "links.plate: write a name"),
        ("links.glass={keys=['plate.thicknes']}", "links.glass.keys: plate.thicknes: is not a key of this scene"),
        ("links.a={keys=['gasket']}", "links.a.keys: gasket: is not a key of this scene that holds a number"),
        ("links.glass={keys=[]}", "links.glass.keys = []: must be a list of 1 or more texts"),
    ],
)
def test_bad_links_are_refused(assignment, words):
    with pytest.raises(SceneError) as refused:
        Scene.load("console", [assignment])
    assert words in str(refused.value)
