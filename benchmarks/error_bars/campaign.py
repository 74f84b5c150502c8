"""Rows of the campaign: printed error bars of a random scene beside the truth."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from error_bars.judge import true_factors
from error_bars.nonlinear import true_nonlinear_factor
from error_bars.scenes import INHOMOGENEOUS, random_grid, random_nonlinear_scene, random_scene
from warp_plate import Scene, SceneError
from warp_plate.studies.simulate import simulate

# Relative error of the judge, and the largest of a judge who is heard.
JUDGE, UNSURE = 1e-4, 5e-3
# Accuracies below this are not asked of time steps, which would take hours.
LEAST_BY_STEPS = 0.01
# Degree of the elements of plates with layers and maps.
INHOMOGENEOUS_DEGREE = 7


def measured(number: int, promises: Sequence[float] = (), judge_by: Callable = true_factors) -> list[dict]:
    """Return a row for each engine, and for each accuracy that is asked for, with time steps and without."""
    try:
        scene, names = random_scene(number)
        phasors = np.array([[a.magnitude * np.exp(-1j * a.phase) for a in scene.actuators]])
        truth, judge = float(judge_by(scene, phasors)[0]), JUDGE
        if set(names) & set(INHOMOGENEOUS):  # of more elements, and corners at which moments are singular
            truth, coarse = (
                float(judge_by(scene, phasors, each)[0]) for each in (INHOMOGENEOUS_DEGREE, INHOMOGENEOUS_DEGREE - 1)
            )
            judge += abs(coarse / truth - 1)
    except SceneError as error:
        print(f"{number:4d} no scene: {error}", flush=True)
        return []
    engines = {"steps": (random_grid(scene, number), "auto"), "modes": (scene.with_tables(grid={}), "modal")}
    for asked in promises:
        engines |= {f"{asked:.4g}": (scene.with_accuracy(asked), "auto")}
        engines |= (
            {f"{asked:.4g} by steps": (scene.with_accuracy(asked), "resident")} if asked >= LEAST_BY_STEPS else {}
        )
    return [row_of(number, engine, names, truth, judge, *run) for engine, run in engines.items() if run[0] is not None]


def measured_nonlinear(number: int) -> list[dict]:
    """Return the row of a scene that is not linear; none where the judge is not sure."""
    try:
        scene, names = random_nonlinear_scene(number)
    except SceneError as error:
        print(f"{number:4d} no scene: {error}", flush=True)
        return []
    phasors = np.array([actuator.magnitude * np.exp(-1j * actuator.phase) for actuator in scene.actuators])
    truth, change = true_nonlinear_factor(scene, phasors)
    gridded = random_grid(scene, number)
    if gridded is None or change > UNSURE:
        print(f"{number:4d} no grid, or the judge is not sure: {change:.1e}", flush=True)
        return []
    return [row_of(number, "not linear", names, float(truth), JUDGE + float(change), gridded, "auto")]


def row_of(number: int, engine: str, names: list[str], truth: float, judge: float, scene: Scene, path: str) -> dict:
    """Return the row of a scene by an engine: the found and the true localization factor, and the bar."""
    row = {"scene": number, "engine": engine, "effects": names, "truth": truth, "judge": judge}
    started = time.perf_counter()
    try:
        result = simulate(scene, device="cpu", path=path)
    except SceneError as error:
        row["refused"] = str(error)
    else:
        case, estimated = result.cases["drive"], result.accuracy.get("estimate", {"line": "no estimate"})
        row |= {"found": case.localization_factor, "line": estimated["line"]}
        if case.status != "ok":
            row["refused"] = case.status
        if "error" in estimated:
            row |= {"interval": estimated["interval"][0], "bar": estimated["error"] * estimated["references"][0]}
    row["seconds"] = time.perf_counter() - started
    print(text(row), flush=True)
    return row


def error_and_bar(row: dict) -> tuple[float, float]:
    """Return the error of a row and its bar [localization factor], what the judge may be wrong by taken off."""
    return max(abs(row["found"] - row["truth"]) - row["judge"] * row["truth"], 0.0), row["bar"]


def missed(row: dict) -> bool:
    """Return whether the truth lies outside the bar, or outside the interval of the true value."""
    error, bar = error_and_bar(row)
    low, high = row["interval"]
    judge = row["judge"] * row["truth"]
    return error > bar or not low - judge <= row["truth"] <= high + judge


def text(row: dict) -> str:
    head = f"{row['scene']:4d} {row['engine']:12s} {row['truth']:.6f}"
    if "refused" in row:
        return f"{head} refused: {row['refused']}"
    if "bar" not in row:
        return f"{head} {row['line']}"
    error, bar = error_and_bar(row)
    return (f"{head} {row['found']:.6f} off {error:.1e} bar {bar:.1e} interval {row['interval'][0]:.6f} "
            f"{row['interval'][1]:.6f} {row['seconds']:.1f} s {','.join(row['effects'])}"
            f"{' MISSED' if missed(row) else ''}")  # fmt: skip


def report(rows: list[dict]) -> None:
    print(
        "\n| engine | runs | truth within the bar and the interval | bar / error, median | 95th percentile | refused |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    for engine in dict.fromkeys(row["engine"] for row in rows):
        own = [row for row in rows if row["engine"] == engine]
        barred = [row for row in own if "bar" in row]
        pairs = np.array([error_and_bar(row) for row in barred]).reshape(-1, 2)
        ratio = pairs[:, 1] / np.maximum(pairs[:, 0], 1e-12)
        held = sum(not missed(row) for row in barred)
        print(f"| {engine} | {len(own)} | {held} of {len(barred)} | {np.median(ratio):.2g} | "
              f"{np.percentile(ratio, 95):.2g} | {sum('refused' in row for row in own)} |")  # fmt: skip
