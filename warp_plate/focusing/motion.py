"""Plates in motion around the moment of their focus, for pictures and movies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warp_plate.focusing.responses import HeldResponses
from warp_plate.result.focus import FocusResult
from warp_plate.result.motion import Motion
from warp_plate.scene.errors import SceneError

# Points of a picture between two lines of the plate's splines; periods of the highest frequency that are shown on both
# sides of a pulse; frames, and most bytes of them.
POINTS, PERIODS, FRAMES, MOST_BYTES = 2, 10, 60, 2**30


def focus_motions(
    result: FocusResult, methods: Sequence[str] = (), span: tuple[float, float] | None = None, frames: int = FRAMES
) -> list[Motion]:
    """Return the motion of the plate under the waveforms of methods (default: all) for the first point, over its
    largest displacement, which is in the name.

    Frames are at the samples nearest to even times, one of them at the moment, in a span from start to end [s]
    (default: ten periods of ``focus.highest`` around the moment, or the burst).

    Raises:
        SceneError: A method is unknown, or the span holds fewer than two samples or lies outside the responses.
    """
    table, names = result.scene.focus, list(methods or result.methods)
    assert table is not None
    if unknown := [name for name in names if name not in result.methods]:
        raise SceneError(f"case {unknown[0]}: there are {', '.join(result.methods)}")
    recorded, moment = result.times.size, table.moment
    responses = HeldResponses.of_scene(result.scene, recorded, velocity=False)
    plate = responses.plate
    x, y = (
        np.linspace(0, side, POINTS * count + 1)
        for side, count in zip(result.scene.plate.size, plate.space.shape[::-1], strict=True)
    )
    if result.wished is not None:
        moment = int(np.abs(result.wished[0]).argmax())
    steps = _samples(table.rate, recorded, moment, span or _usual_span(result), frames)
    if (size := 8 * len(names) * steps.size * x.size * y.size) > MOST_BYTES:
        raise SceneError(f"frames = {steps.size}: take {size} bytes; at most {MOST_BYTES} are possible")
    played = np.stack([result.methods[name].waveforms[0] for name in names])
    pressures = np.pad(played, ((0, 0), (0, 0), (0, recorded - played.shape[2])))
    states, fields = responses.states(pressures[..., : steps[0] + 1]), []
    for sample in range(steps[0], steps[-1] + 1):
        if sample > steps[0]:
            states = responses.next_states(states, pressures[..., sample])
        if sample in steps:
            both = [plate.displacement(responses.amplitudes(states, rates), x, y) for rates in (False, True)]
            fields.append(np.stack(both).astype(np.float32))
    displacement, velocity = np.stack(fields, axis=2)
    largest = [float(np.abs(field).max()) or 1.0 for field in displacement]
    mass = plate.space.density(x, y)
    return [
        Motion(
            name=f"{name.replace('_', ' ')}: {_length(largest[index])}",
            frequency=table.burst.frequency if table.burst else (table.lowest + table.highest) / 2,
            span=(float(steps[0] + 1) / table.rate, float(steps[-1] + 2) / table.rate),
            times=(steps + 1) / table.rate,
            displacement=displacement[index] / largest[index],
            velocity=velocity[index] / largest[index],
            surface_density=mass,
        )
        for index, name in enumerate(names)
    ]


def _length(value: float) -> str:
    """Return a displacement [m] in nanometres or micrometres."""
    return f"{1e6 * value:.3g} µm" if value >= 1e-6 else f"{1e9 * value:.3g} nm"


def _usual_span(result: FocusResult) -> tuple[float, float]:
    table, end = result.scene.focus, float(result.times[-1])
    assert table is not None
    if result.wished is not None:
        return 0.0, end
    half = PERIODS / table.highest if table.burst is None else table.burst.half
    return max(table.time - half, 0.0), min(table.time + half, end)


def _samples(rate: int, recorded: int, moment: int, span: tuple[float, float], frames: int) -> np.ndarray:
    """Return the indices of the samples at the ends of which there are frames, including the moment of the focus."""
    if not 0 <= span[0] < span[1] <= recorded / rate * (1 + 1e-9):
        end = recorded / rate
        raise SceneError(f"start = {span[0]:g}, end = {span[1]:g}: must lie within the motion, from 0 to {end:g} s")
    wanted = np.rint(np.linspace(*span, frames) * rate).astype(int) - 1
    steps = np.unique(np.clip(wanted, 0, recorded - 1))
    if steps[0] < moment < steps[-1]:
        steps[np.abs(steps - moment).argmin()] = moment
    if steps.size < 2:
        raise SceneError(f"{span[0]:g} ... {span[1]:g} s: contains fewer than two samples at {rate} Hz")
    return steps
