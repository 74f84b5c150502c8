"""Plot of the channels of a drive file, as the amplifier gets them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from warp_plate.viz.captions import shortened
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.styles import GRID, INK

# Height of a channel's strip and of the rest of the figure, and the most of all strips [inch].
STRIP, MARGIN, TALLEST = 0.3, 0.8, 8.0


def draw_channels(values: np.ndarray, rate: float, names: Sequence[str], unit: str, path: str | Path) -> None:
    """Draw each channel in a strip that reaches from −1 to 1, full scale.

    Args:
        values: (channels, samples) from −1 to 1.
        rate: Samples per second [1/s].
        names: (channels,) names of the channels.
        unit: What 1 stands for, such as "1 V".
        path: File to write.
    """
    times, count = 1e3 * np.arange(values.shape[1]) / rate, len(values)
    with figure(path, (7.0, MARGIN + min(STRIP * count, TALLEST)), font_size=8) as made:
        axes = made.subplots()
        for row, channel in enumerate(values):
            axes.plot(times, row - 0.45 * channel, color=INK, linewidth=0.5, drawstyle="steps-post", rasterized=True)
        axes.set_yticks(range(count), [shortened(name) for name in names], fontsize=min(8.0, 140 / count))
        axes.set(xlim=(0, times[-1]), ylim=(count - 0.4, -0.6), xlabel="time [ms]", ylabel="actuator")
        axes.set_title(f"channels, strips from −1 to 1; 1 stands for {unit}", fontsize=8)
        axes.grid(True, axis="x", color=GRID, linewidth=0.4, alpha=0.4)
