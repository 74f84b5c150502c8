"""Plates in motion: the scene of a result is run again under its drives, and every frame is a time step of that run.

The run is bit-identical on the same device, so nothing is interpolated and results need not store frames. Scenes that
have no time steps are run by modes, with frames at the same times.
"""

import math
from collections.abc import Mapping, Sequence
from types import NoneType

import numpy as np

from warp_plate.modal.continuous_modes import continuous_modes
from warp_plate.plate.section import make_section
from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.weights import weigh_region
from warp_plate.resolve import Resolved, resolve
from warp_plate.result.case import Case, case_scene, only_actuator, target_cases
from warp_plate.result.model import Result
from warp_plate.result.motion import Motion, SteadyMotion
from warp_plate.scene.errors import SceneError, check_type, check_whole, numbers_of
from warp_plate.scene.grid import Record
from warp_plate.scene.model import Scene
from warp_plate.solve.run import Progress, Run

# Default frames of a period, and most default frames of a longer span.
FRAMES_A_PERIOD, MOST_FRAMES = 60, 600
# Most bytes of the recorded fields; large grids have fewer frames by default, but at least this number.
FIELDS_BYTES, FEWEST_FRAMES = 2 * 2**30, 24
# Frames of a period of the highest frequency below which a motion is not recognisable.
FEWEST_A_PERIOD = 12
# Displacements that a steady motion is fitted to.
SAMPLES = 12


def motion(
    result: Result,
    case: str | None = None,
    span: tuple[float, float] | None = None,
    frames: int | None = None,
    device: str = "auto",
) -> Motion:
    """Run a case of a result again and return its motion, with the fields of RMS velocity and phase.

    Args:
        result: Result of ``localize`` or ``simulate``.
        case: Name of a case (default: the best drive, or the only case).
        span: Start and end [s] (default: the last period of the drive, or the first burst or the window if the drive
            does not repeat).
        frames: Frames in the span (default: 60 a period).
        device: Device of the run.

    Raises:
        SceneError: Unknown case, or see :func:`motions`.
    """
    check_type("result", result, Result)
    check_type("case", case, str, NoneType)
    return motions(result.scene, result.select_cases([case or result.main_name]), span, frames, device)[0]


def period_around(result: Result, time: float) -> tuple[float, float]:
    """Return start and end [s] of the period, of the lowest frequency of all cases, that begins at or around a time.

    Raises:
        SceneError: The time is outside the run.
    """
    last = result.scene.window.end
    if not 0 <= time <= last:
        raise SceneError(f"time = {time:g}: must be from 0 to {last:g} s")
    period = min(1 / min(result.case_scene(case).drive.frequency for case in result.cases.values()), last)
    first = min(time, last - period)
    return first, first + period


def frame_at(motion: Motion, time: float) -> int:
    """Return the index of the frame nearest to a time; raise a SceneError if it is outside the motion's span."""
    first, last = motion.span
    if not first <= time <= last * (1 + 1e-9):
        raise SceneError(f"time = {time:g}: must lie between start and end, {first:g} and {last:g} s")
    return int(abs(motion.times - time).argmin())


def motions(
    scene: Scene,
    cases: Mapping[str, Case],
    span: tuple[float, float] | None = None,
    frames: int | None = None,
    device: str = "auto",
    progress: Progress | None = None,
) -> list[Motion]:
    """Return the motion of the plate under each drive, frame by frame.

    Args:
        scene: Scene of the result.
        cases: Drives and their localization factors, by the names of the motions.
        span: Start and end [s] (default: see :func:`usual_span`).
        frames: Frames in the span, at the steps nearest to even times, at most one for each step (default: 60 a period,
            of the highest frequency if the drive does not repeat, fewer for large grids, and at most 600).
        device: Device of the run.
        progress: See :meth:`PlateSolver.run`.

    Raises:
        SceneError: see :class:`PlateSolver`; the span is outside the run; or there are too few or too many frames.
    """
    if frames is not None:
        check_whole("frames", frames)
    if span is not None:
        start, stop = numbers_of("span", span, 2, "start and end in seconds")
        span = start, stop
    scene = scene.model_copy(update={"record": Record()})
    resolved = resolve(scene, device, purpose="replay")
    grid = resolved.grid
    scenes = {name: case_scene(scene, case) if case.per_actuator else scene for name, case in cases.items()}
    end = grid.steps * grid.time_step
    field_bytes = 8 * math.prod(scene.grid.nodes) * len(cases)
    first, last = _common_span(scenes, span, end, frames or _default_frames(math.inf, field_bytes))
    fastest = max(s.drive.frequency if s.nonperiodic_key is None else highest_frequency(s) for s in scenes.values())
    count = frames or _default_frames((last - first) * fastest, field_bytes)
    if count < 2 or 2 * count * field_bytes > FIELDS_BYTES:
        most = max(2, FIELDS_BYTES // (2 * field_bytes))
        raise SceneError(f"frames = {count}: must be from 2 to {most} for {len(cases)} plates of this grid")
    wanted = np.linspace(first, last, count, endpoint=False) / grid.time_step
    steps = np.unique(np.clip(np.rint(wanted).astype(int), 0, grid.steps - 1))
    if len(steps) < 2:
        raise SceneError(f"{first:g} ... {last:g} s: contains fewer than two steps of {grid.time_step:g} s")
    recorded = np.unique(np.concatenate([steps, steps + 1]))
    at, after = np.searchsorted(recorded, steps), np.searchsorted(recorded, steps + 1)
    times = (recorded * grid.time_step).tolist()
    fields = _displacements(resolved, scenes, cases, times, progress)
    return [
        Motion(
            name=name,
            frequency=scenes[name].drive.frequency,
            span=(first, last),
            times=steps * grid.time_step,
            displacement=fields[name][at].astype(np.float32),
            velocity=((fields[name][after] - fields[name][at]) / grid.time_step).astype(np.float32),
            surface_density=grid.surface_density,
            localization_factor=case.localization_factor,
            only_actuator=only_actuator(case, scene),
            scene=scenes[name] if case.per_actuator else None,
            target=_own_target(scene, name),
        )
        for name, case in cases.items()
    ]


def _own_target(scene: Scene, case: str) -> np.ndarray:
    """Return (ny, nx) weights of the target that a case is the best drive for, or of the first."""
    own = [target for target in scene.targets if target_cases(scene.targets)[target.name] == case]
    return weigh_region(scene, "target", own[0] if own else scene.target)


def _common_span(
    scenes: Mapping[str, Scene], span: tuple[float, float] | None, end: float, frames: int
) -> tuple[float, float]:
    """Return the span, by default the one that holds the usual spans of all scenes [s]."""
    spans = [span] if span is not None else [usual_span(scene, end, frames) for scene in scenes.values()]
    first, last = min(start for start, _ in spans), max(stop for _, stop in spans)
    longest = max(scene.window.end for scene in scenes.values())
    if 0 <= first < last <= longest * (1 + 1e-9):
        return first, last
    if span is None:
        period = 1 / min(scene.drive.frequency for scene in scenes.values())
        raise SceneError(f"window.end = {longest:g}: the run is shorter than a period of {period:g} s")
    raise SceneError(f"start = {first:g}, end = {last:g}: must lie within the run, which lasts from 0 to {end:g} s")


def _displacements(
    resolved: Resolved,
    scenes: Mapping[str, Scene],
    cases: Mapping[str, Case],
    times: Sequence[float],
    progress: Progress | None,
) -> dict[str, np.ndarray]:
    """Return (times, ny, nx) displacements [m] of the cases; equal scenes run together."""
    fields: dict[str, np.ndarray] = {}
    for first, scene in scenes.items():
        if first in fields:
            continue
        group = [name for name, other in scenes.items() if other == scene]
        solver = resolved.with_scene(resolved.scene if scene == resolved.scene else scene).solver()
        plate_steps, before = solver.node_steps_per_plate, len(fields)

        def on_progress(done: int, total: int, plate_steps: int = plate_steps, before: int = before) -> None:
            if progress is not None:
                progress(before * plate_steps + done, len(cases) * plate_steps)

        run = solver.run(np.array([cases[name].phasors for name in group]), times, progress=on_progress)
        fields |= dict(zip(group, run.displacement, strict=True))
    return fields


def usual_span(scene: Scene, end: float, frames: int) -> tuple[float, float]:
    """Return the start and end [s] of the span that is shown by default, of a run that ends at ``end`` [s].

    It is the last period of a drive that repeats, else the first burst or the scene's window, cut at the burst's end or
    the window's start if it is too long for 12 frames in each period of the highest frequency.
    """
    if scene.nonperiodic_key is None:
        return end - 1 / scene.drive.frequency, end
    longest = frames / FEWEST_A_PERIOD / highest_frequency(scene)
    burst = scene.drive.burst
    if burst is not None:
        return burst.start, min(burst.start + min(burst.duration, longest), end)
    return max(scene.window.start, end - longest), end


def mode_motions(scene: Scene, numbers: Sequence[int], frames: int = FRAMES_A_PERIOD) -> list[Motion]:
    """Return one period of the natural modes with these numbers, from 1 on, with a largest displacement of 1.

    Raises:
        SceneError: a number is below 1, or so many modes are not solved for.
    """
    if min(numbers) < 1:
        raise SceneError(f"mode {min(numbers)}: modes are counted from 1")
    modes = continuous_modes(scene, max(numbers), scene.grid.nodes)
    angle = 2 * math.pi * np.arange(frames)[:, None, None] / frames
    surface_density = make_section(scene).mass
    motions_of_modes = []
    for number in numbers:
        frequency, shape = float(modes.frequencies[number - 1]), modes.shapes[number - 1]
        period = 1 / frequency if frequency > 0 else 1.0
        motions_of_modes.append(
            Motion(
                name=f"mode {number}, {frequency:.4g} Hz",
                frequency=frequency,
                span=(0.0, period),
                times=np.arange(frames) * period / frames,
                displacement=(np.cos(angle) * shape).astype(np.float32),
                velocity=(-2 * math.pi * frequency * np.sin(angle) * shape).astype(np.float32),
                surface_density=surface_density,
            )
        )
    return motions_of_modes


def last_period(scene: Scene, time_step: float) -> list[float]:
    """Return times [s] spread evenly over the last period of the drive, at least a time step apart if possible."""
    end = math.floor(scene.window.end / time_step) * time_step
    span = min(max(1 / scene.drive.frequency, SAMPLES * time_step), end)
    times: list[float] = (end - span * np.arange(SAMPLES) / SAMPLES).tolist()
    return times


def steady_motions(run: Run, scene: Scene) -> list[SteadyMotion]:
    """Fit the motion of each plate of a run at the drive's frequency, by least squares.

    A straight line in time is fitted besides, which takes up the slow decay of low modes.
    """
    angles = scene.drive.angular_frequency * run.times[:, None]
    drift = np.stack([np.ones(run.times.size), run.times / run.times.max() - 1], axis=1)
    columns = np.concatenate([np.cos(angles), -np.sin(angles), drift], axis=1)
    fields = run.displacement
    parts = np.tensordot(np.linalg.pinv(columns), fields, (1, 1)).swapaxes(0, 1)[:, :2]
    rest = fields - np.tensordot(columns[:, :2], parts, (1, 1)).swapaxes(0, 1)
    all_squares, rest_squares = ((field**2).sum(axis=(1, 2, 3)) for field in (fields, rest))
    residuals = np.sqrt(rest_squares / np.where(all_squares > 0, all_squares, 1))
    amplitudes = parts[:, 0] + 1j * parts[:, 1]
    return [SteadyMotion(*pair) for pair in zip(amplitudes, residuals.tolist(), strict=True)]


def _default_frames(periods: float, field_bytes: int) -> int:
    wanted = math.ceil(min(MOST_FRAMES, FRAMES_A_PERIOD * max(1.0, periods) - 1e-6))
    return min(wanted, max(FEWEST_FRAMES, FIELDS_BYTES // 4 // (2 * field_bytes)))
