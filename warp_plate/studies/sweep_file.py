"""Files of a sweep: the unfinished one that it continues from, and those that its result may replace."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from warp_plate.result.checkpoint import ENDING
from warp_plate.result.sweep import Sweep, load_sweep, save_sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.vary import Plan, make_plan, parse_vary
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies import provenance
from warp_plate.studies.checkpointing import SweepFile
from warp_plate.studies.sweep import file_digests, start_sweep

# Values of options that are left out; None: a new sweep chooses, another one keeps its own.
DEFAULTS = {"what": "localize", "count": 6, "path": "auto", "evaluator": None, "frequencies": ""}


@dataclass(frozen=True)
class SweepRequest:
    """Arguments of :func:`warp_plate.studies.sweep.sweep` as a user gives them; None for those left out."""

    scene: Scene | None
    source: str
    vary: Sequence[str] | None = None
    what: str | None = None
    samples: int | None = None
    seed: int | None = None
    count: int | None = None
    path: str | None = None
    evaluator: str | None = None
    frequencies: str | None = None

    def options(self, complete: bool) -> dict[str, Any]:
        """Return the options that a sweep keeps, by its attributes; those left out have their defaults if complete."""
        given = {name: getattr(self, name) for name in DEFAULTS}
        return {name: DEFAULTS[name] if complete and value is None else value for name, value in given.items()}

    def plan(self, scene: Scene) -> Plan:
        """Return the points asked for; ``scene`` has the numbers to vary."""
        return make_plan([parse_vary(scene, text) for text in self.vary or ()], self.samples, self.seed or 0)


def open_sweep(
    request: SweepRequest,
    target: Path,
    resume: Path | None = None,
    device: str | None = None,
    on_workers: bool = False,
    log: Callable[[str], object] = lambda line: None,
    force: bool = False,
) -> Sweep:
    """Return the sweep to run for a request: the unfinished one of the same request, or a new one.

    Args:
        target: file of the result; unfinished sweeps are beside it.
        resume: unfinished sweep to continue, or the result that it will become; None: one left by the same request, if
            any.
        device: device of the points, or None for the default.
        on_workers: whether workers of a pool run the points, which then report their devices.
        log: called with one line for each thing to know about a sweep that is continued.
        force: whether the result may replace any file.
    """
    unfinished = target.with_suffix(ENDING)
    file = unfinished if unfinished.exists() else None
    if resume is not None:
        beside = resume.with_suffix(ENDING)
        file = beside if beside.exists() else resume
        if unfinished.exists() and not unfinished.samefile(file):
            raise SceneError(f"{unfinished}: holds another unfinished sweep; name another file by --out, or delete it")
    if file is not None:
        sweep = _load_unfinished(file, request, resume is not None)
    else:
        assert request.scene is not None
        scene, here = request.scene, "auto" if on_workers or device is None else device
        options = request.options(complete=True)
        sweep = start_sweep(scene, request.plan(scene), device=here, source=request.source, **options)
    axes = {output.axis for output in sweep.outputs.values()}
    if request.count is not None and "mode" not in axes:
        raise SceneError(f"--count {request.count}: --what {sweep.what} has no modes to count; leave it out")
    if request.frequencies is not None and "frequency" not in axes:
        raise SceneError(f"--frequencies {request.frequencies}: are those of --what frf; leave it out")
    if not force:
        check_replaceable(target, sweep)
    if file is None:
        return sweep
    log(f"{file}: {sweep.progress} done; {'nothing is left' if sweep.finished else 'continuing'}")
    for line in provenance.changes(sweep, None if on_workers or not sweep.processor else device):
        log(f"{file}: {line}")
    return resume_sweep(sweep, device, on_workers)


def resume_sweep(sweep: Sweep, device: str | None = None, on_workers: bool = False) -> Sweep:
    """Return an unfinished sweep as it continues on workers of a pool, on another device, which may round differently,
    or by default on one of the kind that it began on."""
    provenance.check_files(file_digests(sweep.scene, sweep.plan), sweep, "sweep")
    if sweep.finished:
        return sweep
    sweep = replace(sweep, versions=provenance.merged_versions(sweep.versions))
    if on_workers:
        return sweep
    if device is None:
        device = provenance.same_device(sweep.device, sweep.processor, "sweep") if sweep.processor else "auto"
    found = find_device(device)
    return sweep.moved_to(found.alias, processor_of(found))


def save_finished(sweep: Sweep, path: Path, file: SweepFile, force: bool = False) -> None:
    """Save a finished sweep as its result and remove the unfinished file; on failure all points are in that file."""
    try:
        if not force:
            check_replaceable(path, sweep)
        save_sweep(sweep, path)
    except SceneError:
        file.save(sweep)
        raise
    file.remove()


def check_replaceable(path: Path, sweep: Sweep) -> None:
    """Check that a result would replace no file other than an earlier result of the same sweep."""
    if not path.exists():
        return
    advice = "name another file by --out, or give --force"
    try:
        existing = load_sweep(path)
    except SceneError as error:
        raise SceneError(f"{error}; {advice}") from None
    same_scene = existing.scene.model_dump() == sweep.scene.model_dump() and existing.files == sweep.files
    for difference, same in (
        ("another scene", same_scene),
        (f"--what {existing.what}", existing.what == sweep.what),
        (f"--count {existing.count}", existing.count == sweep.count),
        (f"--frequencies {existing.frequencies}", existing.frequencies == sweep.frequencies),
        (f"--evaluator {existing.evaluator}", existing.evaluator == sweep.evaluator),
        (f"other points ({existing.plan.description})", existing.plan.same(sweep.plan)),
    ):
        if not same:
            raise SceneError(f"{path}: holds a sweep of {difference}; {advice}")


def _load_unfinished(file: Path, request: SweepRequest, resumed: bool) -> Sweep:
    """Load an unfinished sweep for a request, all of which must be the same if it was not named by ``--resume``."""
    advice = "start again without --resume" if resumed else f"name another file by --out, or delete {file}"
    try:
        sweep = load_sweep(file)
    except SceneError as error:
        raise error if resumed else SceneError(f"{error}; {advice}") from None
    options = request.options(complete=not resumed)
    provenance.check_unchanged(sweep, f"sweep in {file}", options, (request.scene, sweep.scene), advice)
    if (request.vary or not resumed) and not request.plan(sweep.scene).same(sweep.plan):
        raise SceneError(
            f"--vary: the sweep in {file} began with other points ({sweep.plan.description}) and continues with "
            f"nothing else; {'leave --vary out, or ' if resumed else ''}{advice}"
        )
    # Files that the scene names are beside the scene, not beside the sweep.
    return sweep if request.scene is None else replace(sweep, scene=sweep.scene.in_folder(request.scene.folder))
