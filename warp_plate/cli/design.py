"""``warp-plate design SCENE``: the panel that lets a drive put most of its energy into the target."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.designed import DesignedPanel

# First words of the designed scene; endings of the files beside it.
DESIGNED = "Designed by: warp-plate design"
MAP, UNFINISHED, SOLIDS, DRAWING = ".thickness.csv", ".unfinished.json", (".stl", ".3mf"), ".dxf"


def design(
    scene: options.SceneName,
    /,
    *,
    changes: options.SceneChanges = options.SceneChanges(),
    solid: Annotated[
        bool,
        Parameter(negative="", help="Also write the panel with its map of thickness as a solid in mm, .stl and .3mf."),
    ] = False,
    drawing: Annotated[
        bool,
        Parameter(
            negative="",
            help="Also write the outlines of the panel, its ribs and what is attached, and the contours of its map of "
            "thickness for a cutter in mm, .dxf.",
        ),
    ] = False,
    check: Annotated[
        bool, Parameter(negative="--no-check", help="Simulate the drive of the designed panel in time steps too.")
    ] = True,
    files: options.FileOptions = options.FileOptions(),
) -> None:
    """Design the panel itself: thickness, ribs, masses, springs and places that let a drive move the target alone.

    The table [design] of the scene says what is free and what is maximised: by default the bound, the largest
    localization factor of any drive; or the velocity of the target, the sound, or another quantity. The designed scene
    is written as SCENE.designed.toml, its map of thickness as a CSV file beside it, and both panels with the course of
    the search as a picture. Ctrl-C keeps the best panel so far; the same command then continues with the next start.
    """
    import warp_plate
    from warp_plate.result.atomic_io import write_atomically
    from warp_plate.scene.errors import toml_comment

    target = files.target(scene, ".designed.toml", holds=DESIGNED)
    endings = UNFINISHED, MAP, *(SOLIDS * solid), *((DRAWING,) * drawing)
    beside = {ending: target.with_suffix(ending) for ending in endings}
    own = target.exists() or beside[UNFINISHED].exists()  # then so are the files that say nothing of their program
    for ending, path in beside.items():
        output.check_overwriting(path, '{"design"', files.force or (own and ending != UNFINISHED))
    loaded, scene = changes.load(scene)
    if loaded.folder is not None and loaded.folder.resolve() != target.parent.resolve():
        raise SceneError(f"--out {target}: the scene names files in {loaded.folder}; write there")
    if solid:
        from warp_plate.viz.plots.designed import check_solid

        check_solid(loaded)
    if drawing:
        from warp_plate.viz.plots.cutter import check_drawing

        check_drawing()

    def continues() -> str:
        return "; the same command continues" * beside[UNFINISHED].exists()

    with output.scene_errors(scene), output.progress_bar("designs", shown=not files.json) as show:
        try:
            panel = warp_plate.design(loaded, show, beside[UNFINISHED], check)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(continues()) from None
    saves = {}
    designed = panel.scene
    if panel.improved and panel.thickness is not None and loaded.design is not None and loaded.design.thickness:
        factors = panel.thickness / designed.plate.thickness
        rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in factors.tolist())
        saves[beside[MAP]] = partial(write_atomically, f"{rows}\n".encode())
        effects = designed.effects.with_thickness(beside[MAP].name)
        designed = designed.model_copy(update={"effects": effects})
    heading = toml_comment(f"{DESIGNED} {scene}")
    saves[target] = partial(write_atomically, f"{heading}{designed.to_toml()}".encode())
    if solid:
        from warp_plate.viz.plots.designed import save_solid

        saves |= {beside[ending]: partial(save_solid, panel) for ending in SOLIDS}
    if drawing:
        from warp_plate.viz.plots.cutter import save_drawing

        saves[beside[DRAWING]] = partial(save_drawing, panel)

    def write() -> output.Drawn:
        written = output.write_files(saves, partial(_draw, panel, target) if files.pictures else None)
        if not panel.interrupted:
            beside[UNFINISHED].unlink(missing_ok=True)
        return written

    output.report(files.json, _as_json, _print, scene, panel, write=write)
    if panel.interrupted:
        raise KeyboardInterrupt(continues())


def _draw(panel: DesignedPanel, target: Path) -> output.Drawn:
    from warp_plate.viz.plots.designed import draw_designed
    from warp_plate.viz.plots.frame import save_plots

    return save_plots(partial(draw_designed, panel), target)


def _as_json(name: str, panel: DesignedPanel) -> dict[str, object]:
    record: dict[str, object] = {
        "scene": name,
        "improved": panel.improved,
        "before": vars(panel.before),
        "after": vars(panel.after),
        "history": panel.history,
        "numbers": dict(zip(panel.keys, panel.values, strict=True)),
        **output.attributes(panel, "evaluations", "interrupted", "left_out", "relaxed", "ceiling"),
    }
    if panel.check is not None:
        record["check"] = {**vars(panel.check), "agrees": panel.check.agrees}
    return record | ({} if panel.thickness is None else {"thickness": panel.thickness})


def _print(name: str, panel: DesignedPanel, console: Console) -> None:
    settings = panel.original.design
    assert settings is not None
    console.print(f"{panel.original.title or name}: {len(panel.history)} starts, {panel.evaluations} panels\n")
    values, bounds = ((getattr(panel.before, name), getattr(panel.after, name)) for name in ("value", "bound"))
    texts = [["localization factor of any drive", *(output.number_text(value, ".4f") for value in bounds)]]
    if values != bounds:
        cases = settings.tolerance or settings.frequencies or panel.original.targets
        form = ".4f" if settings.unit == "1" else ".4g"
        shown = [output.number_text(value, form) for value in values]
        several = "" if not cases else f", {'largest' if settings.lowers else 'least'} of all cases"
        texts.append([settings.label + several, *shown])
    output.print_rows(console, ("quantity", "before", "after"), texts)
    if panel.keys:
        pairs = zip(panel.keys, panel.values, strict=True)
        numbers = [[key, output.number_text(value, ".5g")] for key, value in pairs]
        output.print_rows(console, ("free number", "designed"), numbers)
    if panel.thickness is not None:
        low, high = 1e3 * panel.thickness.min(), 1e3 * panel.thickness.max()
        console.print(f"thickness from {low:.4g} to {high:.4g} mm")
    if panel.left_out:
        console.print(f"left out: {', '.join(panel.left_out)}")
    if panel.relaxed is not None:
        console.print(f"largest value with all candidates, no bound: {panel.relaxed:.4g}")
    if panel.ceiling is not None:
        console.print(f"no panel of these places exceeds a localization factor of {panel.ceiling:.4f}")
    if panel.after.excess:
        both = panel.before.excess, panel.after.excess
        parts = [[name, *(f"{max(100 * excess[name], 0):.3g}" for excess in both)] for name in panel.after.excess]
        output.print_rows(console, ("limit passed by (%)", "before", "after"), parts)
    _print_check(panel, console)
    if not panel.improved:
        output.print_warnings(console, ["no panel is better than the scene's own; try more starts or wider ranges"])


def _print_check(panel: DesignedPanel, console: Console) -> None:
    """Print what the drive of the designed panel does in time steps."""
    if (check := panel.check) is None:
        return
    if check.reason or not math.isfinite(check.error):
        console.print(f"not checked in time steps: {check.reason or 'too few grids within the time'}")
        return
    drive = "best" if panel.original.design is None or panel.original.design.objective == "bound" else "scene's"
    steps = f"{check.steps:.4f} ± {check.error:.2g}"
    console.print(f"localization factor of the {drive} drive in time steps: {steps}, by modes {check.modes:.4f}")
    if not check.agrees:
        output.print_warnings(console, ["time steps and modes differ by more than the error; raise grid.modal_density"])
