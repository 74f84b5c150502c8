"""Waveforms of all actuators that focus motion at points of a linear plate, and their results.

Panels within the tolerances of ``[search.robust]`` have an inverse filter made for many of them, the least squares
Σ |A_p w − d|² / P + μ |w|² with A_p the responses of panel p; and all waveforms are measured on other ones.
"""

import time
from dataclasses import replace

import numpy as np

from warp_plate.focusing.figures import Figures, describe_waveforms
from warp_plate.focusing.methods import (
    Convolution,
    Gains,
    find_gains,
    inverse_filter,
    least_squares,
    limits_of,
    make_waveforms,
    scale_to_limits,
)
from warp_plate.focusing.responses import HeldResponses, quiet_optimum
from warp_plate.focusing.wishes import Wish, make_wish
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.problem.uncertainty import Scenario, draw_scenarios
from warp_plate.result.focus import FocusedWaveforms, FocusResult, PanelFigures
from warp_plate.scene.errors import SceneError, under
from warp_plate.scene.focus import Focus
from warp_plate.scene.model import Scene, SceneSource

# Bytes for a frequency and a pair of responses: spectra, and what is made of them.
SPECTRA = 32.0


def focus(scene: SceneSource, played: FocusResult | None = None, wished: np.ndarray | None = None) -> FocusResult:
    """Return the waveforms that focus motion at each point of ``[focus]``, by all methods.

    Args:
        scene: Linear scene with a table ``[focus]``; its grid, window and drive are not used.
        played: Waveforms made for another panel, which are played on this one (default: they are made for this one).
        wished: (samples,) or (foci, samples) motion that the foci are to follow in shape, at the ends of the samples of
            ``focus.rate``; waveforms last as long (default: what ``[focus]`` says).

    Raises:
        SceneError: There is no ``[focus]``, the scene has no motion in time by modes, or no mode up to
            ``focus.highest``; a point does not move; or the wish or the waveforms do not fit the scene.
    """
    scene, started = Scene.load(scene), time.perf_counter()
    table = _table(scene)
    if played is not None:
        _check_fit(scene, table, played)
        wished = played.wished
    wish = make_wish(table, scene.folder, len(scene.actuators), wished)
    responses = HeldResponses.of_scene(scene, wish.recorded)
    solved = time.perf_counter()
    h = responses.at_foci()
    for still in np.flatnonzero(~h.any(axis=(0, 2)))[:1].tolist():
        x, y = table.points[still]
        raise SceneError(f"focus.points[{still}]: nothing moves at {x:g}, {y:g}, where an edge holds the plate")
    gains, quiet = find_gains(h, table, wish), None
    if played is None:
        waveforms, quiet = _make(responses, h, wish, gains)
    else:
        waveforms = {name: method.waveforms for name, method in played.methods.items()}
    ended = time.perf_counter()
    results = _describe(responses, h, wish, gains, waveforms)
    if quiet is not None:
        pairs = zip(results["quiet"].limits, quiet, strict=True)
        limits = tuple(", ".join([*filter(None, [others]), *["rest"] * attained]) for others, attained in pairs)
        results["quiet"] = replace(results["quiet"], limits=limits)
    seconds = {"modes": solved - started, "waveforms": ended - solved, "figures": time.perf_counter() - ended}
    return FocusResult(
        scene=scene,
        modes=responses.plate.frequencies.size,
        times=np.arange(1, wish.recorded + 1) / table.rate,
        bound=gains.bound,
        condition=table.condition if played is None else None,
        methods=results,
        seconds=seconds,
        wished=wish.motion[:, : wish.samples] if wished is not None or table.wish is not None else None,
    )


def _make(
    responses: HeldResponses, h: np.ndarray, wish: Wish, gains: Gains
) -> tuple[dict[str, np.ndarray], list[bool] | None]:
    """Return the waveforms of all methods that the scene asks for, and for which foci "quiet" attains its bound."""
    scene, table, quiet = responses.plate.scene, responses.table, None
    waveforms = make_waveforms(h, table, wish, gains)
    if scene.search.robust is not None:
        waveforms["robust_filter"] = _filter_for_panels(scene, table, wish)
    if table.rest is not None:
        waveforms["quiet"], quiet = quiet_optimum(responses, gains.values)
    return {name: scale_to_limits(values, *limits_of(table)) for name, values in waveforms.items()}, quiet


def _filter_for_panels(scene: Scene, table: Focus, wish: Wish) -> np.ndarray:
    """Return the waveforms (foci, actuators, samples) of the inverse filter for panels within tolerances."""
    robust = scene.search.robust
    assert robust is not None
    rows = robust.scenarios * len(table.points)
    wanted = SPECTRA * rows * wish.recorded * len(scene.actuators)
    refuse_beyond_memory(wanted, f"search.robust.scenarios = {robust.scenarios}: responses at {rows} foci of panels")
    panels = draw_scenarios(scene, robust.scenarios, robust.seed, stepped=False)
    h = np.concatenate([_panel_responses(panel, wish) for panel in panels], axis=1)
    return inverse_filter(*least_squares(h, wish), table.condition)


def _describe(
    responses: HeldResponses, h: np.ndarray, wish: Wish, gains: Gains, waveforms: dict[str, np.ndarray]
) -> dict[str, FocusedWaveforms]:
    """Return the waveforms by method and what they attain, on other panels too where tolerances are given."""
    convolution, scene = Convolution(h, wish.samples), responses.plate.scene
    results = {
        name: describe_waveforms(responses, convolution, wish, values, gains.gap(values))
        for name, values in waveforms.items()
    }
    if scene.search.robust is not None:
        elsewhere = _measure_panels(scene, wish, waveforms)
        results = {name: replace(result, panels=elsewhere[name]) for name, result in results.items()}
    return results


def _measure_panels(scene: Scene, wish: Wish, waveforms: dict[str, np.ndarray]) -> dict[str, PanelFigures]:
    """Return what waveforms (foci, actuators, samples) by method attain on ``search.robust.fresh`` other panels."""
    robust = scene.search.robust
    assert robust is not None
    figures: dict[str, list[Figures]] = {name: [] for name in waveforms}
    for panel in draw_scenarios(scene, robust.fresh, robust.seed, validation=True, stepped=False):
        convolution = Convolution(_panel_responses(panel, wish), wish.samples)
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


@under("search.robust")
def _panel_responses(panel: Scenario, wish: Wish) -> np.ndarray:
    """Return h (actuators, foci, recorded) of one panel, with the gains of its actuators."""
    return HeldResponses.of_scene(panel.scene, wish.recorded).at_foci() * panel.gain[:, None, None]


def _table(scene: Scene) -> Focus:
    """Return the scene's ``[focus]``, or refuse a scene without it, or one without modal transients."""
    if scene.focus is None:
        raise SceneError("focus: there is no such table; write [focus] with points = [[x, y]] and highest, in Hz")
    if scene.nonlinear_table is not None:
        raise SceneError(f"{scene.nonlinear_table}: waveforms are focused on a linear plate without it")
    if scene.steady:
        rule = "take viscous damping or effects.modal_damping"
        if scene.steady_key == scene.lossy_inductance_key:
            rule = "write eddy_branches in place of eddy_resistance and eddy_reactance"
        raise SceneError(f"{scene.steady_key}: has no motion in time; {rule}")
    if len(set(scene.magnitude_units)) > 1:
        rule = "focus by actuators of one unit"
        raise SceneError(f"actuators: waveforms in {scene.drive_unit} have no common scale; {rule}")
    return scene.focus


def _check_fit(scene: Scene, table: Focus, played: FocusResult) -> None:
    """Raise a SceneError unless waveforms that were made for another scene can be played in this one."""
    keys = ["points", "rate", "burst", *(("time", "wish") if played.wished is None else ())]
    for key in keys:
        if (other := getattr(played.scene.focus, key)) != getattr(table, key):
            raise SceneError(f"focus.{key}: the waveforms were made with another one, {other}")
    driven, before = (
        [f"{actuator.name} ({some.drive_unit})" for actuator in some.actuators] for some in (scene, played.scene)
    )
    if driven != before:
        raise SceneError(f"actuators: the waveforms were made for others, {', '.join(before)}")
