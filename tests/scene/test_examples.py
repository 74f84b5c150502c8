"""Every example scene under docs/ loads, is told of there, and finds about what its page says."""

import re
from pathlib import Path

import pytest

from warp_plate import Scene, localize
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.design_variables import make_design_variables, with_common_step
from warp_plate.problem.parametrization import parametrization_of

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("*.toml"))
names = pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
# What a search must find at least: of objectives their weighted sum, else the localization factor. Below the pages'
# figures where another processor's rounding may lead a swarm elsewhere.
FOUND = {
    "bursts": 5.0,
    "frequency": 0.74,
    "mask": 0.33,
    "phases-alone": 1.0,
    "places": 0.75,
    "robust-touch-panel": 0.5,
    "strong-and-quiet": 80.0,
    "three-targets": 0.53,
}


@names
def test_example_is_a_scene_that_can_be_searched(path):
    scene = with_common_step(Scene.load(path))
    scheme = make_scheme(scene)
    assert 0 < scheme.time_step <= scheme.limit
    assert make_design_variables(scene)


@names
def test_example_and_its_command_stand_in_a_page(path):
    pages = "\n".join(page.read_text(encoding="utf-8") for page in DOCS.glob("*.md"))
    assert f"examples/{path.name}" in pages
    command = re.search(r"#\s+warp-plate localize .*docs/examples/(\S+)\n", path.read_text(encoding="utf-8"))
    assert command is not None
    assert command[1] == path.name


def test_together_they_show_all_variables_objectives_limits_shapes_and_methods():
    scenes = [Scene.load(path) for path in EXAMPLES] + [Scene.load("paper")]
    searches = [scene.search for scene in scenes]
    for table in ("magnitude", "phase", "frequency", "position", "delay", "robust", "restarts"):
        assert any(getattr(search, table) for search in searches), table
    for key in ("magnitude", "power", "equal_magnitudes"):
        assert any(getattr(search.limits, key) for search in searches), key
    for kinds, shown in (
        ({one.kind for search in searches for one in search.objectives}, ("objectives", "kind")),
        ({search.method for search in searches}, ("method",)),
    ):
        model = type(searches[0]) if shown == ("method",) else type(searches[0].objectives[0])
        assert kinds == set(model.model_fields[shown[-1]].annotation.__args__)
    targets = [target for scene in scenes for target in (scene.targets or (scene.target,))]
    for shape in ("area", "disc", "polygon", "mask"):
        assert any(getattr(target, shape) for target in targets), shape


@pytest.mark.slow
@names
def test_example_finds_what_its_page_says(path):
    if Scene.load(path).search.method == "cma":
        pytest.importorskip("cma")
    scene = Scene.load(path)
    if scene.search.robust is not None:  # its comparison over fresh panels has tests of its own
        few = scene.search.robust.model_copy(update={"fresh": 2})
        scene = scene.model_copy(update={"search": scene.search.model_copy(update={"robust": few})})
    evaluator = "response" if parametrization_of(with_common_step(scene)).quadratic else "direct"
    result = localize(scene, path.name, device="cpu", estimate=False, spectrum=False, evaluator=evaluator)
    assert result.objective_values.get("sum", result.main_case.localization_factor) >= FOUND[path.stem]
