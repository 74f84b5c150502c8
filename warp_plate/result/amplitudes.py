"""Amplitudes of drives as the scene gives them: a magnitude, or the force of the patch in newtons."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warp_plate.scene.model import Scene


def amplitudes_as_given(scene: Scene, magnitudes: Iterable[float]) -> list[tuple[str, float, str]]:
    """Return key in the scene file, value and unit of each actuator's amplitude.

    Args:
        magnitudes: (actuators,) magnitudes [``Scene.drive_unit``].
    """
    return [
        (
            actuator.amplitude_key,
            float(value) * actuator.amplitude_area,
            scene.drive_unit if actuator.force is None else "N",
        )
        for actuator, value in zip(scene.actuators, magnitudes, strict=True)
    ]


def amplitude_column(scene: Scene, magnitudes: Iterable[float], digits: str) -> tuple[str, list[str]]:
    """Return heading and cells of a table's column; ``digits`` is the format of magnitudes.

    Where some actuators have magnitudes and others forces, the units are in the cells.
    """
    amplitudes = amplitudes_as_given(scene, magnitudes)
    texts = [format(value, digits if key == "magnitude" else ".4g") for key, value, _ in amplitudes]
    kinds = dict.fromkeys((key, unit) for key, _, unit in amplitudes)
    if len(kinds) > 1:
        return " or ".join(key for key, _ in kinds), [
            f"{text} {row[2]}" for text, row in zip(texts, amplitudes, strict=True)
        ]
    return " ".join(f"{key} ({unit})" for key, unit in kinds), texts
