"""The table ``[plate]`` with its outline and holes, and ``[[supports]]``."""

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_serializer, model_validator

from warp_plate.effects.edges import EdgeCondition, Edges
from warp_plate.outline.contours import piece_of_row
from warp_plate.outline.outline import Outline, make_outline
from warp_plate.outline.pieces import Piece, Straight, ellipse, straight
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import (
    Area,
    Coordinate,
    Density,
    Name,
    Point,
    Positive,
    Table,
    Unit,
    YoungModulus,
    check_file_name,
)
from warp_plate.scene.load import read_beside
from warp_plate.scene.target import Shape

# Beyond any side of a panel [m]; below most sides in millimetres.
LONGEST = 50.0


class ClosedCurve(Shape):
    """A closed curve, which may be a path, given by exactly one of its shapes."""

    shapes = (*Shape.shapes, "path")

    path: Annotated[
        Annotated[tuple[Annotated[tuple[Coordinate, ...], Field(max_length=7)], ...], Field(max_length=2000)] | None,
        Unit("m, rad"),
        Field(examples=[[[0.0, 0.0], [0.1, 0.0, 0.1, 0.05, math.pi], [0.1, 0.1]]]),
    ] = None
    """Pieces in order, each from its first point x, y to that of the next: straight ``[x, y]``, an arc
    ``[x, y, cx, cy, angle]`` about a centre, positive counterclockwise, or an arc of an ellipse
    ``[x, y, cx, cy, qx, qy, angle]`` through a point q at a quarter of its turn. Drawings become this."""

    def loop(self, condition: Any = None, edge: str = "") -> list[Piece]:
        """Return the pieces of the curve, with a condition and the key of their edge."""
        return super().loop(condition, edge) if self.path is None else self._path(condition, edge)

    def _path(self, condition: Any, edge: str) -> list[Piece]:
        rows, pieces = self.path or (), []
        for index, row in enumerate(rows):
            if len(row) not in (2, 5, 7):
                raise ValueError(f"path[{index}]: {len(row)} numbers; write 2 (straight), 5 (arc) or 7 (of an ellipse)")
        for index, (row, ahead) in enumerate(zip(rows, (*rows[1:], *rows[:1]), strict=True)):
            if len(row) > 2 and not 1e-9 < abs(row[-1]) <= 2 * math.pi:
                raise ValueError(f"path[{index}]: an angle of {row[-1]:g}; write one from -2π to 2π, not 0")
            try:
                pieces.append(piece_of_row(row, ahead, f"piece {index}", condition, edge))
            except ValueError as error:
                raise ValueError(f"path[{index}]: {error}") from None
        if not pieces:
            raise ValueError("path: has no pieces")
        return pieces


class PlateOutline(ClosedCurve):
    """The outline of the plate, in place of ``plate.size``. Its coordinates are those of the scene, from 0 on."""

    shapes = (*ClosedCurve.shapes, "file")
    needs_centre = False

    file: Annotated[Name | None, Field(examples=["panel.svg"])] = None
    """SVG or DXF file beside the scene file. The largest contour is the outline, with the lower left corner of its
    bounding box at 0, 0, and those inside are holes. Reading a scene puts ``path`` in place of the file."""
    unit: Annotated[Literal["m", "mm", "inch"] | None, Field(examples=["mm"])] = None
    """Unit of the coordinates in the file, if it does not say."""
    layer: Annotated[Name | None, Field(examples=["cut"])] = None
    """Layer of a DXF file, or id or label of an element or group of an SVG file, that alone is read."""
    tolerance: Annotated[Positive | None, Unit("m"), Field(examples=[1e-6])] = None
    """Largest distance of Bézier curves and splines of the file from the arcs that replace them; by default 1e-5 of
    the longer side of what is drawn."""
    holes_edge: Annotated[EdgeCondition | None, Field(examples=["free"])] = None
    """Condition of the edges of holes in the file, by default free."""

    @model_validator(mode="after")
    def _keys_of_file(self) -> Self:
        if self.file is not None:
            check_file_name("file", self.file, (".svg", ".dxf"))
            return self
        for key in ("unit", "layer", "tolerance", "holes_edge"):
            if getattr(self, key) is not None:
                raise ValueError(f"{key}: not for {self.shape}; only for file")
        return self


class Hole(ClosedCurve):
    """A hole of the plate."""

    edge: Annotated[EdgeCondition, Field(examples=["free"])] = "free"
    """Condition of its edge."""


class Support(Table):
    """A support of the plate besides its edges, which holds the displacement; rigid without ``stiffness``."""

    point: Annotated[Point | None, Field(examples=[[0.01, 0.01]])] = None
    """Point x, y."""
    line: Annotated[tuple[Point, Point] | None, Field(examples=[[[0.0, 0.05], [0.1, 0.05]]])] = None
    """Ends of a straight line."""
    ring: Annotated[tuple[Coordinate, Coordinate, Positive] | None, Unit("m"), Field(examples=[[0.1, 0.1, 0.05]])] = (
        None
    )
    """Centre x, y and radius of a circle that is held."""
    stiffness: Annotated[Positive | None, Unit("N/m or N/m²"), Field(examples=[1e5])] = None
    """Stiffness of a point, or per length of a line or ring."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if sum(place is not None for place in (self.point, self.line, self.ring)) != 1:
            raise ValueError("point: write one of point, line and ring")
        if self.line is not None and self.line[0] == self.line[1]:
            raise ValueError(f"line: {[list(end) for end in self.line]} has no length; write point, or move an end")
        return self

    @property
    def ends(self) -> tuple[Point, ...]:
        """The point, or the ends of the line."""
        return (self.point,) if self.point is not None else self.line or ()

    def piece(self, key: str) -> Piece | None:
        """Return the curve of a line or ring as an edge of a key, supported if it is rigid; None for a point."""
        condition = "supported" if self.stiffness is None else "free"
        if self.ring is not None:
            x, y, radius = self.ring
            return ellipse((x, y), (radius, radius), 0.0, condition, key)
        return Straight(condition, key, key, np.array(self.line, dtype=float)) if self.line else None


@lru_cache
def outline_of(outline: PlateOutline, holes: tuple[Hole, ...], edges: Edges) -> Outline:
    """Return the geometry of a plate's outline with its holes and edge conditions; ValueError: it is not valid."""
    loops = {"plate.outline": outline.loop(edges.outline, "outline")}
    loops |= {f"plate.holes[{index}]": hole.loop(hole.edge, f"holes[{index}]") for index, hole in enumerate(holes)}
    parts = {f"parts[{index}]": (part.from_point, part.to_point, part.edge) for index, part in enumerate(edges.parts)}
    return make_outline(loops, parts)


@lru_cache
def outline_of_rectangle(size: tuple[float, float], edges: Edges) -> Outline:
    """Return the geometry of a plate given by its size, with the edges of its four sides."""
    (width, height), sides = size, ("bottom", "right", "top", "left")
    loop = straight([(0, 0), (width, 0), (width, height), (0, height)], None, "")
    pieces = [piece.on(getattr(edges, side), side) for piece, side in zip(loop, sides, strict=True)]
    return make_outline({"plate.size": pieces}, {})


class Plate(Table):
    """Geometry and material of the plate."""

    size: Annotated[tuple[Positive, Positive], Unit("m"), Field(examples=[[0.2, 0.12]])]
    """Sides along x and y; of a plate with an outline, which has no such key, where the outline ends."""
    thickness: Annotated[Positive, Unit("m"), Field(examples=[0.7e-3])]
    """Thickness H, at most a fifth of the shorter side."""
    young_modulus: Annotated[YoungModulus, Field(examples=[72e9])]
    """Young's modulus E."""
    poisson_ratio: Annotated[float, Field(ge=-0.99, lt=0.5, examples=[0.22]), Unit("1")]
    """Poisson's ratio ν."""
    density: Annotated[Density, Field(examples=[2480.0])]
    """Density ρ."""
    outline: PlateOutline | None = None
    """Outline of a plate that is no rectangle with sides along x and y."""
    holes: tuple[Hole, ...] = ()
    """Holes of a plate with an outline."""

    @property
    def box(self) -> Area:
        """Ends 0, width, 0, height of the sides [m]."""
        return 0.0, self.size[0], 0.0, self.size[1]

    @property
    def rigidity(self) -> float:
        """Bending rigidity EH³/12(1 − ν²) [N·m] of the isotropic plate."""
        return self.young_modulus * self.thickness**3 / (12 * (1 - self.poisson_ratio**2))

    @property
    def kappa(self) -> float:
        """κ = √(D/ρH) [m²/s] of the isotropic plate: a bending wave of frequency f has the length √(2πκ/f)."""
        return math.sqrt(self.rigidity / (self.density * self.thickness))

    @property
    def area(self) -> float:
        """Area [m²]."""
        return math.prod(self.size) if self.outline is None else outline_of(self.outline, self.holes, Edges()).area

    @model_validator(mode="before")
    @classmethod
    def _size_of_outline(cls, tables: Any) -> Any:
        """Set the size of a plate with an outline: the upper ends of the outline's coordinates."""
        if not isinstance(tables, dict) or tables.get("outline") is None:
            return tables
        if "size" in tables:
            raise ValueError("size: outline is given too; write one of them")
        try:
            outline = PlateOutline.model_validate(tables["outline"])
        except ValidationError:  # reported by the validation of ``outline``
            return {**tables, "size": (1.0, 1.0)}
        if outline.file is not None:
            raise ValueError(f"outline.file: {outline.file!r} is read with a scene file beside it; write that, or path")
        try:
            x0, x1, y0, y1 = outline_of(outline, (), Edges()).bounds
        except ValueError as error:  # which names the key in the scene
            raise ValueError(str(error).removeprefix("plate.")) from None
        if min(x0, y0) < -1e-9 * max(x1 - x0, y1 - y0):
            raise ValueError(f"outline: reaches to x = {x0:.6g}, y = {y0:.6g} m; move it to x, y from 0 on")
        return {**tables, "size": (x1, y1)}

    @model_serializer(mode="wrap")
    def _without_size_of_outline(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Write the tables of a file, in which a plate with an outline has no size."""
        tables = write(self)
        if self.outline is not None:
            del tables["size"]
        return tables

    @model_validator(mode="after")
    def _thin(self) -> Self:
        if self.holes and self.outline is None:
            raise ValueError("holes: need an outline; write outline = { rectangle = [width, height] } in place of size")
        if max(self.size) > LONGEST:
            raise ValueError(f"size: {list(self.size)} is above {LONGEST:g} m; are lengths in metres?")
        self.check_thin(self.thickness, "thickness: ")
        return self

    def check_point(self, key: str, point: Point) -> None:
        """Raise ValueError, beginning with ``key``, unless a point x, y [m] is on the plate."""
        if not all(0 <= at <= side for at, side in zip(point, self.size, strict=True)):
            raise ValueError(f"{key}: {list(point)} is off the plate of {list(self.size)} m")
        if self.outline is not None and not outline_of(self.outline, self.holes, Edges()).contains([point]).all():
            raise ValueError(f"{key}: {list(point)} is off the plate; move it inside the outline, outside its holes")

    def check_thin(self, thickness: float, head: str = "") -> None:
        """Raise ValueError, beginning with ``head``, unless a thickness [m] is small against the sides."""
        if thickness > min(self.size) / 5:
            limit = "a plate is thinner than a fifth of its side (lengths are in metres)"
            raise ValueError(f"{head}{thickness:g} m is not thin for a side of {min(self.size):g} m; {limit}")


def with_drawing(tables: dict[str, Any], folder: Path | None) -> dict[str, Any]:
    """Return the tables of a scene with paths in place of a file of its outline, whose holes follow those written.

    Raises:
        SceneError: The file is missing, broken, or draws no outline.
    """
    plate = tables.get("plate")
    if not isinstance(plate, dict) or not isinstance(table := plate.get("outline"), dict) or "file" not in table:
        return tables
    try:
        outline = PlateOutline.model_validate(table)
    except ValidationError:  # reported by the validation of the scene
        return tables
    from warp_plate.outline.drawings import read_drawing

    name = outline.file or ""
    data = read_beside("plate.outline.file", name, folder)
    try:
        path, *holes = read_drawing(data, Path(name).suffix.lower(), outline.unit, outline.tolerance, outline.layer)
    except ValueError as error:
        raise SceneError(f"plate.outline.file = {name!r}: {error}") from None
    edge = table.get("holes_edge", "free")
    inside = [{"path": hole, "edge": edge} for hole in holes]
    if isinstance(written := plate.get("holes", []), list):
        written = [*written, *inside]
    return {**tables, "plate": {**plate, "outline": {"path": path}, "holes": written}}
