"""Rows of the campaign: numbers that a fit finds in stepped responses with noise, beside the true ones."""

import time
from pathlib import Path

import numpy as np

from fits.panels import LOSS, MODULUS, VISCOUS, Panel, random_panel
from fits.stepping import stepped_responses
from warp_plate import Scene
from warp_plate.fitting.fit import fit_responses
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.panel_responses import PanelResponses

NOISE = 0.01
# Largest errors of modulus and rigidity, of damping, and of springs that the data determine to as much.
ALLOWED = {MODULUS: 0.005, LOSS: 0.05, VISCOUS: 0.05}
SPRINGS = 0.1
# Numbers of which frequency responses determine two alone, D = EH³ / 12(1 − ν²) and ρH, and the range of each.
INSEPARABLE, WIDE = (MODULUS, "plate.thickness", "plate.density"), (0.5, 2.0)


def measured(number: int, device: str = "cpu", folder: Path | None = None) -> dict:
    """Return the row of a panel, whose responses are taken from a folder or kept there."""
    panel, started = random_panel(number), time.perf_counter()
    kept = folder / f"{number}.npz" if folder else None
    if kept and kept.exists():
        frequencies, responses, apart = np.load(kept).values()
    else:
        frequencies, responses, apart = stepped_responses(panel, device)
        if kept:
            np.savez(kept, frequencies=frequencies, responses=responses, apart=apart)
    stepped = time.perf_counter()
    rng = np.random.default_rng([number, 1])
    noise = rng.normal(scale=NOISE / np.sqrt(2), size=(2, *responses.shape))
    data = MeasuredResponses(f"panel {number}", frequencies, responses * (1 + noise[0] + 1j * noise[1]))
    engines_apart = np.log(responses / PanelResponses(panel.scene, data).values)
    found = fit_responses(_scene_to_fit(panel, panel.start, panel.ranges), data)
    fitted = time.perf_counter()
    ends = np.stack([found.values, found.low, found.high], axis=1).tolist()
    numbers = {
        key: {"truth": panel.truth[key], "start": panel.start[key], "value": value, "low": low, "high": high}
        for key, (value, low, high) in zip(found.keys, ends, strict=True)
    }  # fmt: skip
    return {
        "panel": number,
        "edges": {side: edge if isinstance(edge, str) else "springs" for side, edge in panel.scene.edges},
        "frequencies": len(frequencies),
        "grids_apart": float(apart),
        "engines_apart": float(np.sqrt(np.mean(np.abs(engines_apart) ** 2))),
        "rigidity_error": found.scene.plate.rigidity / panel.scene.plate.rigidity - 1,
        "decibels": float(np.sqrt(np.mean(found.rms_decibels**2))),
        "numbers": numbers,
        "inseparable": list(map(list, found.inseparable)),
        "told_apart": _inseparable(panel, data),
        "stepping_seconds": stepped - started,
        "fit_seconds": fitted - stepped,
    }


def _scene_to_fit(panel: Panel, start: dict[str, float], ranges: dict[str, tuple[float, float]], **fit: int) -> Scene:
    """Return the panel with values that a fit starts from."""
    changed = panel.scene.with_values(start)
    return changed.with_tables(fit={"free": ranges, **fit})


def _inseparable(panel: Panel, data: MeasuredResponses) -> list[list[str]]:
    """Return what a fit of modulus, thickness and density says that it cannot tell apart."""
    plate = panel.scene.plate
    truth = dict(zip(INSEPARABLE, (plate.young_modulus, plate.thickness, plate.density), strict=True))
    ranges = {key: (WIDE[0] * value, WIDE[1] * value) for key, value in truth.items()}
    found = fit_responses(_scene_to_fit(panel, {MODULUS: panel.start[MODULUS]}, ranges, starts=1), data)
    return list(map(list, found.inseparable))


def summary(rows: list[dict]) -> dict:
    """Return counts of what held, and the largest and median errors, for each kind of number."""
    kinds = {"modulus": [MODULUS], "damping": [LOSS, VISCOUS]}
    named = {row["panel"]: row for row in rows}
    found: dict = {"panels": len(rows)}
    for kind in ("modulus", "damping", "springs"):
        each = [
            (ALLOWED.get(key, SPRINGS), entry)
            for row in named.values()
            for key, entry in row["numbers"].items()
            if key in kinds.get(kind, ()) or (kind == "springs" and key.startswith("edges"))
        ]
        told = [(limit, entry) for limit, entry in each if _matters(limit, entry)]
        errors = np.array([abs(entry["value"] / entry["truth"] - 1) for _, entry in told])
        limits = np.array([limit for limit, _ in told])
        with_interval = [entry for _, entry in each if np.isfinite(entry["low"])]
        found[kind] = {
            "numbers": len(each),
            "determined": len(told),
            "within": int(np.sum(errors <= limits)),
            "median_error": float(np.median(errors)) if len(errors) else None,
            "largest_error": float(errors.max(initial=0.0)),
            "intervals": len(with_interval),
            "held": sum(entry["low"] <= entry["truth"] <= entry["high"] for entry in with_interval),
        }
    found["rigidity_within"] = sum(abs(row["rigidity_error"]) <= ALLOWED[MODULUS] for row in rows)
    found["said_inseparable"] = sum(sorted(INSEPARABLE) in map(sorted, row["told_apart"]) for row in rows)
    return found


def _matters(limit: float, entry: dict) -> bool:
    """Return whether the interval is no wider than the error that is allowed, which is what the data say."""
    return entry["high"] - entry["low"] <= 2 * limit * entry["value"]
