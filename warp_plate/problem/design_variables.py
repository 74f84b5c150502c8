"""The design variables that a scene's ``[search]`` names, their limits, and whether they fit the scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from warp_plate.plate.designs import per_plate_of
from warp_plate.plate.scheme import MOST_STEPS, STEPS_A_PERIOD, make_scheme
from warp_plate.plate.signals import actuator_delays, actuator_frequencies
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Search

# The tables that name design variables; without any the search is the source paper's.
TABLES = ("magnitude", "phase", "frequency", "position", "delay")
# Objectives that a common factor of the drive does not change, where displacements are linear in it.
RATIOS = ("localization", "contrast", "uniformity")
# The range in which the source paper draws its first positions.
PAPER_RANGE = (-2.0, 2.0)
TWO_PI = 2 * math.pi

Kind = Literal["magnitude", "phase", "frequency", "x", "y", "delay"]


@dataclass(frozen=True)
class DesignVariable:
    """A number of a position.

    Attributes:
        name: name for people.
        kind: quantity.
        actuators: indices of the actuators that have it in common.
        fixed: the scene's own value.
        initial: range in which a search begins.
        lower: lower limit.
        upper: upper limit.
        period: period of a number that wraps; ∞ for all others.
    """

    name: str
    kind: Kind
    actuators: tuple[int, ...]
    fixed: float
    initial: tuple[float, float]
    lower: float = -math.inf
    upper: float = math.inf
    period: float = math.inf


def has_design_tables(scene: Scene) -> bool:
    """Return whether a table names design variables, so that the search is not the source paper's."""
    return any(getattr(scene.search, name) is not None for name in TABLES)


def with_paper_search(scene: Scene) -> Scene:
    """Return the scene with the source paper's search for its localization factor, by the scene's own swarm."""
    default = Search()
    paper = {name: getattr(default, name) for name in (*TABLES, "objectives", "limits", "robust")}
    return scene.model_copy(update={"search": scene.search.model_copy(update=paper)})


def only_ratios(scene: Scene) -> bool:
    """Return whether a factor that all actuators have in common changes no objective."""
    return scene.linear and all(objective.kind in RATIOS for objective in scene.search.objectives)


def make_design_variables(scene: Scene) -> tuple[DesignVariable, ...]:
    """Return the design variables; none only where the paper's reading meets a single actuator.

    Raises:
        SceneError: no variable changes the motion, or a table does not fit the scene; names the key.
    """
    if not has_design_tables(scene):
        return _paper_variables(scene)
    _check_equal_magnitudes(scene)
    _check_some_drive(scene)
    variables = (*_magnitudes(scene), *_phases(scene), *_frequencies(scene), *_positions(scene), *_delays(scene))
    if not variables:
        raise SceneError(
            "search: no variable changes the motion; name more actuators, or write one of "
            f"{', '.join(f'[search.{name}]' for name in TABLES)}"
        )
    return variables


def with_common_step(scene: Scene) -> Scene:
    """Return the scene with one time step for all the frequencies and delays that its search may choose.

    Raises:
        SceneError: the scene's own time step does not carry the range; see ``at_highest_frequency``, ``make_scheme``.
    """
    table, step = scene.search.frequency, scene.grid.time_step
    if step is None and (table is not None or scene.search.delay is not None):
        highest = at_highest_frequency(scene)
        # Plates whose actuators differ in these are stepped in moment form, which has a limit of its own.
        forms = {False, per_plate_of(scene).per_actuator}
        step = min(make_scheme(highest, moment_form=moment_form).time_step for moment_form in forms)
        return scene.with_tables(grid={**scene.grid.model_dump(), "time_step": step})
    if step is not None and table is not None:
        carried = 0.5 / step / _harmonic(scene)
        if table.range[1] >= carried:
            raise SceneError(
                f"search.frequency.range = {list(table.range)}: a step of {step:g} s carries less than {carried:.6g} "
                "Hz; end the range lower, or write a smaller grid.time_step"
            )
    return scene


def at_highest_frequency(scene: Scene) -> Scene:
    """Return the scene with searched frequencies at the upper end of their range, which needs the finest grid.

    Raises:
        SceneError: a step chosen for it is too short for a run of at most MOST_STEPS.
    """
    table = scene.search.frequency
    if table is None or scene.drive.signal is not None:  # ``make_design_variables`` refuses both together
        return scene
    most = MOST_STEPS / STEPS_A_PERIOD / scene.window.end / _harmonic(scene)
    if scene.grid.time_step is None and table.range[1] > most:
        raise SceneError(
            f"search.frequency.range = {list(table.range)}: {table.range[1]:g} Hz takes "
            f"{MOST_STEPS * table.range[1] / most:.3g} steps until window.end = {scene.window.end:g} s, and at most "
            f"{MOST_STEPS:.3g} are possible; end the range at {most:.4g} Hz or lower"
        )
    named = set(_named_actuators(scene, "frequency"))
    actuators = [
        actuator.model_dump() | ({"frequency": table.range[1]} if index in named else {})
        for index, actuator in enumerate(scene.actuators)
    ]
    return scene.with_tables(actuators=actuators)


def _harmonic(scene: Scene) -> int:
    """Return the plate's highest frequency as a multiple of the voltage's: its square has twice the frequency."""
    return 1 if scene.drive.electrostatic is None else 2


def _paper_variables(scene: Scene) -> tuple[DesignVariable, ...]:
    """Return the variables of section II.C of the source paper; see :mod:`parametrization`."""
    search, others = scene.search, range(1, len(scene.actuators))
    bounded = search.limits.magnitude or search.limits.power
    for index, objective in enumerate(search.objectives):
        if objective.kind not in RATIOS and objective.rest_limit is None and not bounded:
            raise SceneError(
                f"search.objectives[{index}].kind = {objective.kind!r}: grows with the magnitudes without end; write "
                "[search.magnitude] with a range, search.limits, or a rest_limit"
            )
    kinds: dict[Kind, float] = {"magnitude": 1.0, "phase": 0.0}
    if search.limits.equal_magnitudes:
        del kinds["magnitude"]
    return tuple(
        DesignVariable(_title(scene, kind, (actuator,)), kind, (actuator,), fixed, PAPER_RANGE)
        for kind, fixed in kinds.items()
        for actuator in others
    )


def _ranged(
    scene: Scene, kind: Kind, group: tuple[int, ...], fixed: float, ends: tuple[float, float]
) -> DesignVariable:
    """Return a variable that begins anywhere within its limits."""
    return DesignVariable(_title(scene, kind, group), kind, group, float(fixed), ends, *ends)


def _groups(scene: Scene, table: str, separate: bool) -> list[tuple[int, ...]]:
    """Return the groups of actuators that share a variable: each of the named ones alone, or all together."""
    named = _named_actuators(scene, table)
    return [(actuator,) for actuator in named] if separate else [named]


def _magnitudes(scene: Scene) -> Iterator[DesignVariable]:
    table, equal = scene.search.magnitude, scene.search.limits.equal_magnitudes
    if table is None:
        return
    if equal and len(_named_actuators(scene, "magnitude")) < len(scene.actuators):
        raise SceneError(
            "search.magnitude.actuators: limits.equal_magnitudes gives all actuators the same; delete one of them"
        )
    if equal and only_ratios(scene):  # one magnitude of all changes nothing
        return
    for group in _groups(scene, "magnitude", not equal):
        yield _ranged(scene, "magnitude", group, scene.actuators[group[0]].magnitude, table.range)


def _phases(scene: Scene) -> Iterator[DesignVariable]:
    """Yield phases. A common phase shifts a steady motion in time, and changes nothing: then the first one is fixed.

    It is searched where the motion has a time of its own: a burst, a sweep, a file, a moving load.
    """
    if scene.search.phase is None:
        return
    named, drive = _named_actuators(scene, "phase"), scene.drive
    transient = drive.burst or drive.chirp or drive.signal or scene.effects.moving_load
    if len(named) == len(scene.actuators) and not transient:
        named = named[1:]
    for actuator in named:
        name, fixed = _title(scene, "phase", (actuator,)), scene.actuators[actuator].phase
        yield DesignVariable(name, "phase", (actuator,), fixed, (0.0, TWO_PI), period=TWO_PI)


def _frequencies(scene: Scene) -> Iterator[DesignVariable]:
    table = scene.search.frequency
    if table is None:
        return
    for key in ("signal", "chirp"):
        if getattr(scene.drive, key) is not None:
            raise SceneError(f"search.frequency: drive.{key} says which frequencies there are; delete one of them")
    for group in _groups(scene, "frequency", table.own):
        yield _ranged(scene, "frequency", group, actuator_frequencies(scene)[group[0]], table.range)


def _positions(scene: Scene) -> Iterator[DesignVariable]:
    """Yield centres of patches that keep the whole patch in the area; along a side without room, a patch stays."""
    table = scene.search.position
    if table is None:
        return
    if scene.grid.load == "nodes":
        raise SceneError(
            'search.position: grid.load = "nodes" moves an actuator by whole nodes, in jumps; write load = "overlap" '
            'or "moments"'
        )
    width, height = scene.plate.size
    area = table.area or (0.0, width, 0.0, height)
    axes: tuple[tuple[Literal["x", "y"], float, int], ...] = (("x", width, 0), ("y", height, 2))
    for actuator in _named_actuators(scene, "position"):
        patch, name = scene.actuators[actuator].area, scene.actuators[actuator].name
        for axis, side, first in axes:
            low, high, start, stop = patch[first], patch[first + 1], area[first], area[first + 1]
            half = (high - low) / 2
            if stop - start < 2 * half - 1e-9 * side:
                raise SceneError(
                    f"search.position.area = {list(area)}: is {stop - start:.6g} m long along {axis}, actuator "
                    f"{name!r} {2 * half:.6g} m; make room for all of it"
                )
            lower, upper = start + half, stop - half
            if upper - lower > 1e-9 * side:
                yield _ranged(scene, axis, (actuator,), (low + high) / 2, (lower, upper))
            elif abs((low + high) / 2 - lower) > 1e-9 * side:
                raise SceneError(
                    f"search.position.area = {list(area)}: is no longer along {axis} than actuator {name!r}, which "
                    "lies elsewhere; move it there, or enlarge the area"
                )


def _delays(scene: Scene) -> Iterator[DesignVariable]:
    table = scene.search.delay
    if table is None:
        return
    if scene.drive.burst is None:
        raise SceneError("search.delay: only a burst has a start; write [drive.burst], or delete search.delay")
    if table.range[1] >= scene.window.end:
        raise SceneError(
            f"search.delay.range = {list(table.range)}: reaches past the run, which ends at window.end = "
            f"{scene.window.end:g} s; end it earlier"
        )
    for group in _groups(scene, "delay", table.own):
        yield _ranged(scene, "delay", group, actuator_delays(scene)[group[0]], table.range)


def _named_actuators(scene: Scene, table: str) -> tuple[int, ...]:
    """Return the indices of the actuators that a table names; all where it names none.

    Raises:
        SceneError: a name that no actuator has, or that is there twice.
    """
    existing = [actuator.name for actuator in scene.actuators]
    names = getattr(scene.search, table).actuators
    if names is None:
        return tuple(range(len(existing)))
    for index, name in enumerate(names):
        if name not in existing:
            raise SceneError(
                f"search.{table}.actuators[{index}] = {name!r}: there is no such actuator; there are: "
                f"{', '.join(existing)}"
            )
        if name in names[:index]:
            raise SceneError(f"search.{table}.actuators[{index}] = {name!r}: is there twice; delete one")
    return tuple(sorted(existing.index(name) for name in names))


def _title(scene: Scene, kind: Kind, group: tuple[int, ...]) -> str:
    """Return a name such as "phase of upper left", or just "frequency" where all actuators share it."""
    if len(group) == len(scene.actuators) > 1:
        return kind
    return f"{kind} of {', '.join(scene.actuators[actuator].name for actuator in group)}"


def _check_some_drive(scene: Scene) -> None:
    """Raise SceneError where all magnitudes are zero and fixed, so that nothing moves whatever is searched."""
    at_rest = not any(actuator.magnitude for actuator in scene.actuators) and scene.search.magnitude is None
    bias = scene.drive.electrostatic is not None and scene.drive.electrostatic.bias
    if at_rest and not bias and scene.effects.moving_load is None:
        raise SceneError(
            "search: the actuators' magnitudes are all 0 and fixed, so that nothing moves; write others, or search "
            "them: [search.magnitude]"
        )


def _check_equal_magnitudes(scene: Scene) -> None:
    """Raise SceneError where magnitudes should be equal, are not, and are fixed."""
    sizes = {abs(actuator.magnitude) for actuator in scene.actuators}
    if scene.search.limits.equal_magnitudes and scene.search.magnitude is None and len(sizes) > 1:
        raise SceneError(
            f"search.limits.equal_magnitudes: the actuators' magnitudes, from {min(sizes):g} to {max(sizes):g}, differ "
            "and are fixed; write the same for all, or search them: [search.magnitude]"
        )
