"""The motion of target and rest under each drive, as a table for the commands and for ``print(result)``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from warp_plate.result.case import Case, amplitude_column
from warp_plate.scene.errors import number_text
from warp_plate.scene.model import Scene
from warp_plate.scene.specification import STANDARD_GRAVITY


def motion_table(cases: Mapping[str, Case], scene: Scene) -> tuple[list[str], list[list[str]]]:
    """Return headings and rows, by case labels, of the cases whose motion is known."""
    moving = {label: (case, case.motion) for label, case in cases.items() if case.motion is not None}
    tones = any(motion.acceleration is not None for _, motion in moving.values())
    searched = any(case.frequency is not None for case in cases.values())
    amplitude, rows = "", []
    for label, (case, motion) in moving.items():
        frequencies = sorted({scene.drive.frequency} if case.frequency is None else set(case.frequency.tolist()))
        amplitude, amplitudes = amplitude_column(scene, case.magnitude, ".3g")
        cells = [", ".join(f"{value:.6g}" for value in frequencies)] * searched
        cells += [amplitudes[int(case.magnitude.argmax())], number_text(case.localization_factor, ".4f")]
        cells += [number_text(motion.contrast, ".1f"), _pair(motion.velocity, 1e3)]
        cells.append(_pair(motion.displacement, 1e6))
        if tones:
            cells.append("none" if motion.acceleration is None else _pair(motion.acceleration, 1 / STANDARD_GRAVITY))
        rows.append([label, *cells])
    headings = ["drive", *["frequency Hz"] * searched, f"largest {amplitude}", "share", "contrast dB"]
    return [*headings, "velocity mm/s rms", "displacement µm peak", *["acceleration g rms"] * tones], rows


def _pair(values: tuple[float, float], factor: float) -> str:
    return " / ".join(number_text(factor * value, ".3g") for value in values)


def aligned(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as lines of text, headings broken in two, the first column left-aligned."""
    broken = [heading.partition(" ") for heading in headings]
    lines = [[first if second else "" for first, _, second in broken], [second or first for first, _, second in broken]]
    columns = list(zip(*lines, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    texts = [[f"{cell:{'>' if at else '<'}{widths[at]}}" for at, cell in enumerate(row)] for row in (*lines, *rows)]
    return "\n".join("  ".join(row).rstrip() for row in texts)
