"""Plates in motion from a result: its scene is run once more under its drives, and every frame is a step of that run.

A result keeps the few displacements that its scene records; what a movie needs is computed again when it is wanted. The
run is the same to the last bit on the same device, so nothing is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from warp_plate.plate.bending import make_bending
from warp_plate.plate.modes import natural_modes
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import highest_frequency
from warp_plate.result.model import Case, case_scene
from warp_plate.result.motion import Motion
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Record, Scene
from warp_plate.solve.solver import PlateSolver, Progress

# Frames of a period, if it has so many steps, and of a longer span at most.
A_PERIOD, MOST = 60, 600
# What the recorded fields may take; by default there are fewer frames of large grids, but not fewer than these.
MOST_BYTES, FEWEST = 2 * 2**30, 24
# Frames of a period of the highest frequency below which a motion is no longer seen as one.
LEAST_A_PERIOD = 12


def motions(
    scene: Scene,
    cases: Mapping[str, Case],
    span: tuple[float, float] | None = None,
    frames: int | None = None,
    device: str = "auto",
    progress: Progress | None = None,
) -> list[Motion]:
    """The plate under each drive, frame by frame.

    Args:
        scene: of the result. cases: drives and their localization factors; their names become the motions'.
        span: beginning and end [s]; left out: see :func:`usual_span`.
        frames: in the span, at the steps nearest to even times, so at most as many as there are steps; left out: 60 a
            period (of the highest frequency, where the drive does not repeat), fewer for large grids, and not more
            than 600.
        progress: see :meth:`PlateSolver.run`.

    Raises:
        SceneError: see :class:`PlateSolver`; a span outside the run; too few frames or steps, or too many bytes.
    """
    scheme = make_scheme(scene)
    scenes = {name: case_scene(scene, case) for name, case in cases.items()}
    end = scheme.steps * scheme.time_step
    field = 8 * math.prod(scheme.nodes) * len(cases)
    most = frames or _frames(math.inf, field)
    spans = [span] if span else [usual_span(one, end, most) for one in scenes.values()]
    first, last = min(one[0] for one in spans), max(one[1] for one in spans)
    if not 0 <= first < last <= scene.window.end * (1 + 1e-9):
        if span is None:
            period = 1 / min(one.drive.frequency for one in scenes.values())
            raise SceneError(f"window.end = {scene.window.end:g}: the run is shorter than a period of {period:g} s")
        raise SceneError(f"start = {first:g}, end = {last:g}: must lie inside the run, which goes from 0 to {end:g} s")
    fastest = max(
        one.drive.frequency if one.nonperiodic_key is None else highest_frequency(one) for one in scenes.values()
    )
    count = frames or _frames((last - first) * fastest, field)
    if count < 2 or 2 * count * field > MOST_BYTES:
        most = max(2, MOST_BYTES // (2 * field))
        raise SceneError(f"frames = {count}: must be from 2 to {most} for {len(cases)} plates of this grid")
    wanted = np.linspace(first, last, count, endpoint=False) / scheme.time_step
    steps = np.unique(np.clip(np.rint(wanted).astype(int), 0, scheme.steps - 1))
    if len(steps) < 2:
        raise SceneError(f"{first:g} ... {last:g} s: holds less than two steps of {scheme.time_step:g} s")
    recorded = np.unique(np.concatenate([steps, steps + 1]))
    at, after = np.searchsorted(recorded, steps), np.searchsorted(recorded, steps + 1)
    fields = _fields(scenes, cases, (recorded * scheme.time_step).tolist(), device, progress)
    mass = surface_density(scene)
    return [
        Motion(
            name=name,
            frequency=scenes[name].drive.frequency,
            span=(first, last),
            times=steps * scheme.time_step,
            displacement=fields[name][at].astype(np.float32),
            velocity=((fields[name][after] - fields[name][at]) / scheme.time_step).astype(np.float32),
            surface_density=mass,
            localization_factor=case.localization_factor,
            scene=scenes[name] if case.per_actuator else None,
        )
        for name, case in cases.items()
    ]


def _fields(
    scenes: Mapping[str, Scene],
    cases: Mapping[str, Case],
    times: Sequence[float],
    device: str,
    progress: Progress | None,
) -> dict[str, np.ndarray]:
    """(times, ny, nx) displacements [m] of the cases; those of one scene run together."""
    alike: dict[int, list[str]] = {}
    for name, scene in scenes.items():
        first = next(other for other in scenes if scenes[other] == scene)
        alike.setdefault(list(scenes).index(first), []).append(name)
    fields: dict[str, np.ndarray] = {}
    for names in alike.values():
        solver = PlateSolver(scenes[names[0]].model_copy(update={"record": Record()}), device)
        each, before = solver.node_steps_per_plate, len(fields)

        def told(done: int, total: int, each: int = each, before: int = before) -> None:
            if progress is not None:
                progress(before * each + done, len(cases) * each)

        run = solver.run(np.array([cases[name].phasors for name in names]), times, progress=told)
        fields |= dict(zip(names, run.displacement, strict=True))
    return fields


def usual_span(scene: Scene, end: float, frames: int) -> tuple[float, float]:
    """What is shown of a run where no span is asked for: beginning and end [s].

    The last period of a drive that repeats; else the first burst, where there are bursts; else the scene's window. Of a
    burst only the beginning and of a window only the end, where ``frames`` would be less than 12 a period of the
    highest frequency. ``end``: of the run [s].
    """
    if scene.nonperiodic_key is None:
        return end - 1 / scene.drive.frequency, end
    longest = frames / LEAST_A_PERIOD / highest_frequency(scene)
    burst = scene.drive.burst
    if burst is not None:
        return burst.start, min(burst.start + min(burst.duration, longest), end)
    return max(scene.window.start, end - longest), end


def mode_motions(scene: Scene, numbers: Sequence[int], frames: int = A_PERIOD) -> list[Motion]:
    """The natural shapes with these numbers, from 1 on, each over one period of its own; the largest height is 1.

    Raises:
        SceneError: a number below 1, or one that the grid has no mode for.
    """
    if min(numbers) < 1:
        raise SceneError(f"mode {min(numbers)}: modes are counted from 1")
    found = natural_modes(scene, max(numbers))
    if max(numbers) > len(found.frequencies):
        raise SceneError(f"mode {max(numbers)}: the grid has {len(found.frequencies)}")
    turn = 2 * math.pi * np.arange(frames)[:, None, None] / frames
    mass = surface_density(scene)
    made = []
    for number in numbers:
        frequency, shape = float(found.frequencies[number - 1]), found.shapes[number - 1]
        period = 1 / frequency if frequency > 0 else 1.0
        made.append(
            Motion(
                name=f"mode {number}, {frequency:.4g} Hz",
                frequency=frequency,
                span=(0.0, period),
                times=np.arange(frames) * period / frames,
                displacement=(np.cos(turn) * shape).astype(np.float32),
                velocity=(-2 * math.pi * frequency * np.sin(turn) * shape).astype(np.float32),
                surface_density=mass,
            )
        )
    return made


def surface_density(scene: Scene) -> np.ndarray:
    """(ny, nx) mass of plate and layers per area [kg/m²]."""
    return make_bending(scene).mass


def _frames(periods: float, field: int) -> int:
    """How many frames suit a span of so many periods and fields of so many bytes."""
    wanted = math.ceil(min(MOST, A_PERIOD * max(1.0, periods) - 1e-6))
    return min(wanted, max(FEWEST, MOST_BYTES // 4 // (2 * field)))
