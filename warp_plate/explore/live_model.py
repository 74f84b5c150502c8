"""Model of the explorer: responds to a new drive at once, to another frequency or plate once it is simulated.

``read`` is called for each picture and never waits for a simulation. A worker thread simulates the latest request, and
a watched search has a thread of its own.
"""

import math
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.accuracy.configurations import percent
from warp_plate.explore.unit_responses import UnitResponses, unit_responses
from warp_plate.modal.solver import MODAL
from warp_plate.optimize.optimizer import minimize
from warp_plate.optimize.pso import Swarm
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import magnitude_unit, single_drives, with_paper_search
from warp_plate.problem.evaluate_cases import reference_phasors
from warp_plate.problem.methods import swarm_settings
from warp_plate.problem.parametrization import paper_phasors, parametrization_of
from warp_plate.resolve import choose_engine
from warp_plate.result.motion import DriveResponse, SwarmSnapshot
from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import label_of, linked_keys, unit_of, value_of
from warp_plate.scene.model import Scene
from warp_plate.solve.run import Progress
from warp_plate.solve.solver import refuse_pickling

# Ends of the sliders as multiples of the scene's values; if it has no damping, as a loss factor at its frequency.
FREQUENCY_RANGE, MAGNITUDE_RANGE, LOSS_FACTOR_RANGE = (0.2, 2.0), 2.0, 0.5
DAMPING_RANGE, LINK_RANGE = (0.0, 5.0), (0.2, 2.0)
VISCOUS = "effects.damping.viscous"  # key of the slider of a scene without damping
# Linked keys that have a slider.
PANEL_KEY = re.compile(r"(plate\.(?!size)|edges\.|effects\.)")
MIN_STEPS_PER_PERIOD = 4  # if the scene fixes the time step
CHOICES = {"scene": "scene's own", "equal": "equal", "single": "best single"}
CHOICES |= {"found": "best found", "exact": "exact best", "random": "random"}
# Share of the motion from which start-up motion is mentioned.
RESIDUAL_WARNING = 0.02


@dataclass(frozen=True)
class SliderRanges:
    """Ends of the sliders."""

    magnitude: float  # largest magnitude of an actuator [N/m²]; the least is 0
    frequency: tuple[float, float]  # least and largest frequency of the drive [Hz]
    numbers: Mapping[str, tuple[float, float]]  # least and largest damping and linked numbers, by keys of the scene


@dataclass(frozen=True)
class LiveSettings:
    """Positions of the sliders."""

    frequency: float  # frequency of the drive [Hz]
    numbers: tuple[float, ...]  # damping and linked numbers, in the order of ``SliderRanges.numbers``
    magnitude: tuple[float, ...]  # magnitude of each actuator [N/m²]
    phase: tuple[float, ...]  # phase lag of each actuator [rad]

    @property
    def phasors(self) -> np.ndarray:
        """(actuators,) complex amplitudes of the drive [N/m²]."""
        return np.array(self.magnitude) * np.exp(-1j * np.array(self.phase))


def slider_ranges(scene: Scene) -> SliderRanges:
    """Return the ends of the sliders for a scene, within the limits of its run."""
    frequency = scene.drive.frequency
    highest = FREQUENCY_RANGE[1] * frequency
    if scene.grid.time_step is not None:
        highest = max(frequency, min(highest, 1 / (MIN_STEPS_PER_PERIOD * scene.grid.time_step)))
    lowest = min(frequency, max(FREQUENCY_RANGE[0] * frequency, 1 / scene.window.end))
    return SliderRanges(MAGNITUDE_RANGE * magnitude_unit(scene), (lowest, highest), _number_ranges(scene))


def _number_ranges(scene: Scene) -> dict[str, tuple[float, float]]:
    """Return the ends of the sliders of the panel's damping, of any kind, and of its links, by their keys."""
    damping = [f"{name}.{key}" for name, row in scene.effects.rows for key in row.damping_keys]
    links = {name: linked_keys(scene, name) for name in scene.links}
    linked = {key for keys in links.values() for key in keys}
    ranges = {key: DAMPING_RANGE for key in damping if key not in linked}
    ranges |= {name: LINK_RANGE for name, keys in links.items() if all(map(PANEL_KEY.match, keys))}
    ends = {}
    if not any(row.lossy for _, row in scene.effects.rows):
        stiff = scene.drive.angular_frequency * scene.plate.density * scene.plate.thickness
        ends[VISCOUS] = (0.0, LOSS_FACTOR_RANGE * stiff)
    for key, (low, high) in ranges.items():
        value = value_of(scene, key)
        if isinstance(value, float) and value > 0:
            ends[key] = (low * value, high * value)
    return ends


def number_at(scene: Scene, key: str) -> float:
    """Return the value of a slider in a scene: its number at a key, or no viscous damping."""
    return 0.0 if key == VISCOUS and scene.effects.damping is None else float(value_of(scene, key))


def changed_scene(scene: Scene, frequency: float, numbers: Mapping[str, float]) -> Scene:
    """Return the scene at another frequency [Hz] and with other numbers by their keys, or raise a SceneError."""
    changed = scene
    for key, value in numbers.items():
        if value != number_at(scene, key):
            changed = changed.replace(key, value)
    return changed.with_keys("drive", frequency=frequency)


def polar(phasors: np.ndarray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the magnitudes and the phase lags 0 ≤ φ < 2π of phasors."""
    phase = np.where(phasors == 0, 0.0, np.mod(-np.angle(phasors), 2 * math.pi))
    return tuple(np.abs(phasors).tolist()), tuple(phase.tolist())


class LiveModel:
    """A scene under settings that change while it is shown; the first simulation is done by the constructor.

    For ``device`` and ``path`` see :class:`PlateSolver`; "auto" takes the modes of a linear scene, and so does "modal".

    Attributes:
        ranges, settings: Ends and positions of the sliders.
        by_modes: Whether responses come from modes, without time steps.
        choices: Drives that can be chosen, and what their buttons say.

    Raises:
        SceneError: The motion is not linear in the drives, the load does not repeat with the drive, or see
            :class:`PlateSolver`. ``status`` reports later errors, which leave the last reading unchanged.
    """

    choices = CHOICES
    __reduce__ = refuse_pickling

    def __init__(
        self, scene: Scene, device: str = "auto", path: str = "auto", progress: Progress | None = None,
        respond: Callable[..., UnitResponses] = unit_responses,
    ) -> None:  # fmt: skip
        if (key := scene.nonperiodic_key) is not None:
            raise SceneError(f"{key}: what is explored repeats with the period of drive.frequency; leave it out")
        if (key := scene.nonlinear_table) is not None:
            raise SceneError(f"{key}: what is explored is linear in the drives; leave it out, or run simulate")
        self.scene = scene
        self.ranges = slider_ranges(scene)
        self.by_modes = choose_engine(scene, "survey", path) == "modes"
        self._device, self._path, self._respond = device, MODAL if self.by_modes else path, respond
        self._scale = magnitude_unit(scene)
        phasors = scene_phasors(scene)
        numbers = tuple(number_at(scene, key) for key in self.ranges.numbers)
        self.settings = LiveSettings(scene.drive.frequency, numbers, *polar(phasors))
        self._random = np.random.default_rng()
        self._responses = respond(scene, device, self._path, progress)
        self._reading = self._responses.read(phasors)
        self._simulated = self.settings
        self._choice: tuple[str, float] | None = None
        self._problem = ""
        self._search: WatchedSearch | None = None
        self._followed: SwarmSnapshot | None = None
        self._closed = False
        self._changed = threading.Condition()
        self._worker = threading.Thread(target=self._work, name="live model", daemon=True)
        self._worker.start()

    def read(self) -> DriveResponse:
        """Return the response to the settings, or to the latest ones that have been simulated."""
        self._follow_search()
        responses, phasors = self._responses, self.settings.phasors
        if self._reading.scene is not responses.scene or not np.array_equal(self._reading.phasors, phasors):
            self._reading = responses.read(phasors)
        return self._reading

    def number_label(self, key: str) -> str:
        """Return the label of the slider of a number of the panel, with its unit."""
        unit = unit_of(self.scene.replace(key, number_at(self.scene, key)), key)
        label = label_of(self.scene, key).removesuffix(" viscous")
        return label + (f" [{unit}]" if unit != "1" else "")

    def status(self) -> str:
        """Return one line about work in progress, errors or hidden motion, or ""."""
        if self._problem:
            return self._problem
        if self._outdated(self.settings):
            return "simulating ..."
        if self._search is not None and self.swarm() is None:
            return "searching: the first swarm ..."
        residual = self.read().motion.residual
        if residual > RESIDUAL_WARNING:
            return f"not steady: {percent(residual)} of the motion at the run's end is start-up motion, not shown"
        return ""

    def swarm(self) -> SwarmSnapshot | None:
        """Return the latest iteration of the search; None without one, or after another simulation."""
        return self._search.snapshot if self._search is not None else None

    def set_frequency(self, frequency: float) -> None:
        """Set the frequency of the drive [Hz]; it is shown as soon as it is simulated."""
        self._request(frequency=float(frequency))

    def set_number(self, key: str, value: float) -> None:
        """Set damping or a linked number of the panel by its key; it is shown as soon as it is simulated."""
        with self._changed:
            self._request(numbers=_with(self.settings.numbers, list(self.ranges.numbers).index(key), value))

    def set_actuator(self, index: int, **changes: float) -> None:
        """Set the ``magnitude`` [N/m²] or the ``phase`` lag [rad] of an actuator. Ends a search."""
        with self._changed:
            self._end_search()
            self._choice = None
            for key, value in changes.items():
                self._request(**{key: _with(getattr(self.settings, key), index, value)})

    def choose(self, choice: str, seconds: float = 0.0) -> None:
        """Take one of the CHOICES as the drive; ValueError for another.

        "found" is the best so far of a search by the scene's swarm, which begins now; an iteration takes at least so
        many seconds.
        """
        if choice not in CHOICES:
            raise ValueError(f"choice = {choice!r}: there are: {', '.join(CHOICES)}")
        with self._changed:
            self._end_search()
            self._choice = (choice, seconds)
            self._changed.notify()

    def wait(self) -> None:
        """Wait until nothing is under way, for tests and for pictures without a window."""
        while True:
            search = self._search
            if search is not None:
                search.join()
            self._follow_search()
            with self._changed:
                if self._changed.wait_for(self._at_rest, 0.02) and search is self._search:
                    return

    def close(self) -> None:
        """End the threads."""
        with self._changed:
            self._end_search()
            self._closed = True
            self._changed.notify()
        self._worker.join()

    def _request(self, **changes: Any) -> None:
        if not all(np.isfinite(values).all() for values in changes.values()):
            raise ValueError(f"{changes}: must be finite")
        with self._changed:
            self.settings = replace(self.settings, **changes)
            self._changed.notify()

    def _outdated(self, settings: LiveSettings) -> bool:
        """Return whether something must be simulated for these settings."""
        return (settings.frequency, settings.numbers) != (self._simulated.frequency, self._simulated.numbers)

    def _at_rest(self) -> bool:
        return self._choice is None and not self._outdated(self.settings)

    def _follow_search(self) -> None:
        """Take the best drive of the search, after each of its iterations."""
        with self._changed:
            snapshot = self.swarm()
            if snapshot is not None and snapshot is not self._followed and snapshot.best_phasors is not None:
                self._drive_by(self._scale * snapshot.best_phasors / np.abs(snapshot.best_phasors).max())
            self._followed = snapshot

    def _end_search(self) -> None:
        if self._search is not None:
            self._search.ended.set()
            self._search = None

    def _work(self) -> None:
        """Follow requests until the model is closed, in the worker thread."""
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._closed or not self._at_rest())
                    settings, choice = self.settings, self._choice
                    if self._closed:
                        return
                try:
                    if self._outdated(settings):
                        with self._changed:
                            self._end_search()
                        numbers = dict(zip(self.ranges.numbers, settings.numbers, strict=True))
                        changed = changed_scene(self.scene, settings.frequency, numbers)
                        self._responses = self._respond(changed, self._device, self._path, None)
                    if choice is not None:
                        self._take(*choice)
                    self._problem = ""
                except SceneError as error:
                    self._problem = str(error)
                with self._changed:
                    self._simulated = settings
                    self._choice = None if self._choice is choice else self._choice
                    self._changed.notify_all()
        finally:
            with self._changed:
                if not self._closed:  # an error of the program, whose traceback goes to standard error
                    self._problem = "the simulation has failed; the error is on standard error"
                self._simulated, self._choice = self.settings, None
                self._changed.notify_all()

    def _take(self, choice: str, seconds: float) -> None:
        responses, actuators = self._responses, len(self.scene.actuators)
        if choice == "found" and actuators > 1:
            with self._changed:
                self._search = WatchedSearch(responses.scene, responses.response.energy, self._scale, seconds)
            return
        if choice == "scene":
            phasors = scene_phasors(self.scene)
        elif choice == "random":
            rotations = np.exp(2j * math.pi * self._random.random(actuators))
            phasors = self._scale * self._random.random(actuators) * rotations
        elif choice == "exact":
            phasors = self._scale * responses.best_drive
        else:
            cases = reference_phasors(single_drives(self.scene), responses.response.energy)
            phasors = cases["equal" if choice == "equal" else "single"]
        self._drive_by(phasors)

    def _drive_by(self, phasors: np.ndarray) -> None:
        """Request a drive (actuators,) [N/m²], scaled into the sliders' range."""
        largest = np.abs(phasors).max()
        if largest > self.ranges.magnitude:
            phasors = phasors * (self.ranges.magnitude / largest)
        magnitude, phase = polar(phasors)
        self._request(magnitude=magnitude, phase=phase)


def _with(values: tuple[float, ...], index: int, value: float) -> tuple[float, ...]:
    return (*values[:index], float(value), *values[index + 1 :])


class WatchedSearch(threading.Thread):
    """A particle swarm in a thread, over all drives whatever the scene's ``[search]``; the constructor starts it.

    An iteration takes at least so many seconds, so that it can be seen. ``snapshot`` is the last one, None before the
    end of the first; it stays once the event ``ended`` has ended the search.
    """

    def __init__(
        self, scene: Scene, energies: Callable[[np.ndarray], np.ndarray], scale: float, seconds: float
    ) -> None:
        super().__init__(name="swarm", daemon=True)
        self._energies, self._scale, self._seconds = energies, scale, seconds
        self._factors, self._best = np.empty(0), list[float]()
        self.snapshot: SwarmSnapshot | None = None
        self.ended = threading.Event()
        space = parametrization_of(with_paper_search(scene)).space
        self._swarm = Swarm(space, swarm_settings(scene.search, scene.search.seed))
        self.start()

    def run(self) -> None:
        """Search, in the thread."""
        minimize(self._swarm, self._losses, self._after_iteration)

    def _losses(self, positions: np.ndarray) -> np.ndarray:
        self._factors = localization_factor(self._energies(self._scale * paper_phasors(positions)))
        return np.asarray(1 - self._factors)

    def _after_iteration(self, swarm: Swarm) -> bool:
        self._best.append(1 - swarm.result.fbest)
        best, drive = np.array(self._best), swarm.result.xbest
        self.snapshot = SwarmSnapshot(
            phasors=paper_phasors(swarm.positions),
            factors=self._factors,
            best=np.where(np.isfinite(best), best, np.nan),
            best_phasors=None if drive is None else paper_phasors(drive[None])[0],
            iterations=swarm.settings.iterations,
        )
        return self.ended.wait(self._seconds)
