"""The keys of scene files, as ``warp-plate keys`` and the reference show them."""

import json
from typing import get_args

import pytest

from support.commands import error_of, output_of
from warp_plate.cli.localize import localize
from warp_plate.scene.key_reference import table_references
from warp_plate.scene.search import Limits, Objective


def test_help_of_localize_lists_limits_and_objectives():
    keys = (*Limits.model_fields, *Objective.model_fields, *get_args(Objective.model_fields["kind"].annotation))
    assert not [key for key in keys if key not in localize.__doc__]


def test_types_in_words():
    types = {(table.headings[0], key.name): key.type for table in table_references() for key in table.keys}
    assert types["[[supports]]", "line"] == "2 lists of 2 numbers"
    assert types["[links.NAME]", "keys"] == "list of texts"


def test_command(command):
    answer = json.loads(output_of(command("keys", "plate", "effects.damping", "--json")))
    (density,) = (key for key in answer["plate"] if key["name"] == "density")
    assert (density["unit"], density["default"], density["range"]) == ("kg/m³", "required", "≥ 1, ≤ 100000")
    assert {key["name"] for key in answer["effects.damping"]} == {"viscous", "scheme"}
    text = output_of(command("keys"))
    assert "search.magnitude" in text
    assert "drive.burst" in text
    assert json.loads(output_of(command("keys", "measured", "--json")))["measured"][0]["name"] == "file"
    assert "Poisson's ratio" in output_of(command("keys", "plate"))
    assert "plates: no such table; there are: plate, plate.outline, plate.holes" in error_of(command("keys", "plates"))
    assert "drive.ramp: no such table; the keys of drive are" in error_of(command("keys", "drive.ramp"))


@pytest.mark.parametrize(
    ("assignment", "line"),
    [
        ("search.delay={}", "search.delay.range: is missing; it has no default, write for example ["),
        ("plate={size=[0.2,0.2],thicknes=1e-3,young_modulus=1e9,poisson_ratio=0.3,density=1e3}",
         "plate.thicknes: unknown key; did you mean 'thickness'?\n"),
    ],
)  # fmt: skip
def test_errors_help_with_missing_keys(assignment, line, command):
    """An example is shown; a key that is missing because it is misspelt is not counted as a further error."""
    assert line in error_of(command("check", "paper", "--set", assignment))
