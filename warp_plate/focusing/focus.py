"""Waveforms of all actuators that focus motion at points of a linear plate, and their results."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.focusing import methods
from warp_plate.focusing.figures import describe_waveforms
from warp_plate.focusing.methods import Convolution
from warp_plate.focusing.panels import filter_for_panels, measure_panels
from warp_plate.focusing.responses import HeldResponses, quiet_optimum
from warp_plate.focusing.waveforms import Gains, check_rank, find_gains, limits_of, make_waveforms, rank_actuators
from warp_plate.focusing.wishes import Wish, make_wish
from warp_plate.result.focus import FocusedWaveforms, FocusResult
from warp_plate.scene.errors import SceneError
from warp_plate.scene.focus import L_CURVE, Focus
from warp_plate.scene.model import Scene, SceneSource


def focus(
    scene: SceneSource,
    played: FocusResult | None = None,
    wished: np.ndarray | None = None,
    rank: str | None = None,
) -> FocusResult:
    """Return the waveforms that focus motion at each point of ``[focus]``, by all methods.

    Args:
        scene: Linear scene with a table ``[focus]``; its grid, window and drive are not used.
        played: Waveforms made for another panel, which are played on this one (default: they are made for this one).
        wished: (samples,) or (foci, samples) motion that the foci are to follow in shape, at the ends of the samples of
            ``focus.rate``; waveforms last as long (default: what ``[focus]`` says).
        rank: Method by which to rank actuators, with figures of fewer of them (default: none).

    Raises:
        SceneError: There is no ``[focus]``, the scene has no motion in time by modes, or no mode up to
            ``focus.highest``; a point does not move; or the wish or the waveforms do not fit the scene.
    """
    scene, started = Scene.load(scene), time.perf_counter()
    table = _table(scene)
    if played is not None:
        _check_fit(scene, table, played)
        wished = played.wished
    if rank is not None:
        check_rank(rank, played is not None)
    wish = make_wish(scene, wished)
    responses = HeldResponses.of_scene(scene, wish.recorded)
    solved = time.perf_counter()
    h = responses.at_foci()
    for still in np.flatnonzero(~h.any(axis=(0, 2)))[:1].tolist():
        x, y = table.points[still]
        raise SceneError(f"focus.points[{still}]: nothing moves at {x:g}, {y:g}, where an edge holds the plate")
    waveforms = _make(responses, h, wish) if played is None else _play(h, table, wish, played)
    ranking = None
    if rank is not None:
        assert waveforms.condition is not None
        names = [actuator.name for actuator in scene.actuators]
        ranking = rank_actuators(rank, names, h, table, wish, waveforms.condition)
    ended = time.perf_counter()
    results = _describe(responses, h, wish, waveforms)
    seconds = {"modes": solved - started, "waveforms": ended - solved, "figures": time.perf_counter() - ended}
    return FocusResult(
        scene=scene,
        modes=responses.plate.frequencies.size,
        times=np.arange(1, wish.recorded + 1) / table.rate,
        bound=waveforms.gains.bound,
        condition=waveforms.condition,
        methods=results,
        ranking=ranking,
        seconds=seconds,
        wished=wish.motion[:, : wish.samples] if wished is not None or table.wish is not None else None,
    )


@dataclass(frozen=True)
class _Waveforms:
    """Waveforms to play.

    Attributes:
        gains: Gains of the panel that plays them.
        by_method: (foci, actuators, samples) by method.
        condition: Condition of the inverse filters; None where they were not made here.
        quiet: (foci,) whether the method "quiet" attains the bound of the rest; None without it.
    """

    gains: Gains
    by_method: dict[str, np.ndarray]
    condition: float | None = None
    quiet: list[bool] | None = None


def _describe(
    responses: HeldResponses, h: np.ndarray, wish: Wish, waveforms: _Waveforms
) -> dict[str, FocusedWaveforms]:
    """Return the waveforms by method and what they attain, on other panels too where tolerances are given."""
    convolution, scene = Convolution(h, wish.samples), responses.plate.scene
    results = {
        name: describe_waveforms(responses, convolution, wish, values, waveforms.gains.gap(values))
        for name, values in waveforms.by_method.items()
    }
    if waveforms.quiet is not None:
        pairs = zip(results["quiet"].limits, waveforms.quiet, strict=True)
        limits = tuple(", ".join([*filter(None, [others]), *["rest"] * attained]) for others, attained in pairs)
        results["quiet"] = replace(results["quiet"], limits=limits)
    if scene.search.robust is not None:
        elsewhere = measure_panels(scene, wish, waveforms.by_method)
        results = {name: replace(result, panels=elsewhere[name]) for name, result in results.items()}
    return results


def _make(responses: HeldResponses, h: np.ndarray, wish: Wish) -> _Waveforms:
    """Make waveforms by all methods that the scene asks for."""
    scene, table = responses.plate.scene, responses.table
    gains, condition, quiet, others = find_gains(h, table, wish), table.condition, None, {}
    if scene.search.robust is not None:
        others["robust_filter"], condition = filter_for_panels(scene, wish)
    assert not isinstance(condition, str)
    if table.rest is not None:
        others["quiet"], quiet = quiet_optimum(responses, gains.values)
    scaled = {name: methods.scale_to_limits(waveforms, *limits_of(table)) for name, waveforms in others.items()}
    return _Waveforms(gains, make_waveforms(h, table, wish, gains, condition) | scaled, condition, quiet)


def _play(h: np.ndarray, table: Focus, wish: Wish, played: FocusResult) -> _Waveforms:
    """Take waveforms that were made for another panel."""
    return _Waveforms(find_gains(h, table, wish), {name: method.waveforms for name, method in played.methods.items()})


def _table(scene: Scene) -> Focus:
    """Return the scene's ``[focus]``, or refuse a scene without it, or one without modal transients."""
    if scene.focus is None:
        raise SceneError("focus: there is no such table; write [focus] with points = [[x, y]] and highest, in Hz")
    if scene.nonlinear_table is not None:
        raise SceneError(f"{scene.nonlinear_table}: waveforms are focused on a linear plate without it")
    if scene.steady:
        raise SceneError(f"{scene.steady_key}: has no motion in time; take viscous damping or effects.modal_damping")
    if scene.focus.condition == L_CURVE and scene.search.robust is None:
        what = "exact responses of one panel have an L-curve without a corner"
        raise SceneError(f'focus.condition = "{L_CURVE}": {what}; write a number, or tolerances in [search.robust]')
    return scene.focus


def _check_fit(scene: Scene, table: Focus, played: FocusResult) -> None:
    """Raise a SceneError unless waveforms that were made for another scene can be played in this one."""
    assert played.scene.focus is not None
    same = {"points": table.points, "rate": table.rate, "burst": table.burst}
    if played.wished is None:
        same["time"] = table.time
    for key, value in same.items():
        if (other := getattr(played.scene.focus, key)) != value:
            raise SceneError(f"focus.{key}: the waveforms were made with another one, {other}")
    if played.wished is None and table.wish is not None:
        raise SceneError("focus.wish: the waveforms were made without one; delete it")
    names, others = ([actuator.name for actuator in some.actuators] for some in (scene, played.scene))
    if played.scene.drive_unit != scene.drive_unit:
        units = f"{played.scene.drive_unit}, not {scene.drive_unit}"
        raise SceneError(f"actuators: the waveforms were made for actuators driven by {units}")
    if names != others:
        raise SceneError(f"actuators: the waveforms were made for others, {', '.join(others)}")
