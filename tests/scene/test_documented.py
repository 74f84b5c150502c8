"""Every table and key of a scene file has a meaning in the reference, and every number a unit."""

from typing import get_args

import pytest
from pydantic import BaseModel

from warp_plate import Scene
from warp_plate.cli.localize import localize
from warp_plate.scene.fields import explain_key
from warp_plate.scene.search import Limits, Objective


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
    keys = [key for key, field in model.model_fields.items() if not tables_in(field.annotation)]
    assert model.__doc__
    for key in keys:
        meaning, unit, _ = explain_key(model, key)
        assert meaning, (name, key)
        if float in types_in(model.model_fields[key].annotation):
            assert unit, (name, key)


def test_help_of_localize_lists_limits_and_objectives():
    keys = (*Limits.model_fields, *Objective.model_fields, *get_args(Objective.model_fields["kind"].annotation))
    assert not [key for key in keys if key not in localize.__doc__]
