"""Every example scene under docs/ loads, is documented, and reaches about the result that its page gives."""

import re
from pathlib import Path

import pytest

from warp_plate import Scene, design, localize
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.design_variables import make_design_variables, with_common_step
from warp_plate.problem.parametrization import parametrization_of

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = sorted((DOCS / "examples").glob("*.toml"))
names = pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
# Least weighted sum of objectives, or localization factor, of each example; below the figures of the pages where the
# rounding of another processor may lead a swarm elsewhere.
LEAST = {
    "bursts": 5.0, "design-exciter": 0.06, "design-quiet": 4.9, "design-resonators": 0.75,
    "design-ribs": 0.81, "design-thickness": 0.95,
    "design-two-targets": 0.93, "frequency": 0.74, "mask": 0.33,
    "phases-alone": 1.0, "places": 0.75, "robust-touch-panel": 0.5, "strong-and-quiet": 80.0, "three-targets": 0.53,
}  # fmt: skip


@names
def test_examples_can_be_searched_and_are_documented(path):
    scene = with_common_step(Scene.load(path))
    if scene.modal_only_key is None:
        scheme = make_scheme(scene)
        assert 0 < scheme.time_step <= scheme.limit
    assert scene.design or make_design_variables(scene)
    assert f"examples/{path.name}" in "\n".join(page.read_text(encoding="utf-8") for page in DOCS.glob("*.md"))
    command = re.search(r"#\s+warp-plate (?:localize|design) .*docs/examples/(\S+)\n", path.read_text(encoding="utf-8"))
    assert command[1] == path.name


@pytest.mark.slow
@names
def test_examples_reach_the_documented_results(path):
    if Scene.load(path).search.method == "cma":
        pytest.importorskip("cma")
    scene = Scene.load(path)
    if scene.design is not None:
        few = {"starts": 1, "iterations": 30} if scene.design.thickness else {}
        scene = scene.model_copy(update={"design": scene.design.model_copy(update=few)})
        assert design(scene).after.value >= LEAST[path.stem]
        return
    if scene.search.robust is not None:  # the comparison over fresh scenarios has its own tests
        few = scene.search.robust.model_copy(update={"fresh": 2})
        scene = scene.model_copy(update={"search": scene.search.model_copy(update={"robust": few})})
    evaluator = "response" if parametrization_of(with_common_step(scene)).quadratic else "direct"
    result = localize(scene, source=path.name, device="cpu", estimate=False, spectrum=False, evaluator=evaluator)
    assert result.objective_values.get("sum", result.main_case.localization_factor) >= LEAST[path.stem]
