"""Keys that hold one number: set, varied, read and refused as one."""

import pytest

from warp_plate import Scene, SceneError
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


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
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
