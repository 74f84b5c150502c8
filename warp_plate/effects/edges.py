"""The four edges of the plate: the conditions that hold them, and the terms of elastic ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError

from warp_plate.effects.effect import SLOPE, Edge, Term
from warp_plate.scene.fields import NotNegative, Table, Unit


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


class Edges(Table):
    """The four edges, each "clamped" (no displacement, no slope), "supported" (no displacement, no bending moment),
    "free" (no moment, no shear force) or on springs, such as ``{ translation = 1e6, rotation = 1e2 }`` with stiffnesses
    per length in N/m² and N·m/(rad·m)."""

    left: Annotated[EdgeCondition, Field(examples=["clamped"])] = "clamped"
    """Edge at x = 0."""
    bottom: Annotated[EdgeCondition, Field(examples=["supported"])] = "clamped"
    """Edge at y = 0."""
    right: Annotated[EdgeCondition, Field(examples=["free"])] = "clamped"
    """Edge at x = size[0]."""
    top: Annotated[EdgeCondition, Field(examples=[{"translation": 1e6, "rotation": 100.0}])] = "clamped"
    """Edge at y = size[1]."""

    def terms(self) -> Iterator[Term]:
        """Yield the springs of elastic edges: ∮ k u² + r u_n² ds."""
        for side, edge in self:
            if isinstance(edge, ElasticEdge):
                yield Term("stiffness", edge.translation, place=Edge(side), label="springs of edges")
                yield Term("stiffness", edge.rotation, SLOPE, Edge(side), label="springs of edges")
