"""Design variables: the numbers that a search chooses, made from the tables of a scene's ``[search]``.

A class for each kind makes its variables, refuses tables that do not fit the scene, and writes numbers to designs.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, ClassVar, Self

import numpy as np

from warp_plate.modal.solver import trace_step
from warp_plate.plate.designs import per_plate_of
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import actuator_delays, actuator_frequencies, plate_harmonic
from warp_plate.quantities.region_quantities import REGION_QUANTITIES
from warp_plate.resolve import at_highest_frequency
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import (
    SWARMS,
    FreeDelay,
    FreeFrequency,
    FreeMagnitude,
    FreePhase,
    FreePosition,
    Limits,
    Search,
)

# The range in which the source paper draws its first positions.
PAPER_RANGE = (-2.0, 2.0)


@dataclass(frozen=True)
class DesignVariable(ABC):
    """A number of a position."""

    is_drive: ClassVar[bool] = False  # True if energies are quadratic forms whatever its value is

    kind: str
    name: str  # for people
    actuators: tuple[int, ...]  # indices of the actuators that have it in common
    fixed: float  # value in the scene
    initial: tuple[float, float]  # range in which a search begins
    lower: float = -math.inf
    upper: float = math.inf
    period: float = math.inf  # of a number that wraps; ∞ for all others

    @classmethod
    def of_group(
        cls, scene: Scene, kind: str, group: tuple[int, ...], fixed: float, initial: tuple[float, float], **ends: float
    ) -> Self:
        """Return a variable named like "phase of upper left", or just "frequency" where all actuators share it."""
        names = ", ".join(scene.actuators[actuator].name for actuator in group)
        name = kind if len(group) == len(scene.actuators) > 1 else f"{kind} of {names}"
        return cls(kind, name, group, float(fixed), initial, **ends)

    @classmethod
    def ranged(
        cls, scene: Scene, kind: str, separate: bool, fixed: Sequence[float] | np.ndarray, ends: tuple[float, float]
    ) -> list[Self]:
        """Return a variable for each actuator that the table names, or one for all, that begins within its limits."""
        named, (low, high) = _named_actuators(scene, kind), ends
        groups = [(actuator,) for actuator in named] if separate else [named]
        return [cls.of_group(scene, kind, group, fixed[group[0]], ends, lower=low, upper=high) for group in groups]

    @classmethod
    @abstractmethod
    def of_table(cls, scene: Scene, table: Any) -> Iterable[Self]:
        """Return the variables of a table; raise SceneError, naming the key, if it does not fit the scene."""

    def apply(self, numbers: np.ndarray, values: Mapping[str, np.ndarray]) -> None:
        """Write numbers (n,) to the values (actuators, n) of n designs, by kind."""
        values[self.kind][list(self.actuators)] = numbers


class Magnitude(DesignVariable):
    """A magnitude, in ``Parametrization.unit``."""

    is_drive = True

    @classmethod
    def of_table(cls, scene: Scene, table: FreeMagnitude) -> list[Self]:
        """Return magnitudes; none where limits make all the same and only ratios count."""
        equal = scene.search.limits.equal_magnitudes
        if equal and len(_named_actuators(scene, "magnitude")) < len(scene.actuators):
            raise SceneError(
                "search.magnitude.actuators: limits.equal_magnitudes gives all the same; delete one of them"
            )
        if equal and only_ratios(scene):
            return []
        ends = table.range or (0.0, magnitude_unit(scene))
        return cls.ranged(scene, "magnitude", not equal, [actuator.magnitude for actuator in scene.actuators], ends)


class Phase(DesignVariable):
    """A phase lag [rad]."""

    is_drive = True

    @classmethod
    def of_table(cls, scene: Scene, table: FreePhase) -> Iterator[Self]:
        """Yield phases: of all that the table names, but for the first where a common one only shifts the motion."""
        named = _named_actuators(scene, "phase")
        if scene.steady and len(named) == len(scene.actuators):
            named = named[1:]
        for actuator in named:
            fixed, period = scene.actuators[actuator].phase, 2 * math.pi
            yield cls.of_group(scene, "phase", (actuator,), fixed, (0.0, period), period=period)

    def apply(self, numbers: np.ndarray, values: Mapping[str, np.ndarray]) -> None:
        """Write phases, wrapped if the search wraps them."""
        super().apply(numbers if math.isinf(self.period) else np.mod(numbers, self.period), values)


class Frequency(DesignVariable):
    """A frequency [Hz]."""

    @classmethod
    def of_table(cls, scene: Scene, table: FreeFrequency) -> list[Self]:
        """Return frequencies, one for all actuators or one for each."""
        for key in ("signal", "chirp"):
            if getattr(scene.drive, key) is not None:
                raise SceneError(f"search.frequency: drive.{key} says which frequencies there are; delete one of them")
        return cls.ranged(scene, "frequency", table.own, actuator_frequencies(scene), table.range)


class Place(DesignVariable):
    """The x or y of an actuator's centre [m]."""

    @classmethod
    def of_table(cls, scene: Scene, table: FreePosition) -> Iterator[Self]:
        """Yield centres of patches that keep the whole patch in the area; along a side without room, a patch stays."""
        if scene.grid.load == "nodes":
            raise SceneError(
                'search.position: grid.load = "nodes" moves an actuator by whole nodes, in jumps; write load = '
                '"overlap" or "moments"'
            )
        width, height = scene.plate.size
        everywhere, areas = table.area or scene.plate.box, table.areas or {}
        moving = _named_actuators(scene, "position")
        names = [scene.actuators[actuator].name for actuator in moving]
        for name in areas.keys() - set(names):
            raise SceneError(f"search.position.areas.{name}: no such actuator moves; those that do: {', '.join(names)}")
        for actuator, name in zip(moving, names, strict=True):
            patch, area = scene.actuators[actuator].box, areas.get(name, everywhere)
            key = f"areas.{name}" if name in areas else "area"
            for axis, side, first in (("x", width, 0), ("y", height, 2)):
                low, high, start, stop = *patch[first : first + 2], *area[first : first + 2]
                centre, half = (low + high) / 2, (high - low) / 2
                lower, upper = start + half, stop - half
                if upper - lower > 1e-9 * side:
                    yield cls.of_group(scene, axis, (actuator,), centre, (lower, upper), lower=lower, upper=upper)
                elif upper - lower < -1e-9 * side or abs(centre - lower) > 1e-9 * side:
                    raise SceneError(
                        f"search.position.{key} = {list(area)}: is {stop - start:.6g} m long along {axis}, actuator "
                        f"{name!r} {2 * half:.6g} m; make room for it, or move it there"
                    )


class Delay(DesignVariable):
    """The start of a burst [s]."""

    @classmethod
    def of_table(cls, scene: Scene, table: FreeDelay) -> list[Self]:
        """Return starts of bursts, one for all actuators or one for each."""
        if scene.drive.burst is None:
            raise SceneError("search.delay: only a burst has a start; write [drive.burst], or delete search.delay")
        if table.range[1] >= scene.window.end:
            raise SceneError(
                f"search.delay.range = {list(table.range)}: reaches past the run, which ends at window.end = "
                f"{scene.window.end:g} s; end it earlier"
            )
        return cls.ranged(scene, "delay", table.own, actuator_delays(scene), table.range)


# The tables that name design variables; without any the search is the source paper's.
TABLES: dict[str, type[DesignVariable]] = {
    "magnitude": Magnitude, "phase": Phase, "frequency": Frequency, "position": Place, "delay": Delay,
}  # fmt: skip


def has_design_tables(scene: Scene) -> bool:
    """Return whether a table names design variables, so that the search is not the source paper's."""
    return any(getattr(scene.search, name) is not None for name in TABLES)


def with_paper_search(scene: Scene) -> Scene:
    """Return the scene with the source paper's search for its localization factor, by the scene's own swarm."""
    default = Search()
    paper = {name: getattr(default, name) for name in (*TABLES, "objectives", "limits", "robust")}
    return scene.with_keys("search", **paper)


def only_ratios(scene: Scene) -> bool:
    """Return whether a factor that all actuators have in common changes no objective, and keeps all levels."""
    ratios = all(REGION_QUANTITIES[objective.kind].is_ratio for objective in scene.search.objectives)
    return scene.linear and ratios and not scene.limited_levels


def has_slopes(scene: Scene) -> bool:
    """Return whether the slopes of all losses are known: those of sounds and coils by the frequency are not."""
    return scene.search.frequency is None or scene.search.tone_key is None


def magnitude_unit(scene: Scene) -> float:
    """Return the drive for a magnitude of one: the largest of the scene's actuators, or 1 if all are 0; SceneError:
    their units differ."""
    if len(set(scene.magnitude_units)) > 1:
        rule = "search, compare or explore drives in one unit; simulate, frf, sound and specify take several"
        raise SceneError(f"actuators: magnitudes in {scene.drive_unit} have no common scale; {rule}")
    return max(abs(actuator.magnitude) for actuator in scene.actuators) or 1.0


def single_drives(scene: Scene) -> np.ndarray:
    """Return the (actuators, actuators) phasors of drives of magnitude one of a single actuator each."""
    return magnitude_unit(scene) * np.eye(len(scene.actuators), dtype=complex)


def fixed_magnitudes(scene: Scene) -> np.ndarray:
    """Return the (actuators,) magnitudes that a search with tables does not vary: those of the scene, or one within the
    range of ``[search.magnitude]`` where limits make all equal and only ratios count."""
    table, magnitudes = scene.search.magnitude, np.array([actuator.magnitude for actuator in scene.actuators])
    if table is None or not (scene.search.limits.equal_magnitudes and only_ratios(scene)):
        return magnitudes
    largest = magnitude_unit(scene)
    return np.full_like(magnitudes, np.clip(largest, *(table.range or (0.0, largest))))


def make_design_variables(scene: Scene) -> tuple[DesignVariable, ...]:
    """Return the design variables, none only where the paper's reading meets a single actuator; SceneError: no variable
    changes the motion, or a table does not fit the scene."""
    if not has_design_tables(scene):
        return tuple(_paper_variables(scene))
    _check_fixed_magnitudes(scene)
    tables = {kind: getattr(scene.search, name) for name, kind in TABLES.items()}
    of_tables = (kind.of_table(scene, table) for kind, table in tables.items() if table is not None)
    variables = tuple(chain.from_iterable(of_tables))
    if not variables:
        names = ", ".join(f"[search.{name}]" for name in TABLES)
        raise SceneError(f"search: no variable changes the motion; name more actuators, or write one of {names}")
    return variables


def with_common_step(scene: Scene, stepped: bool = True) -> Scene:
    """Return the scene with one time step for all the frequencies and delays that its search may choose; SceneError:
    its own does not carry them."""
    table, step = scene.search.frequency, scene.grid.time_step
    if step is None and (table is not None or scene.search.delay is not None):
        highest = at_highest_frequency(scene)
        # Plates whose actuators differ in these are stepped in moment form, which has another stability limit.
        forms = {False, per_plate_of(scene).per_actuator}
        steps = (
            make_scheme(highest, moment_form=form).time_step if stepped else trace_step(highest, form) for form in forms
        )
        step = min(steps)
        return scene.with_tables(grid={**scene.grid.model_dump(), "time_step": step})
    if step is not None and table is not None:
        carried = 0.5 / step / plate_harmonic(scene.drive)
        if table.range[1] >= carried:
            raise SceneError(
                f"search.frequency.range = {list(table.range)}: a step of {step:g} s carries less than {carried:.6g} "
                "Hz; end the range lower, or write a smaller grid.time_step"
            )
    return scene


def _paper_variables(scene: Scene) -> Iterator[DesignVariable]:
    """Yield the variables of section II.C of the source paper; see :mod:`parametrization`."""
    search = scene.search
    bounded = search.limits.magnitude or search.limits.power or scene.limited_levels
    for index, objective in enumerate(search.objectives):
        if not REGION_QUANTITIES[objective.kind].is_ratio and objective.rest_limit is None and not bounded:
            raise SceneError(
                f"search.objectives[{index}].kind = {objective.kind!r}: grows with the magnitudes without end; write "
                "[search.magnitude], search.limits, or a rest_limit"
            )
    everyone, others = range(len(scene.actuators)), range(1, len(scene.actuators))
    # A limit, or a quantity that grows with the drive, determines its level, which is then searched too.
    leveled = not only_ratios(scene) and (bounded or any(objective.rest_limit for objective in search.objectives))
    groups: list[tuple[int, ...]] = [(actuator,) for actuator in (everyone if leveled else others)]
    if search.limits.equal_magnitudes:
        groups = [tuple(everyone)] if leveled else []
    yield from (Magnitude.of_group(scene, "magnitude", group, 1.0, PAPER_RANGE) for group in groups)
    phases = others if _holds_first_phase(scene) else everyone
    yield from (Phase.of_group(scene, "phase", (actuator,), 0.0, PAPER_RANGE) for actuator in phases)


def _holds_first_phase(scene: Scene) -> bool:
    """Return whether the source paper's search holds the first phase at 0.

    A common phase only shifts a steady motion in time. While start-up motion is left in the window it counts; swarms
    search ratios without limits as in the paper even so.
    """
    search = scene.search
    ratios = all(REGION_QUANTITIES[objective.kind].is_ratio for objective in search.objectives)
    return scene.steady or (search.method in (None, *SWARMS) and ratios and search.limits == Limits())


def _named_actuators(scene: Scene, table: str) -> tuple[int, ...]:
    """Return the indices of the actuators that a table names; all where it names none."""
    existing = [actuator.name for actuator in scene.actuators]
    names = getattr(scene.search, table).actuators or existing
    for index, name in enumerate(names):
        key = f"search.{table}.actuators[{index}] = {name!r}"
        if name not in existing:
            raise SceneError(f"{key}: there is no such actuator; there are: {', '.join(existing)}")
        if name in names[:index]:
            raise SceneError(f"{key}: is there twice; delete one")
    return tuple(sorted(existing.index(name) for name in names))


def _check_fixed_magnitudes(scene: Scene) -> None:
    """Raise SceneError where fixed magnitudes should be equal, or are all zero, so that nothing moves."""
    if scene.search.magnitude is not None:
        return
    sizes = {abs(actuator.magnitude) for actuator in scene.actuators}
    if scene.search.limits.equal_magnitudes and len(sizes) > 1:
        raise SceneError(
            f"search.limits.equal_magnitudes: the actuators' magnitudes, from {min(sizes):g} to {max(sizes):g}, differ "
            "and are fixed; write the same for all, or search them: [search.magnitude]"
        )
    bias = scene.drive.electrostatic is not None and scene.drive.electrostatic.bias
    if not any(sizes) and not bias and scene.effects.travelling is None:
        raise SceneError(
            "search: the actuators' magnitudes are all 0 and fixed, so that nothing moves; write others, or search "
            "them: [search.magnitude]"
        )
