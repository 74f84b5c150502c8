"""Sphinx extension that writes the pages under docs/reference from the code: commands, scene keys, Python names."""

import inspect
import operator
import re
import tomllib
from dataclasses import is_dataclass
from functools import reduce
from pathlib import Path
from typing import get_args

import warp_plate
from warp_plate.cli.commands import app as commands
from warp_plate.scene.errors import toml_text
from warp_plate.scene.fields import LARGEST, Table
from warp_plate.scene.keys import UNITS
from warp_plate.scene.model import Scene
from warp_plate.scene.schema import field_comments

DOCS = Path(__file__).parents[1]
SCHEMA = Scene.model_json_schema()
RETURNED = (
    "result.model.Case",
    "result.model.RegionMotion",
    "solve.run.Run",
    "modal.modes.ModalPlate",
    "result.frequency_response.FrequencyResponse",
    "result.sweep.Sweep",
    "result.comparison.MethodComparison",
    "result.robust.RobustComparison",
    "result.focus.FocusResult",
    "result.focus.FocusedWaveforms",
    "accuracy.report.AccuracyReport",
    "analysis.check.Check",
)
FITS = (
    "fit_modes.fit_modes",
    "fit_responses.fit_responses",
    "measured_modes.read_modes",
    "measured_modes.MeasuredModes",
    "measured_responses.read_responses",
    "measured_responses.MeasuredResponses",
    "fitted_panel.FittedPanel",
)
EXPORTS = (
    "paraview.write_pvd",
    "paraview.write_vtkhdf",
    "time_series.make_drive_signal",
    "time_series.write_wav",
    "time_series.write_drive_csv",
    "time_series.write_traces",
    "frequency_response.write_csv",
    "frequency_response.write_uff",
    "frequency_response.write_hdf5",
)
BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}


def setup(app):
    """Write the pages whose text has changed, before Sphinx looks for pages."""
    pages = {"command-line.md": command_line(), "scene-keys.md": scene_keys(), "python-api.rst": python_api()}
    for name, text in pages.items():
        path = DOCS / "reference" / name
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-process-docstring", add_fields)
    return {"parallel_read_safe": True}


def short_signature(app, what, name, kind, options, signature, returned):
    """Return the signature without the limits of numbers; none for tables of a scene and other plain data."""
    if what == "class" and (issubclass(kind, Table) or is_dataclass(kind)):
        return "", None
    while signature and (start := signature.find("Annotated[")) >= 0:
        depth, end, comma = 1, start + len("Annotated["), 0
        while depth:
            depth += {"[": 1, "]": -1}.get(signature[end], 0)
            comma = comma or end * (depth == 1 and signature[end] == ",")
            end += 1
        signature = signature[:start] + signature[start + len("Annotated[") : comma] + signature[end:]
    return signature, returned


def add_fields(app, what, name, kind, options, lines):
    """Add a link to the keys of a scene's table, or the comments beside the fields of a data class."""
    if what == "class" and issubclass(kind, Table):
        lines += ["", "Arguments are its keys, see :doc:`/reference/scene-keys`."]
    elif what == "class" and is_dataclass(kind) and not any(line.startswith(":ivar") for line in lines):
        lines += ["", *(f":ivar {field}: {text}" for field, text in field_comments(kind).items() if text), ""]


def command_line():
    """Return the help of all commands."""
    text = commands.generate_docs(output_format="markdown", recursive=True)
    return re.sub(r"## Table of Contents\n\n(- .*\n)+", "", text).replace("# warp-plate\n", "# Command line\n", 1)


def python_api():
    """Return a page that lists the public names, with a page for each."""
    public = [name for name in warp_plate.__all__ if not name.startswith("_")]
    classes = [name for name in public if name[0].isupper()]
    text = "Python API\n==========\n\n``import warp_plate as wpl`` imports a name when it is first used.\n"
    sections = {
        "Functions": [f"warp_plate.{name}" for name in sorted(set(public) - set(classes))],
        "Classes": [f"warp_plate.{name}" for name in classes],
        "What functions return": [f"warp_plate.{name}" for name in RETURNED],
        "Fits": [f"warp_plate.fitting.{name}" for name in FITS],
        "Files for other programs": [f"warp_plate.result.export.{name}" for name in EXPORTS],
    }
    for heading, names in sections.items():
        rows = "\n".join(f"   {name}" for name in names)
        text += f"\n{heading}\n{25 * '-'}\n\n.. autosummary::\n   :toctree: api\n   :nosignatures:\n\n{rows}\n"
    return text


def scene_keys():
    """Return tables of all keys of a scene file."""
    head = "# Scene keys\n\nEvery key, by table. Rules for all keys are in [the scene file](../scene.md).\n"
    sections = {}
    collect("", Scene.__name__, False, sections)
    return head + "".join(section(name, paths) for name, paths in sections.items())


def collect(path, name, repeated, sections):
    """Add the table of a name in the schema, and all tables in it, to ``sections``: {name: headings}."""
    sections.setdefault(name, []).append(f"[[{path}]]" if repeated else f"[{path}]" if path else "Top level")
    for key, field in definition(name)["properties"].items():
        inner = [field, field.get("items", {}), *field.get("anyOf", [])]
        for table in (each["$ref"].rpartition("/")[2] for each in inner if "$ref" in each):
            collect(f"{path}.{key}".strip("."), table, "items" in field, sections)


def definition(name):
    return SCHEMA if name == Scene.__name__ else SCHEMA["$defs"][name]


def section(name, paths):
    """Return the heading, the description, the keys and an example of a table."""
    model, path = tables()[name], paths[0].strip("[]")
    said, rows = field_comments(model), []
    for key, field in definition(name)["properties"].items():
        if (path or key == "title") and ("$ref" not in str(field) or "enum" in str(field)):
            rows.append(row(f"{path}.{key}", field, model.model_fields[key], said.get(key, "")))
    heading = ", ".join(f"`{each}`" if each.startswith("[") else each for each in paths)
    head = "| key | type | unit | default | range | example | meaning |\n|" + 7 * " --- |" + "\n"
    description = re.sub(r":\w+:`([^`]+)`", r"`\1`", inspect.cleandoc(model.__doc__ or "").replace("``", "`"))
    return f"\n## {heading}\n\n{description}\n\n{head + ''.join(rows) if rows else ''}{example(paths[0], model)}"


def row(path, field, info, meaning):
    """Return the row of a key."""
    measured, default = unit(path), field.get("default")
    default = "required" if info.is_required() else "" if default is None else f"`{toml_text(default)}`"
    meaning = meaning.replace(f" [{measured or 1}]", "").replace("``", "`")
    meaning = meaning[:1].upper() + meaning[1:] if meaning[:2].isascii() and meaning[:2].isalpha() else meaning
    key = f"`{path.rpartition('.')[2]}`"
    shown = f"`{toml_text(field['examples'][0])}`" if "examples" in field else ""
    cells = key, kind(field), measured, default, limits(info.annotation, info.metadata), shown, meaning
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def tables(model=Table):
    """Return a model and all its subclasses by their names."""
    below = [tables(each) for each in model.__subclasses__()]
    return {model.__name__: model} | {name: each for found in below for name, each in found.items()}


def kind(field):
    """Return the type of a field of the schema in words."""
    if "enum" in field or "const" in field:
        return ", ".join(f"`{toml_text(value)}`" for value in field.get("enum", [field.get("const")]))
    if "anyOf" in field or "oneOf" in field:
        return " or ".join(kind(each) for each in field.get("anyOf", field.get("oneOf")) if each.get("type") != "null")
    if "$ref" in field:
        return "table"
    if "prefixItems" in field:
        return f"{len(field['prefixItems'])} {kind(field['prefixItems'][0])}s"
    if field.get("type") == "array":
        return f"list of {kind(field['items'])}s".replace("ss", "s")
    if field.get("type") == "object":
        return f"table of {kind(field['additionalProperties'])} by key"
    return {"boolean": "true or false", "string": "text"}.get(field["type"], field["type"])


def limits(annotation, metadata=()):
    """Return the limits of the numbers of an annotation, or of the first kind in it that has any."""
    for each in (annotation, *get_args(annotation)):
        metadata = [*metadata, *getattr(each, "metadata", []), *getattr(each, "__metadata__", [])]
    flat = [inner for each in metadata for inner in getattr(each, "metadata", [each])]
    found = [(sign, getattr(each, name)) for each in flat for name, sign in BOUNDS.items() if hasattr(each, name)]
    text = ", ".join(dict.fromkeys(f"{sign} {value:g}" for sign, value in found if abs(value) < LARGEST))
    return text or next((text for each in get_args(annotation) if (text := limits(each))), "")


def unit(key):
    """Return the unit of a key by the longest end that the table of units has."""
    names = key.split(".")
    ends = (".".join(names[index:]) for index in range(len(names)))
    return UNITS.get(next((end for end in ends if end in UNITS), ""), "").replace("drive", "N/m²").removesuffix("1")


def example(heading, model):
    """Return a table of a preset, of an example scene or of tables.toml as TOML, if one has it and it is valid."""
    pattern = re.compile(rf"^{re.escape(heading)}(?: *#.*)?\n(?:[^\n\[].*\n)+", re.M)
    places = Path(warp_plate.__file__).parent / "scene" / "presets", DOCS / "examples", Path(__file__).parent
    for path in (path for place in places for path in sorted(place.glob("*.toml"))):
        if match := pattern.search(path.read_text(encoding="utf-8")):
            values = reduce(operator.getitem, heading.strip("[]").split("."), tomllib.loads(match[0]))
            model.model_validate(values[0] if isinstance(values, list) else values)
            return f"\n```toml\n{match[0]}```\n"
    return ""
