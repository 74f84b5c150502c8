"""The search for the best panel of a scene's table ``[design]``, by L-BFGS-B from many starts, or SLSQP under limits.

The free numbers stay between 0 and 1, and range, length and mass of a map hold for all of them. Each start is
independent of the others: finished ones are kept in a file, and a search that goes on takes them from there. The best
panels are then solved for by all functions of other commands, and the first one that keeps all limits is the answer,
only if it is better than the scene that the search began with, or that scene passes a limit.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from warp_plate._version import __version__
from warp_plate.accuracy.reference_solution import FINER, refine_until
from warp_plate.accuracy.richardson import extrapolate_drives
from warp_plate.designing.candidates import Candidates, ceiling, gridded, without
from warp_plate.designing.panel import MARGIN, FreePanel, Value
from warp_plate.effects.effect import attachments
from warp_plate.interrupts import check_interrupt, deferred_interrupts
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.files import digests
from warp_plate.result.atomic_io import write_atomically
from warp_plate.result.designed import DesignedPanel, PanelValues, StepCheck
from warp_plate.scene.errors import SceneError, under
from warp_plate.scene.fit import Design
from warp_plate.scene.model import Scene, SceneSource

# Functions along each side, relative to those of other commands, of the solutions by which a panel must be better.
DENSITIES = (1.0, FINER)
# Numbers of earlier steps from which L-BFGS-B takes curvatures.
MEMORY = 20
# Most free numbers under limits: a step takes their cube.
MOST_LIMITED = 1000
# Of the check by time steps: relative error at which grids are fine enough, nominal time of all of them [s], and the
# number of attachments that take as long as the rest of a step.
WANTED, SECONDS, ATTACHED = 2e-3, 10.0, 10
LOGGER = logging.getLogger("warp_plate")
# Function of the iterations done, all of them and a note.
Progress = Callable[[int, int, str], object]


@dataclass
class Climb:
    """The search from one start."""

    numbers: list[float]  # best free numbers so far
    least: float | None = None  # value there; None if no panel has kept the limits
    history: list[float] = field(default_factory=list)  # value of the best after each iteration, once there is one
    evaluations: int = 0
    left_out: list[str] = field(default_factory=list)  # tables that ``[design.count]`` leaves out of the numbers
    relaxed: float | None = None  # value with all of them


def design(
    scene: SceneSource,
    on_progress: Progress | None = None,
    unfinished: str | Path | None = None,
    check: bool = True,
) -> DesignedPanel:
    """Find the panel with the largest or least value of what ``[design]`` names; see docs/design.md.

    Ctrl-C ends the search, and the best panel so far is returned, with ``interrupted`` set.

    Args:
        scene: Scene with a table ``[design]``.
        on_progress: Function of the iterations done, all of them, and a note.
        unfinished: File of finished starts, from which the same search goes on; delete it once the panel is saved.
        check: Simulate the best drive of the designed panel, or its own, in time steps too.

    Raises:
        SceneError: There is no such table, slopes of the scene are not known, or a range reaches too far.
    """
    loaded = Scene.load(scene)
    panel = FreePanel(loaded)
    if panel.design.limits.given and panel.count > MOST_LIMITED:
        least = f"at most {MOST_LIMITED}; write a larger design.thickness.length_scale"
        raise SceneError(f"design.limits: {panel.count} free numbers; with limits {least}")
    candidates = Candidates(panel)
    panel.follow(panel.start())  # or refuse the gap
    begin = loaded.model_copy(update={"design": None})
    before, *more = (candidates.counted(panel.exact(begin, density), ()) for density in DENSITIES)
    file = None if unfinished is None else Path(unfinished)
    digest = _digest(loaded)
    climbs = [] if file is None else _read(file, digest, panel, candidates)
    interrupted, settings = False, panel.design
    try:
        with deferred_interrupts():
            for index in range(len(climbs), settings.starts):
                climb = Climb(_start(panel, index).tolist())
                climbs.append(climb)
                report = partial(_report, on_progress, panel, climbs)
                if settings.count:
                    _choose(panel, candidates, climb, report)
                _climb(_panel_of(panel, climb), climb, report)
                if file is not None:
                    _write(file, digest, climbs)
    except KeyboardInterrupt:
        interrupted = True
    climbs = [climb for climb in climbs if climb.history]
    result = DesignedPanel(
        original=loaded,
        scene=begin,
        before=before,
        after=before,
        history=tuple(tuple(map(panel.shown, climb.history)) for climb in climbs),
        keys=panel.keys,
        values=panel.values(panel.start()),
        evaluations=sum(climb.evaluations for climb in climbs),
        relaxed=panel.shown(max(relaxed)) if (relaxed := [one.relaxed for one in climbs if one.relaxed]) else None,
        ceiling=ceiling(loaded),
        interrupted=interrupted,
    )
    for climb in sorted(climbs, key=lambda climb: -_value(climb)):
        best, own = np.array(climb.numbers), _panel_of(panel, climb)
        designed, solved = own.scene_at(best), list[PanelValues]()
        for density, present in zip(DENSITIES, [before, *more], strict=True):
            with under("design: a range reaches too far"):
                after = candidates.counted(own.exact(designed, density), climb.left_out)
            better = after.value < present.value if settings.lowers else after.value > present.value
            if not (after.kept and (better or not present.kept)):
                break
            solved.append(after)
        else:
            result = replace(result, scene=designed, after=solved[0], keys=own.keys, values=own.values(best))
            result = replace(result, left_out=tuple(climb.left_out))
            break
    if check and result.improved and not interrupted:
        result = replace(result, check=_check_by_steps(result.scene, settings))
    return result


def _start(panel: FreePanel, index: int) -> np.ndarray:
    """Return the free numbers (count,) of a start: the scene's own first, then random ones."""
    return panel.start() if index == 0 else panel.draw(np.random.default_rng([panel.design.seed, index]))


def _value(climb: Climb) -> float:
    return -math.inf if climb.least is None else climb.least


def _panel_of(panel: FreePanel, climb: Climb) -> FreePanel:
    """Return the panel whose numbers a climb has."""
    return FreePanel(without(panel.scene, climb.left_out)) if climb.left_out else panel


def _choose(panel: FreePanel, candidates: Candidates, climb: Climb, report: Callable[[int], None]) -> None:
    """Search with all candidates, and leave those out that pass the count; ``climb`` then begins with the others."""

    def value(numbers: np.ndarray) -> float:
        check_interrupt()
        climb.evaluations += 1
        return panel.evaluate(numbers, sloped=False).least

    _climb(panel, climb, report)
    numbers = np.array(climb.numbers)
    climb.left_out, climb.relaxed = candidates.left_out(numbers, value), climb.least
    climb.numbers = candidates.kept(numbers, climb.left_out).tolist()
    climb.least, climb.history = None, []


def _climb(panel: FreePanel, climb: Climb, report: Callable[[int], None]) -> None:
    """Search from the numbers of ``climb``, which has the best panel at any time."""
    solved: dict[bytes, Value] = {}

    def at(numbers: np.ndarray) -> Value:
        check_interrupt()
        if numbers.tobytes() not in solved:
            value = panel.evaluate(numbers)
            climb.evaluations += 1
            if value.least > _value(climb) and value.excess.max(initial=0.0) <= MARGIN / 2:
                climb.least, climb.numbers = value.least, numbers.tolist()
            solved.clear()
            solved[numbers.tobytes()] = value
        return solved[numbers.tobytes()]

    def loss(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        return -at(numbers).smooth, -at(numbers).slopes

    def iterated(_: np.ndarray) -> None:
        note()
        report(len(climb.history))

    def note() -> None:
        if climb.least is not None:
            climb.history.append(climb.least)

    start = np.array(climb.numbers)
    panel.follow(start)
    limited, count = panel.design.limits.given, panel.design.iterations
    options: dict[str, Any] = {"maxiter": count, "maxcor": MEMORY, "ftol": 1e-9, "gtol": 1e-7}
    keys: dict[str, Any] = {"method": "L-BFGS-B"}
    if limited:
        options = {"maxiter": count, "ftol": 1e-7}
        limits = {"type": "ineq", "fun": lambda x: -at(x).excess, "jac": lambda x: -at(x).excess_slopes}
        keys = {"method": "SLSQP", "constraints": [limits]}
    bounds = [(0.0, 1.0)] * panel.count
    found = scipy.optimize.minimize(loss, start, jac=True, bounds=bounds, callback=iterated, options=options, **keys)
    if climb.least is None:
        climb.numbers = np.clip(found.x, 0, 1).tolist()
    note()


def _report(progress: Progress | None, panel: FreePanel, climbs: Sequence[Climb], done: int) -> None:
    if progress is not None:
        settings, index = panel.design, len(climbs) - 1
        note = f"start {index + 1} of {settings.starts}, best {panel.shown(max(map(_value, climbs))):.4g}"
        progress(index * settings.iterations + done, settings.starts * settings.iterations, note)


def _digest(scene: Scene) -> str:
    """Return a text that is the same for the same search."""
    files = digests(scene.named_files, scene.folder)
    return sha256(json.dumps([__version__, scene.to_toml(), files]).encode()).hexdigest()


def _write(file: Path, digest: str, climbs: Sequence[Climb]) -> None:
    record = {"design": digest, "starts": [asdict(climb) for climb in climbs]}
    try:
        write_atomically(f"{json.dumps(record)}\n".encode(), file)
    except SceneError as error:
        LOGGER.warning("%s; continuing without", error)


def _read(file: Path, digest: str, panel: FreePanel, candidates: Candidates) -> list[Climb]:
    """Return the finished starts of a file; none if there is no file, or one of another search."""
    if not file.exists():
        return []
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        if record["design"] != digest:
            LOGGER.warning("%s holds starts of another search or version; those of this one will replace them", file)
            return []
        climbs = [Climb(**row) for row in record["starts"]]
        for climb in climbs:
            least = [] if climb.least is None and not climb.history else [climb.least]  # limits that no panel kept
            if not candidates.allow(climb.left_out):
                raise ValueError("left out")
            count = _panel_of(panel, climb).count
            relaxed = [] if climb.relaxed is None else [climb.relaxed]
            every = np.array([*climb.numbers, *climb.history, *least, *relaxed, climb.evaluations])
            free = every[: len(climb.numbers)]
            within = len(free) == count and every.dtype.kind == "f" and ((free >= 0) & (free <= 1)).all()
            if not (within and np.isfinite(every).all()):
                raise ValueError("numbers")
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        raise SceneError(f"{file}: is no unfinished design of this version; delete it") from None
    return climbs


def _check_by_steps(scene: Scene, design: Design) -> StepCheck:
    """Return the localization factor, by modes and by time steps, of a scene's best drive, or of its own.

    The grids of the steps are ever finer, and share nothing with the modes of the search.

    With a design's objective "bound" the best drive is taken, which no drive exceeds.
    """
    response = ModalSolver(gridded(scene), "cpu").response
    phasors = response.best_drive() if design.objective == "bound" else scene_phasors(scene)
    drives = np.asarray(phasors)[None]
    by_modes = float(response.localization_factors(drives)[0])
    try:
        if scene.steady or design.steady:
            raise SceneError("time steps end at window.end, and this motion is steady")
        seconds = SECONDS / (1 + len(attachments(scene.terms)) / ATTACHED)
        found = refine_until(extrapolate_drives(scene, drives, "cpu"), lambda _: WANTED, seconds)
    except SceneError as error:
        return StepCheck(by_modes, reason=str(error))
    steps = float(found.values[0])
    return StepCheck(by_modes, steps, abs(steps) * found.uncertainty)
