"""Every example scene under docs/ loads, is documented, and reaches about the result that its page gives."""

import re
from pathlib import Path

import pytest

from warp_plate import Scene, localize
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.design_variables import make_design_variables, with_common_step
from warp_plate.problem.parametrization import parametrization_of
from warp_plate.scene.search import Objective, Search

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("*.toml"))
names = pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
# Least weighted sum of objectives, or localization factor, of each example; below the figures of the pages where the
# rounding of another processor may lead a swarm elsewhere.
LEAST = {
    "bursts": 5.0, "frequency": 0.74, "mask": 0.33, "phases-alone": 1.0, "places": 0.75, "robust-touch-panel": 0.5,
    "strong-and-quiet": 80.0, "three-targets": 0.53,
}  # fmt: skip


@names
def test_examples_can_be_searched_and_are_documented(path):
    scene = with_common_step(Scene.load(path))
    scheme = make_scheme(scene)
    assert 0 < scheme.time_step <= scheme.limit
    assert make_design_variables(scene)
    assert f"examples/{path.name}" in "\n".join(page.read_text(encoding="utf-8") for page in DOCS.glob("*.md"))
    command = re.search(r"#\s+warp-plate localize .*docs/examples/(\S+)\n", path.read_text(encoding="utf-8"))
    assert command[1] == path.name


def test_examples_cover_all_variables_objectives_limits_shapes_and_methods():
    scenes = [Scene.load(path) for path in EXAMPLES] + [Scene.load("paper")]
    searches = [scene.search for scene in scenes]
    for table in ("magnitude", "phase", "frequency", "position", "delay", "robust", "restarts"):
        assert any(getattr(search, table) for search in searches), table
    for key in ("magnitude", "power", "equal_magnitudes"):
        assert any(getattr(search.limits, key) for search in searches), key
    kinds = {objective.kind for search in searches for objective in search.objectives}
    assert kinds == set(Objective.model_fields["kind"].annotation.__args__)
    assert {search.method for search in searches} == set(Search.model_fields["method"].annotation.__args__)
    targets = [target for scene in scenes for target in (scene.targets or (scene.target,))]
    for shape in ("area", "disc", "polygon", "mask"):
        assert any(getattr(target, shape) for target in targets), shape


@pytest.mark.slow
@names
def test_examples_reach_the_documented_results(path):
    if Scene.load(path).search.method == "cma":
        pytest.importorskip("cma")
    scene = Scene.load(path)
    if scene.search.robust is not None:  # the comparison over fresh scenarios has its own tests
        few = scene.search.robust.model_copy(update={"fresh": 2})
        scene = scene.model_copy(update={"search": scene.search.model_copy(update={"robust": few})})
    evaluator = "response" if parametrization_of(with_common_step(scene)).quadratic else "direct"
    result = localize(scene, path.name, device="cpu", estimate=False, spectrum=False, evaluator=evaluator)
    assert result.objective_values.get("sum", result.main_case.localization_factor) >= LEAST[path.stem]
