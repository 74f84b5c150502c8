"""The JSON schema of the scene, which editors complete and check from, explains every key."""

import pytest
from pydantic import TypeAdapter

from warp_plate import Scene
from warp_plate.scene.fields import Table

SCHEMA = Scene.model_json_schema()
TABLES = {"Scene": SCHEMA, **SCHEMA["$defs"]}
PROPERTIES = [(table, key, entry) for table, each in TABLES.items() for key, entry in each["properties"].items()]


def parts(entry):
    """Yield a schema and those within it; tables by their own."""
    yield entry
    inner = [*entry.get("anyOf", ()), *entry.get("oneOf", ()), *entry.get("prefixItems", ())]
    inner += [entry[name] for name in ("items", "additionalProperties") if isinstance(entry.get(name), dict)]
    if "$ref" in entry:
        inner.append(TABLES[entry["$ref"].rpartition("/")[2]])
    for each in inner:
        yield from parts(each)


def test_every_key_has_a_description():
    missing = [f"{table}.{key}" for table, key, entry in PROPERTIES if not any(map(described, parts(entry)))]
    assert not missing


def described(entry):
    return entry.get("description")


def test_every_real_number_has_a_unit_in_brackets():
    numbers = [
        (f"{table}.{key}", entry.get("description", ""))
        for table, key, entry in PROPERTIES
        if any(each.get("type") == "number" for each in parts(without_tables(entry)))
    ]
    assert len(numbers) > 80
    assert not [name for name, description in numbers if "[" not in description]


def without_tables(entry):
    """Return a schema without references to tables, whose numbers have descriptions of their own."""
    if isinstance(entry, dict):
        return {key: without_tables(value) for key, value in entry.items() if key != "$ref"}
    return [without_tables(each) for each in entry] if isinstance(entry, list) else entry


def tables(model=Table):
    """Return a model of the scene and those derived from it by their names."""
    return {name: each for below in model.__subclasses__() for name, each in tables(below).items()} | {
        model.__name__: model
    }


@pytest.mark.parametrize(("table", "key", "entry"), PROPERTIES, ids=lambda each: each if isinstance(each, str) else "")
def test_every_key_without_a_table_has_a_valid_example(table, key, entry):
    conditions = key in ("left", "bottom", "right", "top", "edge", "holes_edge") or (table, key) == ("Edges", "outline")
    if any("$ref" in each for each in parts(entry)) and not conditions:
        assert "examples" not in entry
        return
    (value,) = entry["examples"]
    TypeAdapter(tables()[table].model_fields[key].rebuild_annotation()).validate_python(value)
