"""How many actuators a focus needs: they are left out one by one, and a method's waveforms are made anew each time.

Left out is the actuator whose waveforms have the least energy. That is backward elimination: other choices of as many
actuators may do better, but for time reversal of one point under a limit of the energy, where it is exact.
"""

from __future__ import annotations

import numpy as np

from warp_plate.focusing.convolution import Convolution
from warp_plate.focusing.figures import crosstalk, misfit
from warp_plate.focusing.waveforms import METHODS, find_gains, make_waveforms
from warp_plate.focusing.wishes import Wish
from warp_plate.result.focus import Ranking
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import Focus


def check_rank(method: str, played: bool) -> None:
    """Raise a SceneError unless actuators can be ranked for a method; not where waveforms are ``played``."""
    if played:
        raise SceneError(f"rank = {method}: not for waveforms of a file, which all actuators were made for")
    if method not in METHODS:
        raise SceneError(f"rank = {method}: must be one of {', '.join(METHODS)}")


def rank_actuators(method: str, names: list[str], h: np.ndarray, table: Focus, wish: Wish, condition: float) -> Ranking:
    """Return the figures of each number of actuators.

    Args:
        method: One of METHODS.
        names: (actuators,) names.
        h: (actuators, foci, recorded) responses of the foci.
        condition: Condition of the inverse filter.
    """
    kept, left_out, figures = list(range(len(names))), [], []
    while kept:
        part = h[kept]
        waveforms = make_waveforms(part, table, wish, find_gains(part, table, wish), condition, [method])[method]
        figures.append(_figures(Convolution(part, wish.samples).move(waveforms), wish))
        left_out.append(kept.pop(int((waveforms**2).sum(axis=(0, 2)).argmin())))
    peak, crosstalk_db, wrong = np.array(figures[::-1]).T
    order = tuple(names[index] for index in left_out[::-1])
    return Ranking(method, order, peak, crosstalk_db, wrong if wish.shaped else None)


def _figures(motion: np.ndarray, wish: Wish) -> tuple[float, float, float]:
    """Return the least peak, largest crosstalk [dB] and largest misfit of all foci."""
    foci = np.arange(len(motion))
    peak = motion[foci, foci, wish.moments]
    others = crosstalk(motion, peak)
    return float(np.abs(peak).min()), float(others.max()), float(misfit(motion[foci, foci], wish.motion).max())
