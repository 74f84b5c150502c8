"""``warp-plate localize SCENE``: the search, its table and its files."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from warp_plate.cli import output
from warp_plate.cli.crosstalk import crosstalk_json, crosstalk_table
from warp_plate.cli.objectives_table import print_objectives
from warp_plate.cli.options import Whole
from warp_plate.cli.published import NOT_REPRODUCED, PUBLISHED
from warp_plate.cli.resume import read_checkpoint, result_beside, way_on
from warp_plate.cli.robust_table import print_robust, robust_json
from warp_plate.cli.workers import lost_lines, own_device, workers
from warp_plate.scene.errors import SceneError, printable

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from warp_plate.cluster.pool import Pool
    from warp_plate.result.model import Result
    from warp_plate.scene.model import Scene
    from warp_plate.studies.checkpointing import CheckpointFile

TRIED = {
    "direct": ("plate", "simulated for the search"),
    "response": ("drive", "tried by the search on the Gram matrices"),
}
# Ending of the scene that is found.
FOUND = ".best.toml"
MEANING = {
    "equal": "all actuators alike",
    "single": "best single actuator",
    "time_reversal": "time reversal to the target's middle",
    "inverse_filter": "regularised inverse filter",
    "nominal": "found without scatter",
    "best": "found by the search",
}


def localize(
    scene: str | None = None,
    /,
    *,
    device: str | None = None,
    devices: str | None = None,
    cluster: str | None = None,
    seed: Whole | None = None,
    evaluator: Literal["direct", "response"] | None = None,
    path: Literal["auto", "resident", "streaming"] | None = None,
    accuracy: str | None = None,
    estimate: bool = True,
    baselines: Annotated[bool, cyclopts.Parameter(negative="")] = False,
    spectrum: bool = True,
    checkpoint_every: float = 30.0,
    resume: Path | None = None,
    out: Path | None = None,
    pictures: bool = True,
    json: Annotated[bool, cyclopts.Parameter(negative="")] = False,
) -> None:
    """Search the drive that puts most of the plate's kinetic energy into the target.

    Every actuator's magnitude and phase is searched, with the first actuator's held at 1 and 0. In a scene that is not
    linear in its drives (stretching, electrostatic force, a moving load) the first one's magnitude is the largest of
    those that the scene gives, which otherwise are for simulate.

    A scene says by [search.magnitude], [search.phase], [search.frequency], [search.position] and [search.delay] what
    else, and what not, is searched (docs/searching.md), and by method under [search] how (docs/methods.md).

    [search.limits] says what the amplifier can do: magnitude, power and equal_magnitudes (docs/searching.md).

    [[search.objectives]] says for what is searched: a kind, which is localization, contrast, velocity, displacement or
    uniformity, with its weight, and a rest_limit for velocity and displacement (docs/objectives.md).

    With [[targets]] a drive is searched for each, and the crosstalk between them is shown. The scene that is found is
    written beside the result as OUT.best.toml, which simulate runs.

    With [search.robust] the drive is judged by many panels drawn within tolerances, and compared over fresh ones with
    what the same search finds for the nominal panel alone: see docs/robust.md.

    Ctrl-C ends the search with the best so far, and leaves a checkpoint beside the result: --resume goes on from it as
    if there had been no stop, to the same result to the last bit. So does a search that runs longer than
    --checkpoint-every, in case the machine stops. A search that comes to its end takes its checkpoint away.

    Parameters
    ----------
    scene
        A preset's name (paper, touch-panel, ...; warp-plate init --help lists them) or a TOML file. With
        --resume it may be left out.
    device
        cpu, cuda, cuda:1, ... or auto, which takes a CUDA device where there is one; auto when left out, with --resume
        the kind that the search began on. Another kind rounds in another way: the result may differ. With --cluster
        that of its workers.
    devices
        Several devices of this machine, such as cuda:0,cuda:1, or cpu,cpu for two single-threaded processes: the plates
        of the search are shared among them, a process each. Results are the same to the last bit. See docs/scaling.md.
    cluster
        Workers of Dask distributed that share the plates instead (needs the extra cluster): local:4 starts four on this
        machine, tcp://HOST:PORT or a scheduler's JSON file names a scheduler that runs.
    seed
        Of the search; the scene's when left out.
    evaluator
        direct simulates a plate for each particle; response uses Gram matrices of unit responses instead. direct when
        left out, of a robust search response where it holds.
    path
        How plates are stepped: resident (all steps in one launch) or streaming (one or a few steps a launch). auto,
        the faster one, when left out.
    accuracy
        Such as 1% or 0.01: the relative error that localization factors may have, instead of the scene's grid.
    estimate
        End with an estimate of the result's error.
    baselines
        Show the drives that haptics takes without a search beside the one found: time reversal and inverse filter.
    spectrum
        After a search for one frequency of all actuators, take the localization factor over its whole range: of equal
        drive, of the best single actuator and of the best drive that may be chosen at each frequency, or a bound of it,
        with the plate's resonances.
    checkpoint_every
        Seconds between two checkpoints, at the end of an iteration: OUT.checkpoint.h5 for OUT.h5, and
        OUT.checkpoint.previous.h5, the one before. 0: after each iteration; inf: only after Ctrl-C.
    resume
        The checkpoint (.checkpoint.h5) of a search to go on with; the one before it is taken where it is damaged.
        Scene, seed, evaluator, path and accuracy are the checkpoint's; one that differs is refused.
    out
        The result file (.h5); SCENE-localize.h5 in this folder when left out, with --resume beside the checkpoint.
        Pictures are written beside it.
    pictures
        Draw the displacements and the search's history (needs the extra viz).
    json
        Print one JSON object instead of tables.
    """
    if scene is None and resume is None:
        raise SceneError("localize needs a SCENE (a preset's name or a TOML file), or --resume FILE")
    beside = None if resume is None else result_beside(resume)
    target = output.output_file(out or beside, scene or "", "localize")
    loaded = None if scene is None else output.load_scene(scene, accuracy, searched=True)
    from warp_plate.result.checkpoint import ENDING
    from warp_plate.studies.checkpointing import CheckpointFile

    same: dict[str, object] = {"seed": seed, "evaluator": evaluator, "path": path}
    # A search that goes on is on the device that it began on, unless --device names another.
    own = own_device(devices if resume is None else None, cluster, device)
    checkpoint = None if resume is None else read_checkpoint(resume, loaded, scene, accuracy, same, own)
    kept = CheckpointFile(target.with_suffix(ENDING), checkpoint_every, resume is not None, output.tell)
    if checkpoint is None and kept.path.exists():
        output.tell(f"{kept.path} is of a search that did not end; a checkpoint of this one will replace it")
    output.prepare_pictures(pictures)
    from warp_plate.studies.localize import localize as search
    from warp_plate.studies.localize import resume as go_on

    searched = loaded if checkpoint is None else checkpoint.scene
    assert searched is not None
    if checkpoint is not None:
        run = partial(go_on, checkpoint, own)
    elif loaded is not None:
        on = "auto" if own is None else own
        run = partial(search, loaded, scene or "", on, seed, evaluator, path or "auto")
    if baselines:
        from warp_plate.studies.baselines import check_baselines, with_baselines

        check_baselines(searched)
    with workers(devices, cluster, device) as pool:
        result = _run(partial(run, spectrum=spectrum, pool=pool), estimate, kept, not json, pool, searched)
    if baselines:
        began = ("auto", "auto") if checkpoint is None else (checkpoint.device, checkpoint.path)
        result = with_baselines(result, began[0] if own is None else own, path or began[1])
    files, missing = _write(result, target, pictures, kept)
    if json:
        output.print_json(as_json(result, files, kept.path if result.interrupted and kept.saved else None))
        return
    _print(result, output.console())
    output.print_files(files, missing)


def _run(
    run: Callable[..., Result], estimate: bool, kept: CheckpointFile, shown: bool, pool: Pool | None, scene: Scene
) -> Result:
    """The search with its progress; what leaves nothing but a checkpoint, Ctrl-C or a fault, says how to go on."""
    with output.progress_bar("searching", shown) as show:
        iterations, total, found = 0, scene.search.iterations * max(len(scene.targets), 1), ""

        def told(done: int, of: int, best: float) -> None:
            nonlocal iterations, total, found
            iterations, total, found = done, of, f"best {best:.4g}"
            show(done, of, found)

        if pool is not None:
            pool.told = lambda done, of: show(iterations, total, f"{found} block {done}/{of}")
        try:
            return run(on_progress=told, estimate=estimate, checkpoints=kept)
        except SceneError as error:
            if kept.saved is None:
                raise
            raise SceneError(f"{error}; there is a checkpoint{way_on(kept.saved, kept.path)}") from None
        except KeyboardInterrupt:
            if kept.saved is None:
                raise
            raise KeyboardInterrupt(way_on(kept.saved, kept.path)) from None


def _write(result: Result, target: Path, pictures: bool, kept: CheckpointFile) -> tuple[list[Path], str | None]:
    """The result and its pictures, see ``output.write_files``; the checkpoint goes once the search is done."""
    try:
        files, missing = output.write_files(result, target, pictures)
        files[1:1] = _write_found(result, target.with_suffix(FOUND))
    except SceneError as error:
        if kept.saved is None:
            raise
        raise SceneError(f"{error}; there is a checkpoint{way_on(kept.saved, kept.path)}") from None
    if not result.interrupted:
        kept.remove()
    elif kept.saved is not None:
        output.tell(f"interrupted{way_on(kept.saved, kept.path)}")
    return files, missing


def _write_found(result: Result, path: Path) -> list[Path]:
    """The scene that was found, for ``simulate``, and of several targets one for each, numbered from the second on;
    nothing where no scene may have its numbers, which is told."""
    from warp_plate.result.atomic_io import write_atomically
    from warp_plate.result.crosstalk import best_drive_scenes
    from warp_plate.scene.dump import dump_scene

    try:
        scenes = best_drive_scenes(result)
    except SceneError as error:
        output.tell(f"{path} is not written: {error}")
        return []
    files = []
    for number, scene in enumerate(scenes.values(), 1):
        file = path if number == 1 else path.with_suffix(f".{number}.toml")
        head = f"# Found by: warp-plate localize {result.source}\n# Run it by: warp-plate simulate {file.name}\n"
        write_atomically((printable(head) + dump_scene(scene)).encode(), file)
        files.append(file)
    return files


def as_json(result: Result, files: list[Path], checkpoint: Path | None = None) -> dict[str, object]:
    """The object that ``--json`` prints; ``checkpoint``: what an interrupted search goes on from."""
    best = result.cases["best"]
    factors = {name: case.localization_factor for name, case in result.cases.items()}
    history = {name: values.tolist() for name, values in result.history.items()}
    return {
        "scene": result.source,
        "device": result.device,
        "path": result.path,
        "seed": result.seed,
        "localization_factor": {**factors, "bound": result.bound},
        "bound_kind": result.bound_kind,
        "drive": output.drive_json(best, result.scene),
        "evaluations": result.evaluations,
        "node_steps": result.node_steps,
        "seconds": dict(result.seconds),
        "effects": list(result.effects),
        "history": [dict(zip(history, row, strict=True)) for row in zip(*history.values(), strict=True)],
        "objectives": dict(result.objective_values) or None,
        "objectives_of": {name: dict(worth) for name, worth in result.objective_values_by_case.items()},
        "robust": robust_json(result.robust),
        "spectrum": {name: values.tolist() for name, values in result.spectrum.items()},
        "crosstalk": crosstalk_json(result),
        "evaluator": result.evaluator,
        "accuracy": dict(result.accuracy),
        "warnings": output.warnings_of(result),
        "interrupted": result.interrupted,
        "lost": dict(result.lost_plates),
        "checkpoint": None if checkpoint is None else str(checkpoint),
        "files": [str(file) for file in files],
    }


def _print(result: Result, console: Console) -> None:
    from warp_plate.result.crosstalk import target_cases
    from warp_plate.scene.vary import counted

    published = PUBLISHED if result.source == "paper" else {}
    factors = {name: case.localization_factor for name, case in result.cases.items()}
    first = f", target {result.scene.targets[0].name}" if result.target_searches else ""
    headings = (f"localization factor{first}", "this run") + (("published",) if published else ())
    console.print(result.scene.title or result.source)
    made = output.table(*headings)
    rows = [(name, meaning, factors[name]) for name, meaning in MEANING.items() if name in factors]
    bound = "bound" if result.bound is None else result.bound_description
    for name, meaning, value in (*rows, ("bound", bound, result.bound)):
        row = [meaning, "none claimed" if value is None else output.known(value, ".4f")]
        made.add_row(*row, *([f"{published[name]:.4f}" if name in published else ""] if published else []))
    console.print(made)
    console.print()
    print_objectives(result, console)
    print_robust(result, console)
    for target, case in (target_cases(result.scene) or {"": "best"}).items():
        if case in result.cases:
            console.print(output.drive_table(result.cases[case], result.scene, target))
            console.print()
    if result.target_searches:
        console.print(crosstalk_table(result))
        console.print()
    for line in lost_lines(result.lost_plates):
        console.print(f"! {line}")
    if result.interrupted:
        console.print("Interrupted by Ctrl-C: the best so far is shown.")
    if published:
        console.print(NOT_REPRODUCED)
    effects, (thing, tried) = ", ".join(result.effects) or "none", TRIED[result.evaluator]
    console.print(
        f"{counted(result.evaluations, thing)} {tried}, {result.node_steps:.3g} node-steps in all on "
        f"{result.device}, {result.path}: {result.seconds['solve']:.2f} s solving after "
        f"{result.seconds['compile']:.2f} s compiling or loading kernels. Effects compiled in: {effects}."
    )
    output.print_accuracy(result, console)
    output.print_warnings(result, console)
