"""The number of resonators or ribs of a design: which of the candidates of a scene stay.

Candidates are the tables of a list whose mass, or of layers thickness, is free. The search first has them all; then
those without which the panel does best are left out, a few at a time until the count is kept, and the search goes on
with the others alone. This is a heuristic: others may be better, and the value with all of them is no bound.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from warp_plate.designing.panel import FreePanel
from warp_plate.effects.effect import attachments
from warp_plate.modal.solver import ModalSolver
from warp_plate.result.designed import PanelValues
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Grid
from warp_plate.scene.keys import linked_keys, resolved_key
from warp_plate.scene.model import Scene

# Grid of scenes that have none.
NODES = (21, 21)
# What is 0 of a candidate that is left out, the first that it has; and the part of those in excess that are left out at
# a time.
MEASURES, PART = ("thickness", "mass"), 4
# Tables that name other tables by keys.
NAMING = ("design", "effects", "fit", "links", "search", "specification")


class Candidates:
    """The candidates of a panel's table ``[design.count]``; SceneError: there are none."""

    def __init__(self, panel: FreePanel) -> None:
        self.panel, self.most = panel, panel.design.count
        places = {key: index for index, key in enumerate(panel.keys)}
        self._places: dict[str, dict[str, int]] = {}
        if self.most and panel.design.limits.modes:
            raise SceneError(
                "design.count: not with design.limits.modes, whose modes are those of all tables; delete one"
            )
        regions = panel.scene.effects.regions
        for name in self.most:
            tables = [key for key in regions if key.startswith(f"{name}[")]
            measure = next((key for key in MEASURES if tables and hasattr(regions[tables[0]], key)), "mass")
            named = {key: places[f"{key}.{measure}"] for key in tables if f"{key}.{measure}" in places}
            if not named:
                raise SceneError(f"design.count: {name}: no mass or thickness there is free; write some in design.free")
            self._places[name] = named

    def left_out(self, numbers: np.ndarray, value: Callable[[np.ndarray], float]) -> list[str]:
        """Return the keys of the candidates that do not stay, by the value of free numbers (count,)."""
        numbers, first, gone = numbers.copy(), self.panel.count - len(self.panel.keys), list[str]()
        for name, most in self.most.items():
            there = dict(self._places[name])

            def alone(key: str, there: dict[str, int] = there) -> float:
                changed = numbers.copy()
                changed[first + there[key]] = 0
                return value(changed)

            while len(there) > most:
                ordered = sorted(there, key=alone, reverse=True)
                for key in ordered[: max(1, (len(there) - most) // PART)]:
                    numbers[first + there.pop(key)] = 0
                    gone.append(key)
        return sorted(gone, key=list(self.panel.scene.movable).index)

    def allow(self, left_out: object) -> bool:
        """Return whether the keys are some of candidates, of which as many are left out as the counts ask for."""
        names = set(left_out) if isinstance(left_out, list) and all(isinstance(key, str) for key in left_out) else {""}
        others = names.difference(*self._places.values())
        numbers = (len(self._places[name].keys() - names) for name in self.most)
        return not others and all(number <= most for number, most in zip(numbers, self.most.values(), strict=True))

    def kept(self, numbers: np.ndarray, left_out: Sequence[str]) -> np.ndarray:
        """Return the free numbers of the panel without some candidates."""
        first = self.panel.count - len(self.panel.keys)
        stays = [not key.startswith(tuple(f"{one}." for one in left_out)) for key in self.panel.keys]
        return np.concatenate([numbers[:first], numbers[first:][stays]])

    def counted(self, values: PanelValues, left_out: Sequence[str]) -> PanelValues:
        """Return the values of a panel with the parts by which it passes the counts."""
        passed = {}
        for name, most in self.most.items():
            number = len(self._places[name].keys() - set(left_out))
            passed[f"count of {name}"] = number / most - 1
        return replace(values, excess={**values.excess, **passed})


def without(scene: Scene, left_out: Sequence[str]) -> Scene:
    """Return a scene without some tables of effects, and without ``[design.count]``; other tables are numbered anew.

    Raises:
        SceneError: The rest of the scene names one of them.
    """
    tables: Any = scene.model_dump(mode="json", include={name for name in NAMING if name in type(scene).model_fields})
    design, gone = tables["design"] or {}, tuple(left_out)
    if design:
        design["count"] = {}
    for name in ("free", "places", "tolerance") if design else ():
        design[name] = {
            key: value
            for key, value in design[name].items()
            if key not in gone and not key.startswith(tuple(f"{one}." for one in gone))
        }
    lists, numbers = sorted({key.partition("[")[0] for key in left_out}), {}
    for name in lists:
        rows, short = tables["effects"][name.removeprefix("effects.")], list[Any]()
        for index, row in enumerate(rows):
            if f"{name}[{index}]" not in left_out:
                numbers[f"{name}[{index}]"] = f"{name}[{len(short)}]"
                short.append(row)
        tables["effects"][name.removeprefix("effects.")] = short
    pattern = re.compile(rf"^({'|'.join(map(re.escape, lists))})\[\d+\]")

    def renamed(value: Any) -> Any:
        if isinstance(value, str):
            if (match := pattern.match(value)) is None:
                return value
            if match[0] not in numbers:
                raise SceneError(f"design.count: {value} is named elsewhere in the scene; delete that")
            return numbers[match[0]] + value[match.end() :]
        if isinstance(value, dict):
            return {renamed(key): renamed(inner) for key, inner in value.items()}
        return [renamed(inner) for inner in value] if isinstance(value, list) else value

    return scene.with_tables(**renamed(tables))


def ceiling(scene: Scene) -> float | None:
    """Return a bound on the localization factor of all panels of ``[design]``; None where none is known.

    In a steady state whatever is attached to a patch acts on the plate by a force there. No panel of which attachments
    at fixed places are all that is free does better than the plate without them, driven at their places too.
    """
    design = scene.design
    assert design is not None
    tables = set(scene.effects.attachment_keys(scene.plate))
    inner = [key for name in design.free for key in linked_keys(scene, resolved_key(scene, name))]
    rows = {key.rpartition(".")[0] for key in inner}
    kinds = {actuator.kind for actuator in scene.actuators}
    attached = rows <= tables and not design.places and design.thickness is None and scene.effects.air is None
    if not (scene.steady and attached and kinds == {"pressure"} and design.objective in ("bound", "drive")):
        return None
    freed = (attachments(row.terms(scene.plate)) for key, row in scene.effects.rows if key in rows)
    patches = [attachment.region for attached in freed for attachment in attached]
    actuators = [scene.actuators[0].model_copy(update=dict(patch)) for patch in patches]
    bare = without(scene.model_copy(update={"design": None}), sorted(rows))
    bare = bare.model_copy(update={"actuators": (*scene.actuators, *actuators)})
    cases = [bare.aimed_at(index) for index in range(len(scene.targets))] or [bare]
    tones = design.frequencies or (scene.drive.frequency,)
    drives = [
        case.model_copy(update={"drive": case.drive.model_copy(update={"frequency": tone})})
        for case in cases
        for tone in tones
    ]
    return min(ModalSolver(gridded(one), "cpu").response.bound() for one in drives)


def gridded(scene: Scene) -> Scene:
    """Return a scene with some grid, which modes do not need."""
    if scene.grid.accuracy is None:
        return scene
    return scene.model_copy(update={"grid": Grid(nodes=NODES, modal_density=scene.grid.modal_density)})
