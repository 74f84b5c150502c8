"""Panels within the tolerances of ``[search.robust]``: an inverse filter made for many, and waveforms on other ones.

The filter is the least squares of all panels at once, Σ |A_p w − d|² / P + μ |w|², A_p the responses of panel p.
"""

from __future__ import annotations

import numpy as np

from warp_plate.focusing import methods
from warp_plate.focusing.figures import Figures
from warp_plate.focusing.methods import Convolution
from warp_plate.focusing.responses import HeldResponses
from warp_plate.focusing.waveforms import least_squares
from warp_plate.focusing.wishes import Wish
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.problem.uncertainty import Scenario, draw_scenarios
from warp_plate.result.focus import PanelFigures
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import L_CURVE
from warp_plate.scene.model import Scene

# Bytes for a frequency and a pair of responses: spectra, and what is made of them.
SPECTRA = 32.0


def filter_for_panels(scene: Scene, wish: Wish) -> tuple[np.ndarray, float]:
    """Return the waveforms (foci, actuators, samples) of the filter, not yet scaled, and its condition.

    Raises:
        SceneError: ``condition`` is "l-curve", and the panels' L-curve has no corner.
    """
    robust, table = scene.search.robust, scene.focus
    assert robust is not None
    assert table is not None
    rows = robust.scenarios * len(table.points)
    wanted = SPECTRA * rows * wish.recorded * (rows if table.condition == L_CURVE else len(scene.actuators))
    refuse_beyond_memory(wanted, f"search.robust.scenarios = {robust.scenarios}: responses at {rows} foci of panels")
    panels = draw_scenarios(scene, robust.scenarios, robust.seed, stepped=False)
    problem = least_squares(np.concatenate([_responses(panel, wish) for panel in panels], axis=1), wish)
    condition = methods.l_curve_condition(*problem) if isinstance(table.condition, str) else table.condition
    if condition is None:
        raise SceneError(f'focus.condition = "{L_CURVE}": the L-curve of these panels has no corner; write a number')
    return methods.inverse_filter(*problem, condition), condition


def measure_panels(scene: Scene, wish: Wish, waveforms: dict[str, np.ndarray]) -> dict[str, PanelFigures]:
    """Return what waveforms (foci, actuators, samples) by method attain on ``search.robust.fresh`` other panels."""
    robust = scene.search.robust
    assert robust is not None
    figures: dict[str, list[Figures]] = {name: [] for name in waveforms}
    for panel in draw_scenarios(scene, robust.fresh, robust.seed, validation=True, stepped=False):
        convolution = Convolution(_responses(panel, wish), wish.samples)
        for name, played in waveforms.items():
            figures[name].append(Figures.measure(convolution.move(played), wish))
    return {
        name: PanelFigures(
            peak=np.array([row.peak for row in rows]),
            crosstalk_db=np.array([row.crosstalk_db for row in rows]),
            misfit=np.array([row.misfit for row in rows]) if wish.shaped else None,
        )
        for name, rows in figures.items()
    }


def _responses(panel: Scenario, wish: Wish) -> np.ndarray:
    """Return h (actuators, foci, recorded) of one panel, with the gains of its actuators."""
    return HeldResponses.of_scene(panel.scene, wish.recorded).at_foci() * panel.gain[:, None, None]
