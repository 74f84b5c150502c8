"""The edges of the plate: the conditions that hold them, and the terms of elastic ones."""

from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from warp_plate.effects.effect import SLOPE, Edge, Term
from warp_plate.scene.fields import NotNegative, Point, Table, Unit


class ElasticEdge(Table):
    """An edge on springs."""

    translation: Annotated[NotNegative, Unit("N/m²"), Field(examples=[1e6])] = 0.0
    """Stiffness against displacement, per length."""
    rotation: Annotated[NotNegative, Unit("N·m/(rad·m)"), Field(examples=[100.0])] = 0.0
    """Stiffness against slope, per length."""


def _edge_word(value: object) -> object:
    if value not in ("clamped", "supported", "free"):
        raise PydanticCustomError(
            "edge_word",
            "must be 'clamped', 'supported', 'free', or a table of springs such as { translation = 1e6 }",
        )
    return value


EdgeCondition = Annotated[
    Annotated[Literal["clamped", "supported", "free"], BeforeValidator(_edge_word), Tag("word")]
    | Annotated[ElasticEdge, Tag("springs")],
    Discriminator(lambda value: "springs" if isinstance(value, dict | ElasticEdge) else "word"),
]


class EdgePart(Table):
    """A part of the edge of an outline with another condition than the rest, counterclockwise from a point to another;
    ``from`` and ``to`` are other names of the two."""

    edge: Annotated[EdgeCondition, Field(examples=["free"])]
    """Condition of the part."""
    from_point: Annotated[Point, Field(examples=[[0.04, 0.02]])]
    """First point x, y on the outline."""
    to_point: Annotated[Point, Field(examples=[[0.02, 0.04]])]
    """Last point x, y on the outline."""

    @model_validator(mode="before")
    @classmethod
    def _plain_names(cls, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        return {f"{key}_point" if key in ("from", "to") else key: value for key, value in table.items()}


class Edges(Table):
    """The four edges of a rectangle, or the edge of an outline, each "clamped" (no displacement, no slope), "supported"
    (no displacement, no bending moment), "free" (no moment, no shear force) or on springs, such as
    ``{ translation = 1e6, rotation = 1e2 }`` with stiffnesses per length in N/m² and N·m/(rad·m)."""

    left: Annotated[EdgeCondition, Field(examples=["clamped"])] = "clamped"
    """Edge at x = 0."""
    bottom: Annotated[EdgeCondition, Field(examples=["supported"])] = "clamped"
    """Edge at y = 0."""
    right: Annotated[EdgeCondition, Field(examples=["free"])] = "clamped"
    """Edge at x = size[0]."""
    top: Annotated[EdgeCondition, Field(examples=[{"translation": 1e6, "rotation": 100.0}])] = "clamped"
    """Edge at y = size[1]."""
    outline: Annotated[EdgeCondition | None, Field(examples=["clamped"])] = None
    """Edge of a plate with an outline, in place of the four others; by default clamped."""
    parts: tuple[EdgePart, ...] = ()
    """Parts of it with other conditions."""

    def __iter__(self) -> Iterator[tuple[str, Any]]:  # type: ignore[override]
        """Yield name and condition of the edges that the plate has."""
        if self.outline is None:
            yield from ((side, getattr(self, side)) for side in SIDES)
            return
        yield "outline", self.outline
        yield from ((f"parts[{index}]", part.edge) for index, part in enumerate(self.parts))

    def check(self, has_outline: bool) -> None:
        """Raise ValueError, naming the key, unless the keys are those of a plate with or without an outline."""
        if not has_outline and (self.outline is not None or self.parts):
            key = "outline" if self.outline is not None else "parts"
            raise ValueError(f"edges.{key}: the plate has no outline; write {', '.join(SIDES)}, or [plate.outline]")
        for side in SIDES:
            if has_outline and getattr(self, side) != "clamped":
                raise ValueError(f"edges.{side}: the plate has an outline; write edges.outline and [[edges.parts]]")


SIDES = ("left", "bottom", "right", "top")


def edge_terms(edges: Iterable[tuple[str, Any]]) -> Iterator[Term]:
    """Yield the springs ∮ k u² + r u_n² ds of the elastic ones among edges by name."""
    for name, edge in edges:
        if isinstance(edge, ElasticEdge):
            yield Term("stiffness", edge.translation, place=Edge(name), label="springs of edges")
            yield Term("stiffness", edge.rotation, SLOPE, Edge(name), label="springs of edges")
