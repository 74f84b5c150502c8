"""Every table and key of a scene file appears in the documentation, and every number has a unit."""

from pathlib import Path

import pytest
from pydantic import BaseModel

from warp_plate import Scene
from warp_plate.cli.localize import localize
from warp_plate.scene.keys import UNITS
from warp_plate.scene.search import OBJECTIVE_UNITS, Limits, Objective

DOCS = Path(__file__).parents[2] / "docs"
TEXT = "\n".join(page.read_text(encoding="utf-8") for page in sorted(DOCS.glob("*.md")))
UNITLESS = {
    *("poisson_ratio", "nodes", "order", "accuracy", "gain", "weight", "quantile", "without_oscillators"),
    *("particles", "iterations", "restarts", "inertia", "decay", "cognitive", "social", "velocity_limit", "stall"),
    *("modal_density", "seed", "scenarios", "fresh", "eta", "ratio", "starts", "free"),
    *("condition", "cycles", "force_channel"),
}


def types_in(kind):
    """Return the types in an annotation, in unions and tuples as well."""
    return [kind, *(inner for part in getattr(kind, "__args__", ()) for inner in types_in(part))]


def tables_in(kind):
    return [table for table in types_in(kind) if isinstance(table, type) and issubclass(table, BaseModel)]


def tables_of(model, prefix=""):
    """Yield (dotted name, model) of all tables inside a model."""
    for key, field in model.model_fields.items():
        for table in tables_in(field.annotation):
            yield f"{prefix}{key}", table
            yield from tables_of(table, f"{prefix}{key}.")


@pytest.mark.parametrize(("name", "model"), list(tables_of(Scene)))
def test_every_table_and_key_is_documented_and_every_number_has_a_unit(name, model):
    last = name.split(".")[-1]
    keys = [key for key, field in model.model_fields.items() if not tables_in(field.annotation)]
    assert f"`{last}`" in TEXT or f"{name}]" in TEXT or f".{last}`" in TEXT
    assert not [key for key in keys if f"`{key}`" not in TEXT and f"{key} = " not in TEXT]
    for key in keys:
        if {int, float} & set(types_in(model.model_fields[key].annotation)):
            ends = [".".join([*name.split(".")[index:], key]) for index in range(name.count(".") + 2)]
            assert set(ends) & set(UNITS) or key in UNITLESS, (name, key)


def test_help_of_localize_lists_limits_and_objectives():
    keys = (*Limits.model_fields, *Objective.model_fields, *OBJECTIVE_UNITS)
    assert not [key for key in keys if key not in localize.__doc__]
