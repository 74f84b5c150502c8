"""Shapes on the plate: the tables that have one as their base, and the tables ``[target]`` and ``[[targets]]``."""

import math
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from warp_plate.outline.outline import Outline, bounds
from warp_plate.outline.pieces import Piece, ellipse, rounded, straight
from warp_plate.scene.errors import toml_text
from warp_plate.scene.fields import (
    NARROWEST,
    Area,
    Coordinate,
    NotNegative,
    PartName,
    Point,
    Positive,
    Table,
    Unit,
    check_area,
    check_file_name,
)

# Corners of the polygon of a disc in pictures.
OUTLINE_CORNERS = 96
# Keys that belong to some of the shapes only.
ONLY_FOR = {"corner_radius": ("rectangle", "polygon"), "angle": ("rectangle",), "centre": ("rectangle",)}


class Shape(Table):
    """A closed curve, given by exactly one of its shapes."""

    shapes: ClassVar[tuple[str, ...]] = ("disc", "ellipse", "rectangle", "polygon")
    needs_centre: ClassVar[bool] = True

    disc: Annotated[tuple[Coordinate, Coordinate, Positive] | None, Unit("m"), Field(examples=[[0.02, 0.02, 0.02]])] = (
        None
    )
    """Centre x, y and radius."""
    ellipse: Annotated[
        tuple[Coordinate, Coordinate, Positive, Positive, Coordinate] | None,
        Unit("m, rad"),
        Field(examples=[[0.1, 0.06, 0.1, 0.06, 0.0]]),
    ] = None
    """Centre x, y, half axes, and the angle of the first of them from x in radians."""
    rectangle: Annotated[tuple[Positive, Positive] | None, Unit("m"), Field(examples=[[0.07, 0.15]])] = None
    """Sides, which are along x and y unless ``angle`` turns them."""
    polygon: Annotated[
        Annotated[tuple[Point, ...], Field(min_length=3, max_length=1000)] | None,
        Field(examples=[[[0.02, 0.02], [0.08, 0.02], [0.05, 0.07]]]),
    ] = None
    """Corners x, y in order, clockwise or counterclockwise; sides must not cross."""
    corner_radius: Annotated[NotNegative | None, Unit("m"), Field(examples=[0.008])] = None
    """Radius of the arcs at the corners of a rectangle or polygon (default: 0)."""
    angle: Annotated[Coordinate | None, Unit("rad"), Field(examples=[0.5])] = None
    """Angle from x of a rectangle's first side (default: 0)."""
    centre: Annotated[Point | None, Field(examples=[[0.05, 0.05]])] = None
    """Centre x, y of a rectangle; of an outline, by default, where it touches the axes from x, y ≥ 0."""

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        given = [name for name in self.shapes if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{given[1]}: {given[0]} is given too; write one of them")
        if not given:
            *others, last = self.shapes
            raise ValueError(f"{others[0]}: no shape is given; write one of {', '.join(others)} and {last}")
        for key, shapes in ONLY_FOR.items():
            if getattr(self, key) and given[0] not in shapes:
                raise ValueError(f"{key}: not for {given[0]}; only for {' and '.join(shapes)}")
        if self.needs_centre and self.rectangle is not None and self.centre is None:
            raise ValueError("centre: is missing; write the centre x, y of the rectangle")
        if given[0] not in ("area", "mask", "file"):
            self.loop()
        return self

    @property
    def shape(self) -> str:
        """Name of the shape that is given, one of ``shapes``."""
        return next(name for name in self.shapes if getattr(self, name) is not None)

    @property
    def description(self) -> str:
        """Key and value of the shape, for messages and tables."""
        value = getattr(self, self.shape)
        if self.shape == "polygon" and len(value) > 6:
            return f"polygon of {len(value)} corners"
        if self.shape == "path":
            return f"path of {len(value)} pieces"
        return f"{self.shape} = {toml_text(value)}"

    def loop(self, condition: Any = None, edge: str = "") -> list[Piece]:
        """Return the pieces of the curve, with a condition and the key of their edge."""
        if self.disc is not None:
            *middle, radius = self.disc
            return [ellipse((middle[0], middle[1]), (radius, radius), 0.0, condition, edge)]
        if self.ellipse is not None:
            x, y, first, second, angle = self.ellipse
            return [ellipse((x, y), (first, second), angle, condition, edge)]
        if self.polygon is not None:
            corners = np.array(self.polygon)
            for index, (corner, ahead) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
                if (corner == ahead).all():
                    raise ValueError(f"polygon[{index}]: the next corner is the same; write no corner twice")
        else:
            corners = self._rectangle_corners()
        return self._rounded(corners, condition, edge)

    def _rounded(self, corners: np.ndarray, condition: Any, edge: str) -> list[Piece]:
        radius = self.corner_radius or 0.0
        try:
            return rounded(straight(corners, condition, edge), radius)
        except ValueError as error:
            raise ValueError(f"corner_radius: {radius:g} m does not fit: {error}") from None

    def _rectangle_corners(self) -> np.ndarray:
        assert self.rectangle is not None
        cosine, sine = math.cos(self.angle or 0.0), math.sin(self.angle or 0.0)
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        corners = np.asarray(signs * np.array(self.rectangle) / 2 @ np.array([[cosine, sine], [-sine, cosine]]))
        if self.centre is not None:
            return corners + self.centre
        x0, _, y0, _ = bounds(self._rounded(corners, None, ""))
        return corners - (x0, y0)


class PlateRegion(Shape):
    """A part of the plate, given by exactly one of its shapes."""

    shapes = ("area", *Shape.shapes)

    area: Annotated[Area | None, Field(examples=[[0.08, 0.12, 0.04, 0.08]])] = None
    """Rectangle x0, x1, y0, y1."""

    @property
    def region(self) -> "PlateRegion":
        """The shape alone."""
        return PlateRegion.model_construct(**{key: getattr(self, key) for key in PlateRegion.model_fields})

    @property
    def box(self) -> Area:
        """Smallest rectangle x0, x1, y0, y1 [m] around the region."""
        return bounds(self.loop()) if self.area is None else self.area

    @property
    def middle(self) -> Point:
        """Middle x, y of the bounding box [m]."""
        x0, x1, y0, y1 = self.box
        return (x0 + x1) / 2, (y0 + y1) / 2

    @property
    def patch_area(self) -> float:
        """Area of the region [m²]."""
        if self.area is None:
            return abs(sum(piece.area for piece in self.loop()))
        x0, x1, y0, y1 = self.area
        return (x1 - x0) * (y1 - y0)

    def loop(self, condition: Any = None, edge: str = "") -> list[Piece]:
        """Return the pieces of the curve, with a condition and the key of their edge."""
        if self.area is None:
            return super().loop(condition, edge)
        x0, x1, y0, y1 = self.area
        return straight([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], condition, edge)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return whether points (..., 2) [m] are in the region."""
        return Outline((tuple(self.loop()),)).contains(points)

    def placed(self, x: float, y: float) -> dict[str, Any]:
        """Return the keys of the shape with the middle of its ``box`` at x, y [m]; the same numbers if it is there."""
        if self.area is not None:
            return {"area": (*_span_around(x, *self.area[:2]), *_span_around(y, *self.area[2:]))}
        shift = x - self.middle[0], y - self.middle[1]
        if self.polygon is not None:
            return {"polygon": tuple((at_x + shift[0], at_y + shift[1]) for at_x, at_y in self.polygon)}
        key = "centre" if self.rectangle is not None else self.shape
        at_x, at_y, *rest = getattr(self, key)
        return {key: (at_x + shift[0], at_y + shift[1], *rest)}

    def moved_to(self, x: float, y: float) -> "PlateRegion":
        """Return the shape alone with the middle of its ``box`` at x, y [m]."""
        return PlateRegion.model_construct(**{**dict(self.region), **self.placed(x, y)})

    def flattened(self, of_disc: int = OUTLINE_CORNERS) -> np.ndarray:
        """Return the (corners, 2) x, y [m] of the outline, a disc as a polygon of ``of_disc`` corners.

        The polygon of a disc or an ellipse has its area; with n corners its outline deviates by at most (π/n)²/3 radii.
        """
        ellipse = self.ellipse or (None if self.disc is None else (*self.disc, self.disc[2], 0.0))
        if ellipse is not None:
            x, y, first, second, turn = ellipse
            angle = 2 * math.pi * (np.arange(of_disc) + 0.5) / of_disc
            outer = math.sqrt(2 * math.pi / of_disc / math.sin(2 * math.pi / of_disc))
            along, across = first * outer * np.cos(angle), second * outer * np.sin(angle)
            cosine, sine = math.cos(turn), math.sin(turn)
            return np.column_stack([x + cosine * along - sine * across, y + sine * along + cosine * across])
        return np.concatenate([piece.polyline(2 * math.pi / of_disc)[:-1] for piece in self.loop()])

    def closed_path(self) -> np.ndarray:
        """Return the (points, 2) x, y [m] of the outline, the first of them again at the end."""
        corners = self.flattened()
        return np.concatenate([corners, corners[:1]])

    def check(self, key: str, size: tuple[float, float], over: bool = False, note: str = "") -> None:
        """Raise ValueError, naming ``key`` and a ``note`` on it, unless the region has an inside and lies on a plate of
        this size [m]; with ``over`` shapes other than ``area`` may reach over the edge."""
        named = f"{key}.{self.shape}{note}"
        if self.area is not None:
            return check_area(named, self.area, size)
        if self.polygon is not None:
            _check_polygon(named, np.array(self.polygon), size, over)
        x0, x1, y0, y1 = self.box
        for low, high, side in ((x0, x1, size[0]), (y0, y1, size[1])):
            if (low < -1e-9 * min(size) or high > side * (1 + 1e-9)) and not over:
                value, inside = list(getattr(self, self.shape)), f"in 0 ... {size[0]:g}, 0 ... {size[1]:g} (metres)"
                keys = "x, y, radius" if self.disc is not None else "a shape"
                raise ValueError(f"{named}: {value} is off the plate; write {keys} {inside}")
            if high - low < NARROWEST * max(size):
                if self.disc is not None:
                    least = f"a radius of {self.disc[2]:.3g} m; at least {NARROWEST / 2 * max(size):.3g} m"
                    raise ValueError(f"{named}: {least}")
                raise ValueError(f"{named}: is {high - low:.3g} m wide; at least {NARROWEST * max(size):.3g} m")
        return None


class Target(PlateRegion):
    """A region of the plate, given by exactly one of its shapes.

    A mask is a CSV file beside the scene file with the fraction 0 ... 1 of the plate that belongs to the target around
    each of its points: rows along y, columns along x, evenly spaced from edge to edge, with bilinear interpolation.
    """

    shapes = (*PlateRegion.shapes, "mask")

    mask: Annotated[str | None, Field(examples=["finger.csv"])] = None
    """Name of a CSV file."""

    @model_validator(mode="after")
    def _file(self) -> Self:
        if self.mask is not None:
            check_file_name("mask", self.mask, (".csv",))
        return self

    def corners(self, of_disc: int) -> np.ndarray | None:
        """Return the corners of :meth:`flattened`; None for a mask."""
        return None if self.mask is not None else self.flattened(of_disc)

    def check(self, key: str, size: tuple[float, float], over: bool = False, note: str = "") -> None:
        """Check the region, see :meth:`PlateRegion.check`; a mask is checked where it is read."""
        if self.mask is None:
            super().check(key, size, over, note)


class NamedTarget(Target):
    """A target of several. Its name is part of the names of datasets, so it has no slash."""

    name: Annotated[PartName, Field(examples=["left thumb"])]
    """Name without "/", different for each target."""

    @property
    def unnamed(self) -> Target:
        """The target without its name."""
        return Target.model_construct(**{key: getattr(self, key) for key in Target.model_fields})


def _span_around(middle: float, low: float, high: float) -> tuple[float, float]:
    """Return low and high moved to another middle; unchanged to the last bit if the middle is the same."""
    if middle == (low + high) / 2:
        return low, high
    return middle - (high - low) / 2, middle + (high - low) / 2


def area_within(corners: np.ndarray) -> float:
    """Return the area [m²] of a polygon (corners, 2), negative for clockwise corners."""
    if not len(corners):
        return 0.0
    x, y = (corners - corners.mean(axis=0)).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def _check_polygon(key: str, corners: np.ndarray, size: tuple[float, float], over: bool) -> None:
    for index, (x, y) in enumerate(corners.tolist()):
        if not over and not all(-1e-9 * side <= at <= side * (1 + 1e-9) for at, side in zip((x, y), size, strict=True)):
            inside = f"0 ... {size[0]:g}, 0 ... {size[1]:g} (metres)"
            raise ValueError(f"{key}[{index}]: {[x, y]} is off the plate; x, y must stay in {inside}")
    if np.ptp(corners, axis=0).min() < NARROWEST * max(size):
        raise ValueError(f"{key}: is less than {NARROWEST * max(size):.3g} m wide along x or y; write a wider one")
    if (crossed := _crossed_sides(corners / size)) is not None:
        first, second = crossed
        sides = f"the sides that begin at corners {first} and {second} meet or cross"
        raise ValueError(f"{key}: {sides}; write the corners in their order along the outline, none twice")
    if abs(area_within(corners)) < (NARROWEST**2) * size[0] * size[1]:
        raise ValueError(f"{key}: its corners lie on one line, so it has no inside")


def _crossed_sides(corners: np.ndarray) -> tuple[int, int] | None:
    """Return the first corners of two sides of a polygon (corners, 2) that touch or cross, None if none do."""
    ahead = np.roll(corners, -1, axis=0)
    along = ahead - corners

    def orientation(points: np.ndarray) -> np.ndarray:
        """Return on which side of each line a point lies, −1, 0 or 1 (sides, points); 0 also within rounding."""
        offset = points[None] - corners[:, None]
        cross = along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]
        return np.where(np.abs(cross) < 1e-15, 0, np.sign(cross))

    def in_box(points: np.ndarray) -> np.ndarray:
        """Return whether a point lies in the bounding box of each side (sides, points)."""
        low, high = np.minimum(corners, ahead)[:, None], np.maximum(corners, ahead)[:, None]
        return ((points[None] >= low - 1e-15) & (points[None] <= high + 1e-15)).all(axis=2)

    start, end = orientation(corners), orientation(ahead)
    start_touches, end_touches = (start == 0) & in_box(corners), (end == 0) & in_box(ahead)
    meet = ((start * end < 0) & (start * end < 0).T) | start_touches | end_touches
    index = np.arange(len(corners))
    following = (index + 1) % len(corners)
    # Neighbours share a corner; they also overlap if the end of one side lies on the other.
    overlap = end_touches[index, following] | start_touches[following, index] | (along == 0).all(axis=1)
    meet[index, index] = meet[index, following] = meet[following, index] = False
    meet[index, following] |= overlap
    pairs = np.argwhere(meet)
    return (int(pairs[0].min()), int(pairs[0].max())) if len(pairs) else None
