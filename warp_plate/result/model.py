"""The plain data of a result, free of any file format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from warp_plate.plate.scene_overrides import scene_with
from warp_plate.result.robust import RobustComparison
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Objective

BoundKind = Literal["", "attained", "attained within limits", "bound only"]
# What a bound is, for people.
BOUND_DESCRIPTIONS: dict[BoundKind, str] = {
    "": "bound",
    "attained": "bound: no drive passes it",
    "attained within limits": "bound of the drives that may be chosen",
    "bound only": "bound only: the drives that may be chosen need not reach it",
}


def bound_kind(text: str) -> BoundKind:
    """The kind that a file names.

    Raises:
        SceneError: there is no such kind.
    """
    for kind in BOUND_DESCRIPTIONS:
        if kind == text:
            return kind
    raise SceneError(f"bound_kind is {text!r}")


@dataclass(frozen=True)
class Case:
    """One drive and what the plate did under it.

    drive: (actuators,) complex phasors Z [N/m², or V: ``Scene.drive_unit``]; the load is Re(Z exp(iωt)) or what the
        scene makes of Z, so magnitude |Z| and phase lag −arg Z.
    energy: kinetic energy averaged over the window [J], for each region by name.
    displacement: (times, ny, nx) [m].
    trace: (points, steps) displacement [m].
    status: "ok", or why the plate has no energies (NaN): what was wrong with its drive, or when it grew without bound.
    frequency, delay: (actuators,) frequencies [Hz] and burst starts [s]; centre: (actuators, 2) x, y of the actuators'
        middles [m]; None where they are the scene's.
    """

    phasors: np.ndarray
    energy: Mapping[str, float]
    displacement: np.ndarray
    trace: np.ndarray
    status: str = "ok"
    frequency: np.ndarray | None = None
    centre: np.ndarray | None = None
    delay: np.ndarray | None = None

    @property
    def localization_factor(self) -> float:
        """Share of the plate's kinetic energy in the target; equation (5) of the source paper."""
        return self.energy["target"] / self.energy["plate"] if self.energy["plate"] > 0 else float("nan")

    @property
    def magnitude(self) -> np.ndarray:
        """(actuators,) magnitudes w, in the unit of ``drive``."""
        return np.abs(self.phasors)

    @property
    def phase(self) -> np.ndarray:
        """(actuators,) phase lags φ [rad], 0 ≤ φ < 2π; 0 where the magnitude is 0."""
        return np.where(self.phasors == 0, 0.0, np.mod(-np.angle(self.phasors), 2 * np.pi))


    @property
    def per_actuator(self) -> dict[str, np.ndarray]:
        """(actuators,) by headings for people, what is not the scene's."""
        x, y = (None, None) if self.centre is None else self.centre.T
        found = {"frequency (Hz)": self.frequency, "x (m)": x, "y (m)": y, "burst from (s)": self.delay}
        return {heading: values for heading, values in found.items() if values is not None}


def case_scene(scene: Scene, case: Case) -> Scene:
    """The scene of a result with a case's frequencies, places and burst starts; itself where it has none."""
    if not case.per_actuator:
        return scene
    return scene_with(scene, None, None, case.frequency, case.centre, case.delay)


@dataclass(frozen=True)
class TargetSearch:
    """The search for one target.

    position: (dimension,) the best one in the search's space; None where one actuator leaves no choice, or none had
    energies. single: index of the best single actuator; bound, bound_kind, history, values: as in
    :class:`Result`; evaluations: plates.
    """

    position: np.ndarray | None
    single_actuator: int
    bound: float | None
    bound_kind: BoundKind
    evaluations: int
    history: Mapping[str, np.ndarray]
    objective_values: Mapping[str, float]


@dataclass(frozen=True)
class Result:
    """Everything that ``localize`` or ``simulate`` found, with all that is needed to run it again.

    cases: by name; ``localize`` has "equal", "single" and "best", ``simulate`` has "drive".
    times: (times,) of the displacements [s]; trace_times: (steps,) of the traces [s].
    bound: largest localization factor that any drive can reach; None where none is claimed. bound_kind: how near a
        drive comes to it, or to that of the values' sum: a key of BOUND_DESCRIPTIONS.
    history: for each iteration of the search, arrays "evaluations", "best", "mean": localization factors, or weighted
        sums of what else is sought.
    values: where more than the localization factor is sought, what the best drive is worth: by the objectives' kinds,
        of velocity and displacement also that "of the rest"; their weighted "sum", and its "bound" where one is known
        and the limits on the rest are kept.
    worth: the same, without a bound, of other cases at the scene's own frequency and places, by their names.
    seconds: "compile" and "solve", and "choose" and "estimate" where these were done.
    accuracy: what is known of the result's errors, of numbers and texts only: "asked" and "reason" where the scene
        asked for an accuracy instead of a grid, "estimate" of the localization factors.
    node_steps: nodes updated × steps × plates. path: how plates were stepped.
    peak: largest displacement [m] seen over the run under the drive of ``judged``; None where nothing was looked at.
    spectrum: of a search for a frequency, over the "frequency" [Hz] of its range, the localization factors "equal",
        "single" and "best" (which no drive that may be chosen passes), and the "resonances" [Hz] in it; empty where
        none was made.
    several: of a scene with several targets, the search for each that was come to; ``bound`` and ``history`` are the
        first's. Cases: see ``result.crosstalk``.
    robust: of a robust search, its drive and the "nominal" one, a case too, over fresh scenarios.
    lost: plates of the search that counted as worst because their workers failed for good, by what went wrong.
    """

    command: str
    source: str
    scene: Scene
    device: str
    seed: int
    effects: tuple[str, ...]
    cases: Mapping[str, Case]
    times: np.ndarray
    trace_times: np.ndarray
    seconds: Mapping[str, float]
    node_steps: int
    evaluations: int = 0
    bound: float | None = None
    bound_kind: BoundKind = ""
    history: Mapping[str, np.ndarray] = field(default_factory=dict)
    objective_values: Mapping[str, float] = field(default_factory=dict)
    objective_values_by_case: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    evaluator: str = "direct"
    path: str = ""
    interrupted: bool = False
    versions: Mapping[str, str] = field(default_factory=dict)
    accuracy: Mapping[str, Any] = field(default_factory=dict)
    peak_displacement: float | None = None
    spectrum: Mapping[str, np.ndarray] = field(default_factory=dict)
    target_searches: tuple[TargetSearch, ...] = ()
    robust: RobustComparison | None = None
    lost_plates: Mapping[str, int] = field(default_factory=dict)

    def case_scene(self, case: Case) -> Scene:
        """The scene with a case's frequencies, places and burst starts."""
        return case_scene(self.scene, case)

    def driven_scene(self, case: Case) -> Scene:
        """The scene that ``simulate`` runs as this case: ``placed``, and with its drive.

        Raises:
            SceneError: a magnitude beyond what a scene may have.
        """
        return scene_with(self.case_scene(case), case.magnitude, case.phase)

    @property
    def bound_description(self) -> str:
        """What the bound is, for people."""
        return BOUND_DESCRIPTIONS[self.bound_kind]

    @property
    def only_localization(self) -> bool:
        """Whether the localization factor is all that was sought."""
        return self.scene.search.objectives == (Objective(),)

    @property
    def main_case(self) -> Case:
        """The case that the result is about: the best drive found, or the one that was asked for."""
        return self.cases.get("best") or next(iter(self.cases.values()))

    @property
    def x(self) -> np.ndarray:
        """(nx,) positions of the nodes [m]."""
        return np.linspace(0, self.scene.plate.size[0], self.scene.grid.nodes[0])

    @property
    def y(self) -> np.ndarray:
        """(ny,) positions of the nodes [m]."""
        return np.linspace(0, self.scene.plate.size[1], self.scene.grid.nodes[1])
