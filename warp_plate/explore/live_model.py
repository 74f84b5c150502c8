"""A scene to play with: any drive at once, another frequency or damping as soon as it is simulated.

Whoever draws calls ``read`` for each picture; it never waits for a simulation. A worker thread simulates what was asked
for last, and a swarm that is watched runs in a thread of its own.
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from warp_plate.analysis.superposition import SimulatedResponses, UnitResponses, simulated_responses, unit_responses
from warp_plate.explore.settings import Settings, changed_scene, polar, ranges_of
from warp_plate.explore.watched_search import WatchedSearch
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.problem.evaluate_cases import reference_phasors
from warp_plate.problem.parametrization import magnitude_unit
from warp_plate.result.live import DriveResponse, SwarmSnapshot
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import Progress

CHOICES = ("scene", "equal", "single", "found", "exact", "random")
# The start-up motion that is worth a word, as a share of the motion.
LEFT_OVER = 0.02


class LiveModel:
    """A scene under settings that change while it is looked at.

    Args:
        scene: with a grid; its drive is the first one.
        device, path: see :class:`PlateSolver`.
        progress: of the first simulation, which is over when this returns.

    Raises:
        SceneError: a load that does not repeat; see :class:`PlateSolver`. Later ones are told by ``status`` and leave
            the last reading as it is.
    """

    def __init__(
        self, scene: Scene, device: str = "auto", path: str = "auto", progress: Progress | None = None
    ) -> None:
        if scene.nonperiodic_key is not None:
            raise SceneError(
                f"{scene.nonperiodic_key}: what is explored repeats with the period of drive.frequency; leave it out"
            )
        self.scene = scene
        self.ranges = ranges_of(scene)
        self._device, self._path = device, path
        self._scale = max((abs(one.magnitude) for one in scene.actuators), default=0.0) or 1.0
        drive = scene_phasors(scene)
        damping = scene.effects.damping.viscous if scene.effects.damping else 0.0
        self.settings = Settings(scene.drive.frequency, damping, *polar(drive))
        self._random = np.random.default_rng()
        self._responses: UnitResponses | SimulatedResponses = self._simulated(scene, progress)
        self._reading = self._responses.read(drive)
        self._done = self.settings
        self._choice: tuple[str, float] | None = None
        self._problem = ""
        self._search: WatchedSearch | None = None
        self._searches = 0
        self._closed = False
        self._changed = threading.Condition()
        self._worker = threading.Thread(target=self._work, name="live model", daemon=True)
        self._worker.start()

    # What is shown ------------------------------------------------------------------------------------------

    def read(self) -> DriveResponse:
        """The plate under the settings, or as near to them as it is known by now."""
        responses, wanted, reading = self._responses, self.settings, self._reading
        if isinstance(responses, UnitResponses):
            drive = wanted.drive
            if reading.scene is not responses.scene or not np.array_equal(reading.phasors, drive):
                reading = self._reading = responses.read(drive)
        return reading

    def busy(self) -> bool:
        """Whether a simulation or a search is under way."""
        swarm = self.swarm()
        searching = self._search is not None and (swarm is None or swarm.running)
        return self._choice is not None or self._behind(self.settings) or searching

    def status(self) -> str:
        """One line for people: what is being done or went wrong, or what the picture leaves out; mostly empty."""
        if self._problem:
            return self._problem
        if self._behind(self.settings):
            return "simulating ..."
        if self._search is not None and self.swarm() is None:
            return "searching: the first swarm ..."
        left = self.read().motion.residual
        if not math.isfinite(left):
            return "the numbers of this run grew beyond all bounds: drive less, or write a shorter grid.time_step"
        if left > LEFT_OVER:
            return f"not steady: {100 * left:.2g} % of the motion at the end of the run is start-up motion, not shown"
        return ""

    def swarm(self) -> SwarmSnapshot | None:
        """The search that was asked for last, while its frequency and damping hold."""
        return self._search.read() if self._search is not None else None

    # What is asked for --------------------------------------------------------------------------------------

    def set_frequency(self, frequency: float) -> None:
        """Drive at this frequency [Hz] as soon as it is simulated."""
        self._ask(frequency=float(frequency))

    def set_damping(self, damping: float) -> None:
        """Damp by this c [N·s/m³] as soon as it is simulated."""
        self._ask(damping=float(damping))

    def set_actuator(self, index: int, magnitude: float | None = None, phase: float | None = None) -> None:
        """Another magnitude [N/m²] or phase lag [rad] of one actuator. Ends a search."""
        with self._changed:
            self._end_search()
            self._choice = None
            magnitudes, phases = list(self.settings.magnitude), list(self.settings.phase)
            if magnitude is not None:
                magnitudes[index] = float(magnitude)
            if phase is not None:
                phases[index] = float(phase)
            self._ask(magnitude=tuple(magnitudes), phase=tuple(phases))

    def choose(self, choice: str, seconds: float = 0.0) -> None:
        """Take one of the CHOICES as the drive; ``seconds`` an iteration of the search that "found" makes.

        "scene": as the scene gives it; "equal": all alike; "single": the best single actuator; "found": by the
        scene's swarm, the drive being its best so far; "exact": the one that reaches the bound, where there is one;
        "random": any.

        Raises:
            ValueError: none of these.
        """
        if choice not in CHOICES:
            raise ValueError(f"choice = {choice!r}: there are: {', '.join(CHOICES)}")
        with self._changed:
            self._end_search()
            self._choice = (choice, seconds)
            self._changed.notify()

    def end_search(self) -> None:
        """Search no further; the best drive so far stays."""
        if self._search is not None:
            self._search.end()

    def wait(self) -> None:
        """Until nothing is under way: for tests and for pictures without a window."""
        while True:
            search = self._search
            if search is not None:
                search.join()
            with self._changed:
                if not self._changed.wait_for(lambda: self._choice is None and not self._behind(self.settings), 0.02):
                    continue
            if search is self._search:
                return

    def close(self) -> None:
        """End the threads."""
        self._end_search()
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._worker.join()

    # How ----------------------------------------------------------------------------------------------------

    def _ask(self, **changes: Any) -> None:
        with self._changed:
            self.settings = replace(self.settings, **changes)
            self._changed.notify()

    def _behind(self, wanted: Settings) -> bool:
        """Whether something must be simulated for these settings."""
        done = self._done
        if (wanted.frequency, wanted.damping) != (done.frequency, done.damping):
            return True
        return not self.scene.linear and wanted != done

    def _end_search(self) -> None:
        with self._changed:
            self._searches += 1  # what the one before finds from now on comes too late
            if self._search is not None:
                self._search.end()
                self._search = None

    def _work(self) -> None:
        try:
            self._follow_all()
        finally:
            # Not closed: an error that no scene explains. Its traceback goes to standard error.
            with self._changed:
                if not self._closed:
                    self._problem = "the simulation has failed; what went wrong stands on standard error"
                self._done, self._choice = self.settings, None
                self._changed.notify_all()

    def _follow_all(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._choice is not None or self._behind(self.settings))
                if self._closed:
                    return
                wanted, choice = self.settings, self._choice
            try:
                self._follow(wanted)
                if choice is not None:
                    self._take(*choice)
                self._problem = ""
            except SceneError as error:
                self._problem = str(error)
            with self._changed:
                self._done = wanted
                if self._choice is choice:
                    self._choice = None
                self._changed.notify_all()

    def _follow(self, wanted: Settings) -> None:
        """Simulate what the settings need."""
        done = self._done
        if (wanted.frequency, wanted.damping) != (done.frequency, done.damping):
            self._end_search()
            self._responses = self._simulated(changed_scene(self.scene, wanted.frequency, wanted.damping))
        if isinstance(self._responses, SimulatedResponses):
            self._reading = self._responses.read(wanted.drive)

    def _simulated(self, scene: Scene, progress: Progress | None = None) -> UnitResponses | SimulatedResponses:
        if scene.linear:
            return unit_responses(scene, self._device, self._path, progress)
        return simulated_responses(scene, self._device, self._path)

    def _take(self, choice: str, seconds: float) -> None:
        responses, actuators = self._responses, len(self.scene.actuators)
        if choice == "found" and actuators > 1:
            with self._changed:
                found = partial(self._move_to, search=self._searches)
                self._search = WatchedSearch(responses.scene, responses.energies, self._scale, seconds, found)
            return
        if choice == "scene":
            drive = scene_phasors(self.scene)
        elif choice == "random":
            turns = np.exp(2j * math.pi * self._random.random(actuators))
            drive = self._scale * self._random.random(actuators) * turns
        elif choice == "exact":
            if not isinstance(responses, UnitResponses):
                raise SceneError(f"exact best: {self.scene.nonlinear_table} is not linear in the drives")
            drive = self._scale * responses.best_drive
        else:
            references = reference_phasors(self.scene, responses.energies)
            drive = references["equal" if choice == "equal" else "single"]
            drive = drive * (self._scale / magnitude_unit(self.scene))
        self._move_to(drive)

    def _move_to(self, drive: np.ndarray, search: int | None = None) -> None:
        """Make a drive [N/m²] the one asked for, brought within the sliders' range where only ratios count.

        search: the number of the one that found it; nothing happens if that has been ended.
        """
        largest = np.abs(drive).max()
        if self.scene.linear and largest > self.ranges.magnitude:
            drive = drive * (self.ranges.magnitude / largest)
        magnitude, phase = polar(drive)
        with self._changed:
            if search is None or search == self._searches:
                self._ask(magnitude=magnitude, phase=phase)
