"""The tables ``[target]`` and ``[[targets]]``: a region of the plate as a rectangle, disc, polygon or mask."""

import math
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from warp_plate.scene.errors import SceneError, toml_text
from warp_plate.scene.fields import (
    NARROWEST,
    Area,
    Coordinate,
    PartName,
    Point,
    Positive,
    Table,
    Unit,
    check_area,
    check_file_name,
)

SHAPES = ("area", "disc", "polygon", "mask")


class Target(Table):
    """A region of the plate, given by exactly one of its shapes.

    A mask is a CSV file beside the scene file with the fraction 0 ... 1 of the plate that belongs to the target around
    each of its points: rows along y, columns along x, evenly spaced from edge to edge, with bilinear interpolation.
    """

    area: Annotated[Area | None, Field(examples=[[0.08, 0.12, 0.04, 0.08]])] = None
    """Rectangle x0, x1, y0, y1."""
    disc: Annotated[
        tuple[Coordinate, Coordinate, Positive] | None, Unit("m"), Field(examples=[[0.13, 0.06, 0.015]])
    ] = None
    """Centre x, y and radius."""
    polygon: Annotated[
        Annotated[tuple[Point, ...], Field(min_length=3, max_length=1000)] | None,
        Field(examples=[[[0.02, 0.02], [0.08, 0.02], [0.05, 0.07]]]),
    ] = None
    """Corners x, y in order, clockwise or counterclockwise; sides must not cross."""
    mask: Annotated[str | None, Field(examples=["finger.csv"])] = None
    """Name of a CSV file."""

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        given = [name for name in SHAPES if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{given[1]}: {given[0]} is given too; write one of them")
        if not given:
            raise ValueError("area: no shape is given; write one of area, disc, polygon and mask")
        if self.mask is not None:
            check_file_name("mask", self.mask, (".csv",))
        return self

    @property
    def shape(self) -> str:
        """Name of the shape that is given, one of ``SHAPES``."""
        return next(name for name in SHAPES if getattr(self, name) is not None)

    @property
    def description(self) -> str:
        """Key and value of the shape, for messages and tables."""
        value = getattr(self, self.shape)
        if self.shape == "polygon" and len(value) > 6:
            return f"polygon of {len(value)} corners"
        return f"{self.shape} = {toml_text(value)}"

    def rectangle(self) -> Area:
        """Return the rectangle x0, x1, y0, y1 [m], or raise a SceneError if the target has another shape."""
        if self.area is None:
            raise SceneError(f"target.{self.description}: the reference solutions take rectangles only")
        return self.area

    def corners(self, of_disc: int) -> np.ndarray | None:
        """Return the (corners, 2) x, y [m] of the outline, a disc as a polygon of ``of_disc`` corners; None for a mask.

        The polygon of a disc has the disc's area; with n corners its outline deviates by at most (π/n)²/3 radii.
        """
        if self.area is not None:
            x0, x1, y0, y1 = self.area
            return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        if self.disc is not None:
            x, y, radius = self.disc
            angle = 2 * math.pi * (np.arange(of_disc) + 0.5) / of_disc
            outer = radius * math.sqrt(2 * math.pi / of_disc / math.sin(2 * math.pi / of_disc))
            return np.column_stack([x + outer * np.cos(angle), y + outer * np.sin(angle)])
        return None if self.polygon is None else np.array(self.polygon)

    def check(self, key: str, size: tuple[float, float]) -> None:
        """Raise ValueError, naming ``key``, unless the target has an inside and lies on a plate of this size [m]."""
        if self.area is not None:
            check_area(f"{key}.area", self.area, size)
        if self.disc is not None:
            *middle, radius = self.disc
            inside = f"in 0 ... {size[0]:g}, 0 ... {size[1]:g} (metres)"
            for at, side in zip(middle, size, strict=True):
                if at - radius < -1e-9 * min(size) or at + radius > side * (1 + 1e-9):
                    raise ValueError(f"{key}.disc: {list(self.disc)} is off the plate; write x, y, radius {inside}")
            if 2 * radius < NARROWEST * max(size):
                raise ValueError(f"{key}.disc: a radius of {radius:.3g} m; at least {NARROWEST / 2 * max(size):.3g} m")
        if self.polygon is not None:
            _check_polygon(f"{key}.polygon", np.array(self.polygon), size)


class NamedTarget(Target):
    """A target of several. Its name is part of the names of datasets, so it has no slash."""

    name: Annotated[PartName, Field(examples=["left thumb"])]
    """Name without "/", different for each target."""

    @property
    def unnamed(self) -> Target:
        """The target without its name."""
        return Target(area=self.area, disc=self.disc, polygon=self.polygon, mask=self.mask)


def area_within(corners: np.ndarray) -> float:
    """Return the area [m²] of a polygon (corners, 2), negative for clockwise corners."""
    if not len(corners):
        return 0.0
    x, y = (corners - corners.mean(axis=0)).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def _check_polygon(key: str, corners: np.ndarray, size: tuple[float, float]) -> None:
    for index, (x, y) in enumerate(corners.tolist()):
        if not all(-1e-9 * side <= at <= side * (1 + 1e-9) for at, side in zip((x, y), size, strict=True)):
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
