"""Every table and key of a scene file has a meaning in the reference, and every number a unit."""

import inspect
import re
from typing import get_args

import pytest
from pydantic import BaseModel

from warp_plate import Scene
from warp_plate.cli.localize import localize
from warp_plate.scene.keys import UNITS
from warp_plate.scene.search import Limits, Objective

UNITLESS = {
    *("poisson_ratio", "nodes", "order", "accuracy", "gain", "weight", "quantile", "without_oscillators"),
    *("particles", "iterations", "restarts", "inertia", "decay", "cognitive", "social", "velocity_limit", "stall"),
    *("modal_density", "seed", "scenarios", "fresh", "eta", "ratio", "starts", "free"),
    *("condition", "cycles", "force_channel", "bootstrap", "profile"),
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
    # The reference of the site takes meanings from docstrings and from the comments beside or above fields.
    source = "".join(inspect.getsource(each) for each in model.__mro__ if each.__module__.startswith("warp_plate"))
    keys = [key for key, field in model.model_fields.items() if not tables_in(field.annotation)]
    assert model.__doc__
    assert not [key for key in keys if not re.search(rf"^    (# .*\n    )?{key}: .*(?(1)|  # \w)", source, re.M)]
    for key in keys:
        if {int, float} & set(types_in(model.model_fields[key].annotation)):
            ends = [".".join([*name.split(".")[index:], key]) for index in range(name.count(".") + 2)]
            assert set(ends) & set(UNITS) or key in UNITLESS, (name, key)


def test_help_of_localize_lists_limits_and_objectives():
    keys = (*Limits.model_fields, *Objective.model_fields, *get_args(Objective.model_fields["kind"].annotation))
    assert not [key for key in keys if key not in localize.__doc__]
