"""Which numbers a scene's ``[search]`` has_design_tables, their limits, and whether they fit the scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from warp_plate.plate.designs import per_plate_of
from warp_plate.plate.scheme import MOST_STEPS, STEPS_A_PERIOD, make_scheme
from warp_plate.plate.signals import actuator_delays, actuator_frequencies
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Search

# The tables that free something; without any the search is the source paper's.
TABLES = ("magnitude", "phase", "frequency", "position", "delay")
# Objectives that a common factor of the drive does not change, where displacements are linear in it.
RATIOS = ("localization", "contrast", "uniformity")
# From where the source paper draws its first positions.
PAPER_FIRST = (-2.0, 2.0)
TURN = 2 * math.pi


@dataclass(frozen=True)
class DesignVariable:
    """A number that is searched: for people its name, what it is (magnitude, phase, frequency, x, y or delay), and of
    which actuators, by index; for the others see ``Space``. held: what the scene has."""

    name: str
    kind: str
    actuators: tuple[int, ...]
    held: float
    first: tuple[float, float]
    lower: float = -math.inf
    upper: float = math.inf
    period: float = math.inf


def has_design_tables(scene: Scene) -> bool:
    """Whether some table says what is free, so that the search is not the source paper's."""
    return any(getattr(scene.search, name) is not None for name in TABLES)


def with_paper_search(scene: Scene) -> Scene:
    """The scene with the source paper's search for its localization factor, and the swarm that its own has."""
    plain = Search()
    fixed = {name: getattr(plain, name) for name in (*TABLES, "objectives", "limits", "robust")}
    return scene.model_copy(update={"search": scene.search.model_copy(update=fixed)})


def only_ratios(scene: Scene) -> bool:
    """Whether a factor that all actuators have in common changes nothing that is sought."""
    return scene.linear and all(one.kind in RATIOS for one in scene.search.objectives)


def make_design_variables(scene: Scene) -> tuple[DesignVariable, ...]:
    """The free numbers; none only where the paper's reading meets a single actuator, which leaves no choice.

    Raises:
        SceneError: nothing is free, or a table does not fit the scene; names the key.
    """
    if not has_design_tables(scene):
        return _paper_numbers(scene)
    _check_equal(scene)
    _check_some_drive(scene)
    made = (*_magnitudes(scene), *_phases(scene), *_frequencies(scene), *_positions(scene), *_delays(scene))
    if not made:
        raise SceneError(
            "search: nothing is free that changes the motion; name more actuators, or write one of "
            f"{', '.join(f'[search.{name}]' for name in TABLES)}"
        )
    return made


def with_common_step(scene: Scene) -> Scene:
    """The scene with one time step for all the frequencies and starts that its search may find.

    Raises:
        SceneError: the scene's own time step does not carry the range; see ``at_highest_frequency``, ``make_scheme``.
    """
    free, step = scene.search.frequency, scene.grid.time_step
    if step is None and (free is not None or scene.search.delay is not None):
        hardest = at_highest_frequency(scene)
        # Plates whose actuators differ in these go the general way, which has a limit of its own.
        forms = {False, per_plate_of(scene).per_actuator}
        step = min(make_scheme(hardest, moment_form=moment_form).time_step for moment_form in forms)
        return scene.with_tables(grid={**scene.grid.model_dump(), "time_step": step})
    if step is not None and free is not None:
        carried = 0.5 / step / _times(scene)
        if free.range[1] >= carried:
            raise SceneError(
                f"search.frequency.range = {list(free.range)}: a step of {step:g} s carries less than {carried:.6g} "
                "Hz; end the range lower, or write a smaller grid.time_step"
            )
    return scene


def at_highest_frequency(scene: Scene) -> Scene:
    """The scene with every frequency that is free at the upper end of its range: the one that asks most of a grid.

    Raises:
        SceneError: a step chosen for it is too short for a run of at most MOST_STEPS.
    """
    free = scene.search.frequency
    if (
        free is None or scene.drive.signal is not None
    ):  # of which ``make_design_variables`` says that they do not go together
        return scene
    most = MOST_STEPS / STEPS_A_PERIOD / scene.window.end / _times(scene)
    if scene.grid.time_step is None and free.range[1] > most:
        raise SceneError(
            f"search.frequency.range = {list(free.range)}: {free.range[1]:g} Hz takes "
            f"{MOST_STEPS * free.range[1] / most:.3g} steps until window.end = {scene.window.end:g} s, and at most "
            f"{MOST_STEPS:.3g} are possible; end the range at {most:.4g} Hz or lower"
        )
    who = set(_named(scene, "frequency"))
    actuators = [
        one.model_dump() | ({"frequency": free.range[1]} if index in who else {})
        for index, one in enumerate(scene.actuators)
    ]
    return scene.with_tables(actuators=actuators)


def _times(scene: Scene) -> int:
    """By how much the plate's highest frequency is that of the voltage: squares have twice that."""
    return 1 if scene.drive.electrostatic is None else 2


def _paper_numbers(scene: Scene) -> tuple[DesignVariable, ...]:
    """Section II.C of the source paper; see ``variables``."""
    search, others = scene.search, range(1, len(scene.actuators))
    ends = search.limits.magnitude or search.limits.power
    for index, one in enumerate(search.objectives):
        if one.kind not in RATIOS and one.rest_limit is None and not ends:
            raise SceneError(
                f"search.objectives[{index}].kind = {one.kind!r}: grows with the magnitudes without end; write "
                "[search.magnitude] with a range, search.limits, or a rest_limit"
            )
    made = []
    for kind in ("magnitude", "phase"):
        if kind == "magnitude" and search.limits.equal_magnitudes:
            continue
        held = 1.0 if kind == "magnitude" else 0.0
        made += [DesignVariable(_title(scene, kind, (one,)), kind, (one,), held, PAPER_FIRST) for one in others]
    return tuple(made)


def _magnitudes(scene: Scene) -> Iterator[DesignVariable]:
    free, limits = scene.search.magnitude, scene.search.limits
    if free is None:
        return
    who, (low, high) = _named(scene, "magnitude"), free.range
    groups: list[tuple[int, ...]] = [(one,) for one in who]
    if limits.equal_magnitudes:
        if len(who) < len(scene.actuators):
            raise SceneError(
                "search.magnitude.actuators: limits.equal_magnitudes gives all actuators the same; delete one of them"
            )
        # Where only ratios matter, one magnitude of all changes nothing.
        groups = [] if only_ratios(scene) else [who]
    for group in groups:
        held = scene.actuators[group[0]].magnitude
        yield DesignVariable(_title(scene, "magnitude", group), "magnitude", group, held, (low, high), low, high)


def _phases(scene: Scene) -> Iterator[DesignVariable]:
    """A common phase shifts a steady motion in time, and changes nothing: then the first actuator's is held.

    It is free where the motion has a time of its own: a burst, a sweep, a file, a moving load.
    """
    if scene.search.phase is None:
        return
    who, drive = _named(scene, "phase"), scene.drive
    clocked = drive.burst or drive.chirp or drive.signal or scene.effects.moving_load
    if len(who) == len(scene.actuators) and not clocked:
        who = who[1:]
    for one in who:
        name, held = _title(scene, "phase", (one,)), scene.actuators[one].phase
        yield DesignVariable(name, "phase", (one,), held, (0.0, TURN), period=TURN)


def _frequencies(scene: Scene) -> Iterator[DesignVariable]:
    free = scene.search.frequency
    if free is None:
        return
    for key in ("signal", "chirp"):
        if getattr(scene.drive, key) is not None:
            raise SceneError(f"search.frequency: drive.{key} says which frequencies there are; delete one of them")
    who, (low, high) = _named(scene, "frequency"), free.range
    for group in [(one,) for one in who] if free.own else [who]:
        held = float(actuator_frequencies(scene)[group[0]])
        yield DesignVariable(_title(scene, "frequency", group), "frequency", group, held, (low, high), low, high)


def _positions(scene: Scene) -> Iterator[DesignVariable]:
    """Middles of patches, so that the whole patch stays in the area; along a side that leaves no room, it stays."""
    free = scene.search.position
    if free is None:
        return
    if scene.grid.load == "nodes":
        raise SceneError(
            'search.position: grid.load = "nodes" moves an actuator by whole nodes, in jumps; write load = "overlap" '
            'or "moments"'
        )
    width, height = scene.plate.size
    area = free.area or (0.0, width, 0.0, height)
    for one in _named(scene, "position"):
        patch = scene.actuators[one].area
        for axis, side, first in (("x", width, 0), ("y", height, 2)):
            low, high, start, stop = patch[first], patch[first + 1], area[first], area[first + 1]
            half = (high - low) / 2
            if stop - start < 2 * half - 1e-9 * side:
                raise SceneError(
                    f"search.position.area = {list(area)}: is {stop - start:.6g} m long along {axis}, actuator "
                    f"{scene.actuators[one].name!r} {2 * half:.6g} m; make room for all of it"
                )
            lower, upper = start + half, stop - half
            if upper - lower <= 1e-9 * side and abs((low + high) / 2 - lower) > 1e-9 * side:
                raise SceneError(
                    f"search.position.area = {list(area)}: is no longer along {axis} than actuator "
                    f"{scene.actuators[one].name!r}, which lies elsewhere; move it there, or enlarge the area"
                )
            if upper - lower > 1e-9 * side:
                yield DesignVariable(
                    _title(scene, axis, (one,)), axis, (one,), (low + high) / 2, (lower, upper), lower, upper
                )


def _delays(scene: Scene) -> Iterator[DesignVariable]:
    free = scene.search.delay
    if free is None:
        return
    if scene.drive.burst is None:
        raise SceneError("search.delay: only a burst has a start; write [drive.burst], or delete search.delay")
    who, (low, high) = _named(scene, "delay"), free.range
    if high >= scene.window.end:
        raise SceneError(
            f"search.delay.range = {list(free.range)}: reaches past the run, which ends at window.end = "
            f"{scene.window.end:g} s; end it earlier"
        )
    for group in [(one,) for one in who] if free.own else [who]:
        held = float(actuator_delays(scene)[group[0]])
        yield DesignVariable(_title(scene, "delay", group), "delay", group, held, (low, high), low, high)


def _named(scene: Scene, table: str) -> tuple[int, ...]:
    """Indices of the actuators that a table names; all where it names none.

    Raises:
        SceneError: no actuator has a name that it names, or it names one twice.
    """
    there = [one.name for one in scene.actuators]
    names = getattr(scene.search, table).actuators
    if names is None:
        return tuple(range(len(there)))
    for index, name in enumerate(names):
        if name not in there:
            raise SceneError(
                f"search.{table}.actuators[{index}] = {name!r}: there is no such actuator; there are: "
                f"{', '.join(there)}"
            )
        if name in names[:index]:
            raise SceneError(f"search.{table}.actuators[{index}] = {name!r}: stands there twice; delete one")
    return tuple(sorted(there.index(name) for name in names))


def _title(scene: Scene, kind: str, group: tuple[int, ...]) -> str:
    """For people: "phase of upper left"; just "frequency" where it is that of all."""
    if len(group) == len(scene.actuators) > 1:
        return kind
    return f"{kind} of {', '.join(scene.actuators[one].name for one in group)}"


def _check_some_drive(scene: Scene) -> None:
    """Raise SceneError where all magnitudes are zero and held, so that nothing moves whatever is searched."""
    at_rest = not any(one.magnitude for one in scene.actuators) and scene.search.magnitude is None
    bias = scene.drive.electrostatic is not None and scene.drive.electrostatic.bias
    if at_rest and not bias and scene.effects.moving_load is None:
        raise SceneError(
            "search: the actuators' magnitudes are all 0 and held, so that nothing moves; write others, or free them: "
            "[search.magnitude]"
        )


def _check_equal(scene: Scene) -> None:
    """Raise SceneError where magnitudes should be equal, are not, and are held."""
    sizes = {abs(one.magnitude) for one in scene.actuators}
    if scene.search.limits.equal_magnitudes and scene.search.magnitude is None and len(sizes) > 1:
        raise SceneError(
            f"search.limits.equal_magnitudes: the actuators' magnitudes, from {min(sizes):g} to {max(sizes):g}, differ "
            "and are held; write the same for all, or free them by [search.magnitude]"
        )
