"""Hard cases, and the scenes from which they start."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate.scheme import make_scheme

SIDES = ("left", "bottom", "right", "top")
PANEL = {"thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1000.0}
# As shares of the sides, x0, x1, y0, y1; alike in nothing.
PATCHES = ((0.15, 0.3, 0.2, 0.35), (0.6, 0.85, 0.15, 0.4))


@dataclass(frozen=True)
class Where:
    """Device, path and precision of a case; ``long``: with all steps of the catalogue, otherwise fewer."""

    device: str = "cpu"
    path: str = "auto"
    precision: str = "float64"
    long: bool = False

    def solver(self, scene: Scene, allow_unstable: bool = False) -> PlateSolver:
        """Return the solver of a scene in this precision, by the other path if it cannot take this one."""
        scene = scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": self.precision})})
        try:
            return PlateSolver(scene, self.device, self.path, allow_unstable=allow_unstable)
        except SceneError as error:
            if "do not fit on one multiprocessor" not in str(error) and "no such path" not in str(error):
                raise
            return PlateSolver(scene, self.device, allow_unstable=allow_unstable)

    def steps(self, asked: int, fewer: int) -> int:
        """Return the number of steps, or fewer in the short form."""
        return asked if self.long else fewer


@dataclass(frozen=True)
class Measured:
    """value: what is held against what is allowed; slowdown: longest time of its runs over that of the usual one, where
    times are compared."""

    value: float
    slowdown: float | None = None


@dataclass(frozen=True)
class Case:
    """name; asked: in words; quantity: what ``value`` is; allowed: the largest ``value`` by precision; slow: whether
    even the short form takes long."""

    name: str
    asked: str
    quantity: str
    measure: Callable[[Where], Measured]
    allowed: Mapping[str, float]
    slow: bool = False
    group: str = field(default="")


def both(float32: float, float64: float) -> dict[str, float]:
    """Allowed value in each precision."""
    return {"float32": float32, "float64": float64}


def scene_of(
    nodes: tuple[int, int] = (13, 13),
    size: tuple[float, float] = (0.2, 0.2),
    edges: tuple[object, ...] = ("supported",) * 4,
    effects: Mapping[str, object] | None = None,
    areas: tuple[tuple[float, ...], ...] | None = None,
    plate: Mapping[str, float] | None = None,
    **tables: object,
) -> Scene:
    """A panel; areas of actuators in metres, left out: PATCHES; tables: of the scene file."""
    areas = areas or tuple(tuple(np.multiply(patch, np.repeat(size, 2))) for patch in PATCHES)
    return Scene.model_validate(
        {
            "plate": {"size": size, **PANEL, **(plate or {})},
            "edges": dict(zip(SIDES, edges, strict=True)),
            "window": {"start": 0.0, "end": 0.01},
            "drive": {"frequency": 100.0},
            "target": {"area": (0.0, size[0] / 2, 0.0, size[1] / 2)},
            "effects": dict(effects or {}),
            "actuators": [{"name": str(index), "area": area} for index, area in enumerate(areas)],
            **tables,
            "grid": {"nodes": nodes, **dict(tables.get("grid", {}))},  # type: ignore[call-overload]
        }
    )


def stepped(scene: Scene, part: float, steps: int, frequency: float | None = None, window: float = 0.0) -> Scene:
    """The scene with so many steps, each a part of the limit; the window from a part of the run on.

    frequency [Hz] of the drive; left out: a 41st of the steps' rate, which lies among the modes of a small grid.
    """
    limit = make_scheme(with_end(scene, 1e-6)).limit
    step = part * limit
    grid = {**scene.grid.model_dump(exclude={"accuracy"}), "time_step": step}
    end = steps * step
    return scene.with_tables(
        grid=grid, drive={**scene.drive.model_dump(exclude_none=True), "frequency": frequency or 1 / (41 * step)},
        window={"start": window * end, "end": end},
    )  # fmt: skip


def with_end(scene: Scene, end: float) -> Scene:
    """The scene with a short run of its own default step, whatever step it has."""
    grid = scene.grid.model_dump(exclude={"accuracy", "time_step"})
    tables = {"grid": grid, "window": {"start": 0.0, "end": end}, "drive": {"frequency": 1e-3 / end}}
    return scene.with_tables(**tables)


def largest_difference(found: np.ndarray, exact: np.ndarray) -> float:
    """Relative to the largest exact number; infinite where something is no number."""
    difference = float(np.abs(found - exact).max() / np.abs(exact).max())
    return difference if math.isfinite(difference) else math.inf


def grouped(group: str, cases: list[Case]) -> list[Case]:
    """The cases, in this group of the table."""
    return [replace(case, group=group) for case in cases]
