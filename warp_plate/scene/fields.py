"""The base class of the scene's tables, the types of their fields, and checks that several tables share."""

import ast
import inspect
import math
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    NonNegativeInt,
    Tag,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError

from warp_plate.scene.errors import SceneError, toml_text
from warp_plate.scene.explain_errors import explain_error, is_table, suggestion

# Far beyond any panel, yet fourth powers and products of such numbers are still finite.
SMALLEST, LARGEST = 1e-30, 1e30
# Smallest width of an area as a fraction of the plate's side; float32 cannot resolve less.
NARROWEST = 1e-6


@dataclass(frozen=True)
class Unit:
    """The unit of the number or numbers of a key, in the metadata of its annotation."""

    name: str
    """SI unit, "1" for numbers without dimension; "drive" stands for the unit of the actuators' magnitudes."""


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)


class _Documented(ModelMetaclass):
    """The class of tables: documents their keys, and lists their names without those of pydantic."""

    if TYPE_CHECKING:
        model_fields: dict[str, FieldInfo]

    @property
    def __doc__(cls) -> str:  # type: ignore[override]
        """Description and keys in the form of numpydoc, read from the source when they are asked for."""
        lines = [inspect.cleandoc(vars(cls).get("__doc__") or "")]
        if cls.model_fields:
            lines += ["", "Parameters", "----------"]
        for name in cls.model_fields:
            lines += _numpydoc(cls, name)
        return "\n".join(lines)

    @property
    def __signature__(cls) -> inspect.Signature:
        """Keys with their defaults, without the annotations that pydantic would show."""
        kind = inspect.Parameter.KEYWORD_ONLY
        defaults = {name: _default(field) for name, field in cls.model_fields.items()}
        return inspect.Signature([inspect.Parameter(name, kind, default=value) for name, value in defaults.items()])

    @__signature__.setter
    def __signature__(cls, value: object) -> None:
        """Ignore pydantic's own."""

    def __dir__(cls) -> list[str]:
        parents = [parent for parent in cls.__mro__ if parent.__module__.startswith("warp_plate.")]
        names = {name for parent in parents for name in vars(parent) if not name.startswith(("_", "model_"))}
        return sorted(names | set(cls.model_fields))


def _default(field: FieldInfo) -> Any:
    """Return the default of a key; the empty parameter if it is required."""
    if field.is_required():
        return inspect.Parameter.empty
    return field.get_default(call_default_factory=True, validated_data={})


def _numpydoc(table: Any, name: str) -> list[str]:
    """Return the lines on a key: unit, default, meaning and example."""
    field, (meaning, unit, examples) = table.model_fields[name], explain_key(table, name)
    default = _default(field)
    shown = f"{type(default).__name__}()" if isinstance(default, BaseModel) else repr(default)
    table_of = next((part for part in _types_in(field.annotation) if is_table(part)), None)
    if table_of is not None:
        meaning = f"{meaning} See ``help('{table_of.__module__}.{table_of.__name__}')``.".strip()
    example = f" For example {examples[0]!r}." if examples else ""
    state = "required" if field.is_required() else f"default {shown}"
    head = f"{name} : {state if unit in (None, '1') else f'{shown_unit(unit)}, {state}'}"
    return [head, *textwrap.wrap(meaning + example, 100, initial_indent="    ", subsequent_indent="    ")]


class Table(BaseModel, metaclass=_Documented):
    """A table of the scene file. It refuses unknown keys and cannot be changed.

    The annotation of a field holds its :class:`Unit` and an example, the string below it says what it means.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    if not TYPE_CHECKING:

        def __init__(self, **values):
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise SceneError(explain_error(error, type(self))) from None

        # Pydantic then validates the tables of a file without this constructor, and reports their keys in full.
        __init__.__pydantic_base_init__ = True

        def __setattr__(self, name: str, value: object) -> None:
            try:
                super().__setattr__(name, value)
            except ValidationError:
                key = f"{_place(type(self))}{name}"
                if name not in type(self).model_fields:
                    raise SceneError(f"{key}: unknown key{suggestion(name, type(self))}") from None
                shown = toml_text(value) if isinstance(value, float | int | str) else "..."
                use = f'scene.replace("{key}", {shown}) returns a changed scene'
                raise SceneError(f"{key}: a scene is not changed by assignment; {use}") from None

    def __dir__(self) -> list[str]:
        return dir(type(self))

    @field_validator("*", mode="before")
    @classmethod
    def _neither_texts_nor_booleans(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse "4", true and sets for numbers, which pydantic would take for 4, 1 and numbers in any order."""
        if type(value) in (float, int) or not (number := _number_of(cls, str(info.field_name))):
            return value
        plain = _plain(value)
        if any(isinstance(part, bool | str | bytes | set | frozenset) for part in _leaves(plain)):
            raise PydanticCustomError("no_number", "must be {number}", {"number": number})
        return plain

    def _derive(self, key: str, value: object) -> None:
        """Set a key that follows from others, during validation: it does not count as written in the file."""
        self.__dict__[key] = value

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the table's JSON schema, in which the unit of a key follows its description."""
        schema = handler(core_schema)
        handler.resolve_ref_schema(schema)["description"] = inspect.cleandoc(vars(cls)["__doc__"])
        for name, entry in handler.resolve_ref_schema(schema).get("properties", {}).items():
            meaning, unit, _ = explain_key(cls, name)
            if meaning:
                entry["description"] = f"{meaning.removesuffix('.')} [{shown_unit(unit)}]" if unit else meaning
        return schema


def _place(table: type[Table]) -> str:
    """Return what stands before the keys of a table: "drive." or "actuators[0].", or "" at the top level."""
    parents = [Table]
    for parent in parents:
        parents += parent.__subclasses__()
        for name, field in parent.model_fields.items():
            if table in _types_in(field.annotation):
                index = "[0]" * (get_origin(field.annotation) is tuple)
                return f"{_place(parent)}{name}{index}."
    return ""


def _types_in(annotation: Any) -> Iterator[Any]:
    yield annotation
    for inner in get_args(annotation):
        yield from _types_in(inner)


@cache
def _number_of(table: type[BaseModel], name: str) -> str:
    """Return what a key must hold where it is made of numbers alone, else ""."""
    annotation = table.model_fields[name].annotation
    parts = list(_types_in(annotation))
    if any(part in (str, bool) or isinstance(part, str) or is_table(part) for part in parts):
        return ""
    several = "a list of " if any(get_origin(part) is tuple for part in parts) else ""
    if float in parts:
        return f"{several}numbers" if several else "a number"
    return (f"{several}whole numbers" if several else "a whole number") if int in parts else ""


def _plain(value: Any) -> Any:
    """Return numbers and arrays of NumPy, in lists too, as those of Python; a masked number is NaN."""
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    plain = value.tolist() if hasattr(value, "tolist") else value
    return math.nan if plain is None and value is not None else plain


def _leaves(value: Any) -> Iterator[Any]:
    if not isinstance(value, list | tuple):
        yield value
        return
    for item in value:
        yield from _leaves(item)


def unit_in(annotation: Any, metadata: Iterable[Any] = ()) -> str | None:
    """Return the unit of a field's annotation and metadata, or the first one inside it; None without a unit."""
    for item in (*metadata, *getattr(annotation, "__metadata__", ())):
        if isinstance(item, Unit):
            return item.name
    return next((unit for inner in get_args(annotation) if (unit := unit_in(inner)) is not None), None)


def shown_unit(unit: str, drive: str = "N/m² or V") -> str:
    """Return the name of a unit, with that of the actuators' magnitudes in place of "drive"."""
    return unit.replace("drive", drive)


def explain_key(table: type[BaseModel], name: str) -> tuple[str, str | None, list[Any]]:
    """Return the meaning, the unit (None without one) and examples of a key of a table."""
    field = table.model_fields[name]
    owner = next(parent for parent in table.__mro__ if name in inspect.get_annotations(parent))
    meaning = " ".join(_strings_below_fields(owner.__module__).get((owner.__name__, name), "").split())
    return meaning, unit_in(field.annotation, field.metadata), field.examples or []


@cache
def _strings_below_fields(module: str) -> dict[tuple[str, str], str]:
    """Return the strings below the fields of the classes of a module, by class and field.

    Pydantic would read them at every import (``use_attribute_docstrings``), a fifth of the time of a short command.
    """
    strings: dict[tuple[str, str], str] = {}
    module_body = ast.parse(inspect.getsource(sys.modules[module])).body
    for table in (node for node in module_body if isinstance(node, ast.ClassDef)):
        for field, below in pairwise(table.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(name)), ast.Expr(value=ast.Constant(str(text))):
                    strings[table.name, name] = text
    return strings


def _moderate(value: float) -> float:
    if value and not SMALLEST <= abs(value) <= LARGEST:
        raise PydanticCustomError("moderate", f"must be 0, or have a magnitude from {SMALLEST:g} to {LARGEST:g}")
    return value


def _not_zero(value: float) -> float:
    if value == 0:
        raise PydanticCustomError("not_zero", "must not be 0")
    return value


def _without(letter: str, name: str) -> Callable[[str], str]:
    """Return a validator that refuses texts with a letter, which the error calls by ``name``."""

    def validate(text: str) -> str:
        if letter in text:
            raise PydanticCustomError("letter", f"must be a text without {name}")
        return text

    return validate


Moderate = Annotated[float, AfterValidator(_moderate)]
Gain = Annotated[Moderate, AfterValidator(_not_zero)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_moderate)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_moderate)]
# Decides between types tagged "one" and "several".
IS_LIST = Discriminator(lambda value: "several" if isinstance(value, list | tuple) else "one")
OneOrRange = Annotated[Annotated[Positive, Tag("one")] | Annotated[tuple[Positive, Positive], Tag("several")], IS_LIST]
# These are never divided by, so they may be arbitrarily small.
Coordinate = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Count = NonNegativeInt
Instant = Annotated[float, Field(ge=0, le=LARGEST), Unit("s")]
Point = Annotated[tuple[Coordinate, Coordinate], Unit("m")]
Area = Annotated[tuple[Coordinate, Coordinate, Coordinate, Coordinate], Unit("m")]
YoungModulus = Annotated[float, Field(ge=1e3, le=1e13), Unit("Pa")]
Density = Annotated[float, Field(ge=1, le=1e5), Unit("kg/m³")]
# TOML has true and false, so no text or number is taken for one of them.
Flag = Annotated[bool, Field(strict=True)]
# HDF5 cannot store a text with a NUL character.
Text = Annotated[str, AfterValidator(_without("\0", "the character NUL"))]
Name = Annotated[str, Field(min_length=1), AfterValidator(_without("\0", "the character NUL"))]
# A name that is part of the path of an HDF5 dataset.
PartName = Annotated[Name, AfterValidator(_without("/", "'/'"))]


def as_kind(value: object, kind: Any) -> Any:
    """Return a value of an annotated kind, or raise a ValueError; an int must be 0 or more, a bool may be 0 or 1."""
    return TypeAdapter(Count if kind is int else kind).validate_python(value, strict=kind is not bool)


def flat_keys(table: Any) -> Any:
    """Return ``{"plate.density": value}`` for ``{"plate": {"density": value}}``, which TOML makes of unquoted keys."""

    def items(table: dict[str, Any], head: str) -> Iterator[tuple[str, Any]]:
        for key, value in table.items():
            if isinstance(value, dict):
                yield from items(value, f"{head}{key}.")
            else:
                yield f"{head}{key}", value

    return dict(items(table, "")) if isinstance(table, dict) else table


# Lowest and highest values, and relative tolerances, of numbers of the scene by their keys.
Ranges = Annotated[dict[str, tuple[Moderate, Moderate]], BeforeValidator(flat_keys), Unit("unit of the key")]
Tolerances = Annotated[
    dict[str, Annotated[float, Field(gt=0, lt=1)]],
    BeforeValidator(flat_keys),
    Unit("1"),
    Field(default_factory=dict, examples=[{"plate.thickness": 0.05}]),
]
_FILE_NAME = re.compile(r"[^/\\:\x00-\x1f\x7f]+")


def check_file_name(key: str, name: str, suffixes: tuple[str, ...]) -> None:
    """Raise ValueError, naming ``key``, unless this is a file name without folders and with one of the suffixes."""
    if not _FILE_NAME.fullmatch(name) or not name.lower().endswith(suffixes) or name.lower() in suffixes:
        shown = name if len(name) <= 60 else name[:57] + "..."
        kind, right = " or ".join(suffixes), "write one beside the scene file, without folders"
        raise ValueError(f"{key}: {shown!r} is not the name of a {kind} file; {right}")


def check_area(key: str, area: Area, size: tuple[float, float]) -> None:
    """Raise ValueError, naming ``key``, unless a rectangle [m] is wide enough and lies on a plate of this size [m]."""
    for axis, low, high, side in (("x", *area[:2], size[0]), ("y", *area[2:], size[1])):
        head = f"{key}: {list(area)}"
        if high <= low:
            raise ValueError(f"{head} has no inside; write x0, x1, y0, y1 with x0 < x1 and y0 < y1")
        if low < -1e-9 * side or high > side + 1e-9 * side:
            raise ValueError(f"{head} reaches off the plate; {axis} must stay in 0 ... {side:g} (metres)")
        if high - low < NARROWEST * side:
            raise ValueError(f"{head} is {high - low:.3g} m wide along {axis}; at least {NARROWEST * side:.3g} m")
