"""``warp-plate plan-measurement SCENE``: where to put sensors before a measurement."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from rich.console import Console

    from warp_plate.fitting.plan_measurement import MeasurementPlan

HEADING = "# Planned by warp-plate"


def plan_measurement(
    scene: options.SceneName,
    /,
    *,
    sensors: options.Count = 4,
    noise: float = 0.02,
    assignments: options.Assignments = None,
    out: Path | None = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Plan a measurement: choose the actuator and the sensor places that best determine the keys of [fit.free].

    The plan is D-optimal: it minimises the product of the widths of all intervals. The scene is written with a table
    [[measurement]] for each sensor, ready for warp-plate fit.

    Parameters
    ----------
    sensors
        Number of accelerometers.
    noise
        Standard deviation of measured responses relative to each, such as 0.02.
    out
        The scene with the plan (.toml; default: SCENE.plan.toml in this folder).
    """
    if not 1e-9 <= noise <= 1:
        raise SceneError(f"--noise {noise:g}: must be from 1e-9 to 1, such as 0.02")
    target = output.output_file(out, f"{Path(scene).stem}.plan.toml", (), HEADING, force)
    loaded, scene = output.load_scene(scene, assignments)
    from warp_plate.fitting.plan_measurement import plan_measurement
    from warp_plate.result.atomic_io import atomic_paths

    if loaded.folder is not None and loaded.folder.resolve() != target.parent.resolve():
        raise SceneError(f"--out {target}: the scene names files in {loaded.folder}; write the plan there")
    with output.scene_errors(scene):
        found = plan_measurement(loaded, sensors, noise)
    with atomic_paths(target) as (temporary,):
        temporary.write_text(f"{HEADING}\n{found.scene.to_toml()}", encoding="utf-8")
    output.report(json, partial(_as_json, found), partial(_print, scene, found), ([target], None))


def _as_json(found: MeasurementPlan) -> dict[str, object]:
    rows = zip(found.keys, found.values, found.low, found.high, strict=True)
    return {
        **output.attributes(found, "actuator", "points"),
        "range": found.frequencies[[0, -1]],
        "parameters": {key: dict(zip(("value", "low", "high"), row, strict=True)) for key, *row in rows},
        **output.attributes(found, "random", "actuators"),
    }


def _print(name: str, found: MeasurementPlan, console: Console) -> None:
    from warp_plate.scene.keys import unit_of

    low, high = found.frequencies[[0, -1]]
    console.print(f"{found.scene.title or name}: drive {found.actuator!r} from {low:.4g} to {high:.4g} Hz\n")
    places = output.table("sensor", "x (m)", "y (m)")
    for number, (x, y) in enumerate(found.points, 1):
        places.add_row(str(number), f"{x:.4g}", f"{y:.4g}")
    output.print_uncropped(console, places)
    console.print()
    made = output.table("number", "unit", "value", "95 % from", "to")
    for key, *numbers in zip(found.keys, found.values, found.low, found.high, strict=True):
        made.add_row(key, unit_of(found.scene, key), *(output.number_text(value, ".5g") for value in numbers))
    output.print_uncropped(console, made)
    console.print(f"\nRandom places: intervals {found.random:.3g} times as wide.")
    for other, times in found.actuators.items():
        console.print(f"Driving {other!r}: {times:.3g} times as wide.")
