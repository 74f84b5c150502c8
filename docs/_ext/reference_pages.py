"""Sphinx extension that writes the pages under docs/reference from the code: commands, scene keys, Python names."""

import inspect
import operator
import re
import sys
import tomllib
from contextlib import suppress
from dataclasses import is_dataclass
from functools import reduce
from pathlib import Path

from pydantic import BaseModel, ValidationError

import warp_plate
from warp_plate.cli.main import COMMANDS, application, load
from warp_plate.scene.fields import Table
from warp_plate.scene.key_reference import table_references

DOCS = Path(__file__).parents[1]
# A field of a data class, and the comment on its line.
FIELD = re.compile(r"    (\w+): [^#\n]*(?:\"[^\"]*\"[^#\n]*)*(?:# (.*))?")
RETURNED = (
    "result.case.Case",
    "result.case.RegionMotion",
    "solve.run.Run",
    "modal.modes.ModalPlate",
    "result.frequency_response.FrequencyResponse",
    "result.sound.Sound",
    "modal.radiation.Air",
    "result.sweep.Sweep",
    "result.model.RobustComparison",
    "result.focus.FocusResult",
    "result.focus.FocusedWaveforms",
    "accuracy.report.AccuracyReport",
    "analysis.check.Check",
)
FITS = (
    "fit.fit_modes",
    "fit.fit_responses",
    "measured_modes.read_modes",
    "measured_modes.MeasuredModes",
    "measured_responses.read_responses",
    "measured_responses.MeasuredResponses",
    "fitted_panel.FittedPanel",
)
EXPORTS = (
    "export.write_vtkhdf",
    "export.make_drive_signal",
    "export.write_wav",
    "export.write_drive_csv",
    "export.write_traces",
    "frequency_response.write_csv",
    "frequency_response.write_hdf5",
)


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
    app.connect("autodoc-skip-member", skip_members)
    return {"parallel_read_safe": True}


def skip_members(app, what, name, member, skip, options):
    """Leave out the keys of tables, which the reference of scene keys explains, and what libraries' classes lend."""
    kind = getattr(sys.modules.get(app.env.temp_data.get("autodoc:module")), app.env.temp_data["autodoc:class"], None)
    if not isinstance(kind, type):
        return None
    if issubclass(kind, Table):
        return True if name in kind.model_fields or name in dir(BaseModel) else None
    return None if name in vars(kind) or name in inspect.get_annotations(kind) else True


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
        text = inspect.cleandoc(vars(kind)["__doc__"]).splitlines()
        lines[:] = [*text, "", "Arguments are its keys, see :doc:`/reference/scene-keys`."]
    elif what == "class" and is_dataclass(kind) and not any(line.startswith(":ivar") for line in lines):
        lines += ["", *(f":ivar {field}: {text}" for field, text in field_comments(kind).items() if text), ""]


def field_comments(kind):
    """Return the comment of each field of a data class, on its line or on those above it, by name."""
    comments, above = {}, []
    for line in inspect.getsource(kind).splitlines():
        if line.startswith("    # "):
            above.append(line[6:])
            continue
        if match := FIELD.fullmatch(line):
            comments[match[1]] = match[2] or " ".join(above)
        above = []
    return comments


def command_line():
    """Return the help of all commands."""
    for name in COMMANDS:
        load(name)
    text = application().generate_docs(output_format="markdown", recursive=True)
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
        "Files for other programs": [f"warp_plate.result.{name}" for name in EXPORTS],
    }
    for heading, names in sections.items():
        rows = "\n".join(f"   {name}" for name in names)
        text += f"\n{heading}\n{25 * '-'}\n\n.. autosummary::\n   :toctree: api\n   :nosignatures:\n\n{rows}\n"
    return text


def scene_keys():
    """Return tables of all keys of a scene file."""
    head = "# Scene keys\n\nEvery key, by table. Rules for all keys are in [the scene file](../scene.md).\n"
    return head + "".join(section(table) for table in table_references())


def section(table):
    """Return the heading, the description, the keys and an example of a table."""
    heading = ", ".join(f"`{each}`" if each.startswith("[") else each for each in table.headings)
    head = "| key | type | unit | default | range | example | meaning |\n|" + 7 * " --- |" + "\n"
    rows = "".join(row(key) for key in table.keys)
    return (
        f"\n## {heading}\n\n{table.description}\n\n{head + rows if rows else ''}"
        f"{example(table.headings[0], table.model)}"
    )


def row(key):
    """Return the row of a key."""
    cells = [f"`{key.name}`", key.type, key.unit, key.default, key.range, key.example, key.meaning]
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def example(heading, model):
    """Return a table of a preset, of an example scene or of tables.toml as TOML, if one has it and it is valid."""
    pattern = re.compile(rf"^{re.escape(heading)}(?: *#.*)?\n(?:[^\n\[].*\n)+", re.M)
    places = Path(warp_plate.__file__).parent / "scene" / "presets", DOCS / "examples", Path(__file__).parent
    for path in (path for place in places for path in sorted(place.glob("*.toml"))):
        if match := pattern.search(path.read_text(encoding="utf-8")):
            values = reduce(operator.getitem, heading.strip("[]").split("."), tomllib.loads(match[0]))
            with suppress(ValidationError):  # of a table that needs others below it
                model.model_validate(values[0] if isinstance(values, list) else values)
                return f"\n```toml\n{match[0]}```\n"
    return ""
