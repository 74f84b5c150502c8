"""Every table and key of a scene file stands in the pages about it."""

from pathlib import Path

import pytest
from pydantic import BaseModel

from warp_plate import PlateSolver, Scene
from warp_plate.cli.localize import localize
from warp_plate.cluster.blocks import BLOCK_NODE_STEPS, plates_of_block
from warp_plate.cluster.processes import DEPTH
from warp_plate.scene.search import OBJECTIVE_UNITS, Limits, Objective, Search

DOCS = Path(__file__).parents[2] / "docs"
TEXT = "\n".join(page.read_text(encoding="utf-8") for page in sorted(DOCS.glob("*.md")))


def tables_in(kind):
    """The tables that a key may hold, in unions and tuples as well."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [table for part in getattr(kind, "__args__", ()) for table in tables_in(part)]


def tables_of(model, at=""):
    """(dotted name, model) of all tables inside a model."""
    for key, field in model.model_fields.items():
        for table in tables_in(field.annotation):
            yield f"{at}{key}", table
            yield from tables_of(table, f"{at}{key}.")


def rows():
    """The first cells of the rows of docs/scene.md, each with the table of the scene file that it stands under."""
    found, under = [], ""
    for line in (DOCS / "scene.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("|"):
            cell = line.split("|")[1]
            under = cell if "[" in cell else under
            found.append((under, cell))
    return found


@pytest.mark.parametrize(("name", "model"), list(tables_of(Scene)))
def test_every_key_has_its_words(name, model):
    keys = [key for key, field in model.model_fields.items() if not tables_in(field.annotation)]
    assert f"`{name.split('.')[-1]}`" in TEXT or f"{name}]" in TEXT or f".{name.split('.')[-1]}`" in TEXT
    assert not [key for key in keys if f"`{key}`" not in TEXT and f"{key} = " not in TEXT]


def test_targets_and_searches_have_rows_of_their_own():
    for under, keys in (
        ("`[search]`", [key for key, field in Search.model_fields.items() if not tables_in(field.annotation)]),
        ("`[target]`", ("area", "disc", "polygon", "mask")),
        ("`[[targets]]`", ("name", "area", "disc", "polygon", "mask")),
        ("`[[search.objectives]]`", ("kind", "weight", "rest_limit")),
    ):
        cells = [cell for head, cell in rows() if under in head]
        assert not [key for key in keys if not any(f"`{key}`" in cell for cell in cells)]


def test_the_help_of_localize_names_limits_and_objectives():
    words = localize.__doc__
    assert not [key for key in (*Limits.model_fields, *Objective.model_fields, *OBJECTIVE_UNITS) if key not in words]


def test_the_page_on_scaling_has_the_blocks_of_the_code():
    words = " ".join((DOCS / "scaling.md").read_text(encoding="utf-8").split())
    solver = PlateSolver(Scene.load("paper"), "cpu")
    (cpu, _), (cuda, least) = (plates_of_block(solver.node_steps_per_plate, kind) for kind in ("cpu", "cuda"))
    assert f"about {BLOCK_NODE_STEPS['cpu']:.0e}".replace("e+0", "e") + f" node-steps on a CPU ({cpu} plates" in words
    assert f"{BLOCK_NODE_STEPS['cuda']:.1e}".replace("e+0", "e") + f" on a GPU ({cuda} plates" in words
    assert f"{2 * cpu} plates of the paper's scene for each" in words
    assert f"begins and ends with blocks of {least} plates, and {2 * least} lie between" in words
    assert DEPTH["cuda"] == 2.5
    assert "one and a half of full size in waiting" in words
