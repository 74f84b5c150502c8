"""The scene of responses that were measured: a file, what was measured, and the drives that are wanted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, Tag, ValidationError, model_validator

from warp_plate.scene.errors import SceneError, check_type
from warp_plate.scene.explain_errors import explain_error
from warp_plate.scene.fields import (
    IS_LIST,
    Area,
    Flag,
    Name,
    NotNegative,
    OneOrRange,
    Positive,
    Table,
    Text,
    Unit,
    check_file_name,
)
from warp_plate.scene.focus import Focus
from warp_plate.scene.keys import assign
from warp_plate.scene.load import parse_toml, read_scene_text
from warp_plate.scene.specification import DriveLimits, Specification
from warp_plate.scene.target import NamedTarget, Target

FILES = (".h5", ".hdf5", ".nc", ".mat", ".uff", ".unv", ".ufb")


class Measured(Table):
    """Responses of the points of a scan to each of the actuators, and the limits of these."""

    file: Annotated[str, Field(examples=["scan.h5"])]
    """Name of an HDF5, MAT or universal file beside the scene file."""
    quantity: Annotated[Literal["receptance", "mobility", "accelerance"], Field(examples=["accelerance"])] = "mobility"
    """Displacement, velocity or acceleration per unit of an actuator's drive."""
    frequency: Annotated[OneOrRange | None, Unit("Hz"), Field(examples=[[200.0, 400.0]])] = None
    """Frequency, or a range of which the best is chosen (default: all frequencies of the file)."""
    panel: Annotated[Area | None, Field(examples=[[0.0, 0.4, 0.0, 0.3]])] = None
    """Rectangle x0, x1, y0, y1 of the panel (default: the convex hull of the points)."""
    averages: Annotated[int | None, Field(ge=2, le=10**9, examples=[16])] = None
    """Number of averages of the coherences in the file, from which the variances of the responses follow."""
    noise: Annotated[NotNegative | None, Unit("1"), Field(examples=[0.01])] = None
    """Standard deviation of the responses over the root mean square of their actuator, without coherences."""
    fitted: Annotated[str | None, Field(examples=["panel.fitted.toml"])] = None
    """Name of a scene file beside this one, of the panel with the same actuators in order: responses are taken between
    the measured ones and its own, by their errors (default: the measured ones)."""
    largest: Annotated[
        Annotated[Positive, Tag("one")] | Annotated[tuple[Positive, ...], Tag("several")],
        IS_LIST,
        Unit("drive"),
        Field(examples=[10.0]),
    ] = 1.0
    """Largest drive of all actuators, or of each of them, in the unit of the responses."""
    unit: Annotated[Name, Field(examples=["V"])] = "V"
    """Unit of the drives."""
    equal_magnitudes: Annotated[Flag, Field(examples=[True])] = False
    """True if all actuators have the largest drive that all may have, and only phases are chosen."""

    @model_validator(mode="after")
    def _checked(self) -> Self:
        check_file_name("file", self.file, FILES)
        if self.fitted is not None:
            check_file_name("fitted", self.fitted, (".toml",))
        if isinstance(self.frequency, tuple) and not self.frequency[0] < self.frequency[1]:
            raise ValueError(f"frequency: {list(self.frequency)}: write the lower frequency first")
        if self.panel is not None and not (self.panel[0] < self.panel[1] and self.panel[2] < self.panel[3]):
            raise ValueError(f"panel: {list(self.panel)} has no inside; write x0, x1, y0, y1 with x0 < x1 and y0 < y1")
        if self.averages is not None and self.noise is not None:
            raise ValueError("noise: variances follow from the coherences and averages; delete one of them")
        return self


class TradeOff(Table):
    """The motion of the target that drives follow while the rest stays quiet, more or less of each."""

    like: Annotated[Name | None, Field(examples=["actuator 1"])] = None
    """Actuator whose motion of the target is wanted (default: equal motion in phase at all of its points)."""
    weight: Annotated[Positive, Unit("1"), Field(examples=[0.1])] = 1.0
    """Weight µ of the rest against the misfit in the variable span trade-off."""


class MeasuredScene(Table):
    """Responses that were measured, and what drives made of them are to do."""

    title: Annotated[Text, Field(examples=["Panel on the bench"])] = ""
    """Title of outputs."""
    measured: Measured
    target: Target | None = None
    """Region that is to move; instead of ``targets``."""
    targets: Annotated[tuple[NamedTarget, ...], Field(max_length=64)] = ()
    """Named regions; the first is the target of all but the specification."""
    trade_off: TradeOff = TradeOff()
    specification: Specification | None = None
    focus: Focus | None = None

    _folder: Path | None = PrivateAttr(default=None)

    @staticmethod
    def load(source: MeasuredScene | str | Path, assignments: Sequence[str] = ()) -> MeasuredScene:
        """Return the scene of a TOML file with ``KEY=VALUE`` assignments, or raise a SceneError; see ``Scene.load``."""
        if isinstance(source, MeasuredScene):
            return source
        check_type("scene", source, MeasuredScene, str, Path)
        text, folder = read_scene_text(source)
        tables = parse_toml(text, str(source))
        assign(tables, assignments)
        if "measured" not in tables:
            raise SceneError(f'{source}: measured: is missing; write [measured] with file = "scan.h5"')
        try:
            scene = MeasuredScene.model_validate(tables)
        except ValidationError as error:
            raise SceneError(f"{source}: {explain_error(error, MeasuredScene)}") from None
        return scene.in_folder(folder)

    def in_folder(self, folder: Path | None) -> MeasuredScene:
        """Return the scene with the folder of its files."""
        scene = self.model_copy()
        scene._folder = folder
        return scene

    @property
    def folder(self) -> Path | None:
        """Folder of the files that the scene names."""
        return self._folder

    @property
    def regions(self) -> dict[str, Target]:
        """Targets by their names, the first of them that of all but the specification."""
        return {"target": self.target} if self.target else {row.name: row.unnamed for row in self.targets}

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        if (self.target is None) == (not self.targets):
            raise ValueError("target: write one of [target] and [[targets]]")
        for name, region in self.regions.items():
            if region.mask is not None:
                raise ValueError(f"target.mask: {name} takes a shape, such as area or polygon, on measured points")
        if len(self.regions) < len(self.targets):
            raise ValueError("targets: two have the same name; give each its own")
        if self.specification is not None:
            self._check_specification(self.specification)
        if self.focus is not None and self.focus.rest is not None:
            raise ValueError("focus.rest: needs the modes of a plate; delete it")
        return self

    def _check_specification(self, specification: Specification) -> None:
        for index, level in enumerate(specification.levels):
            if level.target is not None and level.target not in self.regions:
                there = ", ".join(self.regions)
                raise ValueError(f"specification.level[{index}].target: {level.target!r}: the targets are {there}")
        excluded = {"limits": specification.limits != DriveLimits(), "tolerance": bool(specification.tolerance)}
        for key, given in (excluded | {"band": specification.band}).items():
            if given:
                raise ValueError(f"specification.{key}: is not of measured responses; delete it, see measured.largest")
