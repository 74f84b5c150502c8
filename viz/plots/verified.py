"""Plot of a verification: measured and predicted velocities over the panel, and one against the other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Scene
from warp_plate.viz.annotations import GRID, INK
from warp_plate.viz.fields import colour_map
from warp_plate.viz.plots.frame import figure, label_axis

if TYPE_CHECKING:
    from warp_plate.studies.verify import Verification

LEAST, TARGET, POINT = -40.0, "#b2182b", "#08519c"


def draw_verified(verified: Verification, scene: Scene, path: str | Path) -> None:
    """Draw measured and predicted velocities of a scene's panel."""
    measured, promised = verified.measured.velocity, verified.promised * verified.scale
    largest = max(float(measured.max()), float(promised.max()))
    with figure(path, (11.0, 4.2)) as fig:
        left, middle, right = fig.subplots(1, 3, width_ratios=[1, 1, 0.95])
        for axes, values, name in ((left, measured, "measured"), (middle, promised, "predicted")):
            with np.errstate(divide="ignore"):
                levels = np.maximum(20 * np.log10(values / largest), LEAST)
            dots = axes.scatter(
                *verified.measured.points.T, c=levels, cmap=colour_map("cividis"), vmin=LEAST, vmax=0, s=22
            )
            axes.set(xlim=(0, scene.plate.size[0]), ylim=(0, scene.plate.size[1]), aspect="equal", title=name)
            label_axis(axes.xaxis, "x", "m")
            label_axis(axes.yaxis, "y", "m")
            if scene.target.mask is None:
                axes.plot(*scene.target.closed_path().T, color=TARGET, linewidth=1.4)
        fig.colorbar(
            dots, ax=[left, middle], label="level over the largest [dB]", shrink=0.6, aspect=40, location="bottom"
        )
        right.plot([0, largest], [0, largest], color=INK, linewidth=0.8, linestyle=":")
        right.errorbar(
            promised, measured, yerr=verified.measured.uncertainty, fmt=".", color=POINT, markersize=4, elinewidth=0.7
        )
        right.set(
            xlim=(0, None), ylim=(0, None), xlabel="predicted, scaled as the measured", ylabel="measured velocity"
        )
        right.grid(True, color=GRID, linewidth=0.4, alpha=0.4)
        right.set_title(f"cosine {verified.correlation:.4f}", fontsize=9)
        low, high = (100 * end for end in verified.interval)
        factor, promise = 100 * verified.localization_factor, 100 * verified.promised_factor
        words = f"{factor:.1f} % measured ({low:.1f} to {high:.1f} %), {promise:.1f} % predicted"
        fig.suptitle(f"{scene.title or verified.case}\nlocalization factor {words}", fontsize=11)
