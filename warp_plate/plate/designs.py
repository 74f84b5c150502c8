"""What may differ from plate to plate in one batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from warp_plate.plate.signals import actuator_delays, actuator_frequencies, waves_apart
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Area, Scene

# An actuator may reach over the border of its area by so much of the plate's side: rounding.
SLACK = 1e-9


@dataclass(frozen=True)
class Designs:
    """Drives and, where they are not the scene's, what else each plate has of its own; None: as the scene has it.

    drives: (plates, actuators) complex phasors Z [N/m², or V: ``Scene.drive_unit``]; frequency: (plates, actuators)
    [Hz]; centre: (plates, actuators, 2) x, y of the actuators' middles [m]; delay: (plates, actuators) start of the
    burst [s].
    """

    drives: np.ndarray
    frequency: np.ndarray | None = None
    centre: np.ndarray | None = None
    delay: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.drives)

    def __getitem__(self, some: slice) -> Designs:
        own = (None if values is None else values[some] for values in (self.frequency, self.centre, self.delay))
        return Designs(self.drives[some], *own)

    @property
    def only_drives(self) -> bool:
        """Whether plates differ in nothing but their drives, so that superposition holds between them."""
        return self.frequency is None and self.centre is None and self.delay is None


@runtime_checkable
class Batch(Protocol):
    """Designs, or what makes some of them when they are asked for: a solver takes part after part."""

    def __len__(self) -> int: ...

    def __getitem__(self, some: slice) -> Designs: ...

    @property
    def only_drives(self) -> bool:
        """See :class:`Designs`."""
        ...


@runtime_checkable
class Shorthand(Batch, Protocol):
    """A batch whose designs any process makes of fewer numbers, a row for each plate, for this scene.

    maker: "module:function"; the function takes the scene and gives what makes a batch of such rows.
    """

    maker: str

    @property
    def scene(self) -> Scene:
        """For which they are designs."""
        ...

    def numbers(self, some: slice) -> np.ndarray:
        """(plates, numbers) of some plates."""
        ...


@dataclass(frozen=True)
class PerPlate:
    """What the plates of a solver may have of their own beside their drives: it is compiled for that.

    frequency, delay, centre: whether ``Designs`` may bring it. each: frequency and delay differ from actuator to
    actuator, which takes two waves for each of them and the general way; else one value serves all actuators of a
    plate. areas: (x0, x1, y0, y1) [m] for every actuator, in which it stays whole; None: the plate.
    """

    frequency: bool = False
    delay: bool = False
    centre: bool = False
    per_actuator: bool = False
    areas: tuple[Area, ...] | None = None


NO_PER_PLATE = PerPlate()


def per_plate_of(scene: Scene) -> PerPlate:
    """What plates need of their own for the free variables of ``[search]``."""
    search = scene.search
    free, areas = search.position, None
    if free is not None:
        kept = {one.name for one in scene.actuators} - set(free.actuators or [one.name for one in scene.actuators])
        whole = free.area or (0.0, scene.plate.size[0], 0.0, scene.plate.size[1])
        areas = tuple(one.area if one.name in kept else whole for one in scene.actuators)
    apart = [one for one in (search.frequency, search.delay) if one is not None]
    return PerPlate(
        frequency=search.frequency is not None,
        delay=search.delay is not None,
        centre=free is not None,
        per_actuator=any(one.own or one.actuators is not None for one in apart),
        areas=areas,
    )


def carriers_of(scene: Scene, per_plate: PerPlate) -> int:
    """How many carriers each plate has of its own: none, one, or one for each actuator.

    Raises:
        SceneError: the scene has no carrier or no burst that could differ, or a load that cannot be moved.
    """
    if per_plate.centre and scene.grid.load == "nodes":
        raise SceneError(
            'grid.load = "nodes": actuators would jump from node to node; to move them write "overlap" or "moments"'
        )
    if per_plate.areas is not None and len(per_plate.areas) != len(scene.actuators):
        raise SceneError(f"per_plate.areas: {len(per_plate.areas)} instead of {len(scene.actuators)}, one an actuator")
    if per_plate.delay and scene.drive.burst is None:
        raise SceneError("drive.burst: missing; a delay of its own needs a burst that is delayed")
    if not (per_plate.frequency or per_plate.delay):
        return 0
    if scene.drive.signal is not None:
        raise SceneError("drive.signal: a file has no frequency or burst that differs from plate to plate; delete it")
    return len(scene.actuators) if per_plate.per_actuator or waves_apart(scene) > 1 else 1


@dataclass(frozen=True)
class PerPlateValues:
    """Designs made ready: frequency and delay (plates, carriers), edges (plates, actuators, 4) x0, x1, y0, y1 [m];
    None where the plates share the scene's."""

    frequency: np.ndarray | None
    delay: np.ndarray | None
    edges: np.ndarray | None

    def __getitem__(self, some: slice) -> PerPlateValues:
        return PerPlateValues(*(None if one is None else one[some] for one in (self.frequency, self.delay, self.edges)))


def check_designs(designs: Designs, scene: Scene, per_plate: PerPlate, time_step: float) -> PerPlateValues:
    """What a solver made for ``own`` needs of designs.

    Raises:
        SceneError: they bring what the solver was not made for, arrays of another shape, values that differ between
            actuators that share them, a frequency that the steps cannot carry, a delay outside the run, or a place
            outside an actuator's area; one line with plate and actuator.
    """
    shape = (len(designs), len(scene.actuators))
    given: dict[str, np.ndarray] = {}
    for name, more in (("frequency", ()), ("delay", ()), ("centre", (2,))):
        values = getattr(designs, name)
        if values is None:
            continue
        if not getattr(per_plate, name):
            raise SceneError(f"designs.{name}: not enabled for this solver; make it with PerPlate({name}=True)")
        given[name] = np.asarray(values, dtype=float)
        if given[name].shape != (*shape, *more):
            raise SceneError(f"designs.{name}: shape {given[name].shape} instead of {(*shape, *more)}")
    frequency, delay = given.get("frequency"), given.get("delay")
    if frequency is not None or delay is not None:
        if frequency is None:
            frequency = np.broadcast_to(actuator_frequencies(scene), shape)
        if delay is None and scene.drive.burst is not None:
            delay = np.broadcast_to(actuator_delays(scene), shape)
        square = 1 if scene.drive.electrostatic is None else 2
        most = 0.5 / time_step / square
        _refuse(scene, "frequency", frequency, np.asarray((frequency > 0) & (frequency < most)), f"0 ... {most:.6g} Hz")
        if delay is not None:
            end = scene.window.end
            _refuse(scene, "delay", delay, np.asarray((delay >= 0) & (delay < end)), f"0 ... {end:g} s")
        if carriers_of(scene, per_plate) == 1:
            for name, values in (("frequency", frequency), ("delay", delay)):
                if values is not None:
                    right = "one value for all actuators, or a solver with PerPlate(per_actuator=True)"
                    _refuse(scene, name, values, values == values[:, :1], right)
            frequency, delay = frequency[:, :1], None if delay is None else delay[:, :1]
    return PerPlateValues(frequency, delay, _edges(scene, per_plate, given["centre"]) if "centre" in given else None)


def actuator_spaces(scene: Scene, per_plate: PerPlate) -> np.ndarray:
    """(actuators, 4) x0, x1, y0, y1 [m] within which, and on the plate, each actuator stays whole."""
    plate = (0.0, scene.plate.size[0], 0.0, scene.plate.size[1])
    spaces = np.array(per_plate.areas if per_plate.areas is not None else [plate] * len(scene.actuators))
    return np.clip(spaces, 0, np.repeat(scene.plate.size, 2))


def _edges(scene: Scene, per_plate: PerPlate, centre: np.ndarray) -> np.ndarray:
    """(plates, actuators, 4) the rectangles of actuators in other places."""
    areas = np.array([actuator.area for actuator in scene.actuators])
    half = np.stack([areas[:, 1] - areas[:, 0], areas[:, 3] - areas[:, 2]], axis=1) / 2
    low, high = centre - half, centre + half
    spaces, slack = actuator_spaces(scene, per_plate), SLACK * np.array(scene.plate.size)
    inside: Any = ((low >= spaces[:, [0, 2]] - slack) & (high <= spaces[:, [1, 3]] + slack)).all(axis=-1)
    _refuse(scene, "centre", centre, inside, "a place where the actuator stays whole within its area")
    return np.stack([low[..., 0], high[..., 0], low[..., 1], high[..., 1]], axis=-1)


def _refuse(scene: Scene, name: str, values: np.ndarray, good: np.ndarray | np.bool_, right: str) -> None:
    if not good.all():
        plate, actuator = np.argwhere(~good)[0]
        raise SceneError(
            f"designs.{name}: {np.round(values[plate, actuator], 9).tolist()} of actuator "
            f"{scene.actuators[actuator].name!r} on plate {plate}; must be {right}"
        )


def as_phasors(drives: object, actuators: int) -> np.ndarray:
    """(plates, actuators) complex phasors from phasors or (magnitude, phase).

    Raises:
        SceneError: another shape, or not numbers.
    """
    try:
        if isinstance(drives, tuple) and len(drives) == 2:
            magnitude, phase = (as_numbers(part, "biuf") for part in drives)
            with np.errstate(invalid="ignore"):  # a drive that is not finite harms its own plate alone
                phasors = magnitude * np.exp(-1j * phase)
        else:
            phasors = as_numbers(drives, "biufc").astype(complex, copy=False)
    except (TypeError, ValueError) as error:
        raise SceneError(f"drives: not an array of numbers ({error})") from None
    if phasors.ndim != 2 or phasors.shape[1] != actuators:
        raise SceneError(f"drives: shape {phasors.shape} instead of (plates, {actuators}), one column an actuator")
    return phasors


def as_numbers(values: object, kinds: str) -> np.ndarray:
    """As an array, of one of NumPy's kinds: nothing is read out of texts or dates, and nothing masked is taken."""
    array = np.asarray(values)
    if array.size and (array.dtype.kind not in kinds or np.ma.is_masked(values)):
        raise TypeError(f"{array.dtype}{', masked' if np.ma.is_masked(values) else ''}")
    return array
