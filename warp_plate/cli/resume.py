"""What ``--resume`` accepts beside a checkpoint, and what it says of it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from warp_plate.cli import output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from warp_plate.result.checkpoint import Checkpoint
    from warp_plate.result.sweep import Sweep
    from warp_plate.scene.model import Scene


def result_beside(checkpoint: Path) -> Path:
    """Where the result goes without ``--out``: NAME.h5 for NAME.checkpoint.h5 or the one before it."""
    stem = checkpoint.name.removesuffix(".h5").removesuffix(".previous")
    named = stem.endswith(".checkpoint")
    return checkpoint.parent / (stem.removesuffix(".checkpoint") + (".h5" if named else "-localize.h5"))


def way_on(checkpoint: Checkpoint, file: Path) -> str:
    """How far the search is, and the command that goes on with it."""
    return f" after {checkpoint.progress}; go on with: warp-plate localize --resume {shlex.quote(str(file))}"


def read_checkpoint(
    file: Path,
    scene: Scene | None,
    source: str | None,
    accuracy: str | None,
    options: dict[str, object],
    device: str | None,
) -> Checkpoint:
    """The checkpoint, or the one before it where it is damaged; tells what a user should know of it.

    scene, accuracy, options, device: what was given beside it, None where it was not.

    Raises:
        SceneError: it cannot be read, or what was given is not that of its search.
    """
    from warp_plate.result.checkpoint import load_newest

    checkpoint, word = load_newest(file)
    if scene is None and accuracy is not None:
        scene = output.with_asked_accuracy(checkpoint.scene_as_written, accuracy)
    refuse_changes(checkpoint, f"search in {file}", checkpoint.scene_as_written, scene, source or "--accuracy", options)
    if source is not None and scene is not None:
        folder = scene.folder  # the files that it names lie beside it, not beside the checkpoint
        checkpoint = replace(
            checkpoint,
            scene_as_written=checkpoint.scene_as_written.in_folder(folder),
            scene=checkpoint.scene.in_folder(folder),
        )
    for line in [*([word] if word else []), *differences(file, checkpoint, device)]:
        output.tell(line)
    return checkpoint


def refuse_changes(
    begun: object,
    what: str,
    asked: Scene,
    scene: Scene | None,
    source: str,
    options: dict[str, object],
    anew: str = "begin anew without --resume",
) -> None:
    """Nothing, where a scene and options given beside a checkpoint are those that it began with, or None.

    begun: has what it began with, by the options' names; what: it is, and in which file; asked: its scene; source: the
    name of the one that is given; anew: what else could be done.

    Raises:
        SceneError: another result would come of it; names what is not the same.
    """
    for name, value in options.items():
        before = getattr(begun, name)
        if value is not None and value != before:
            raise SceneError(
                f"--{name} {value}: the {what} began with {before}, and goes on with nothing else; leave the option "
                f"out, or {anew}"
            )
    if scene is None:
        return
    given, known = (dict(_leaves(one.model_dump())) for one in (scene, asked))
    for key in {"grid.accuracy": None, **known, **given}:
        if given.get(key) != known.get(key):
            raise SceneError(
                f"{source}: {key} = {given.get(key)}: the {what} began with {known.get(key)}, and goes on with nothing "
                f"else; leave it out, or {anew}"
            )


def differences(file: Path, begun: Checkpoint | Sweep, device: str | None) -> list[str]:
    """A line for each thing that is not as it was when it began and may move the last bits of its result.

    Raises:
        SceneError: no such device.
    """
    from warp_plate.solve.devices import find_device, processor_of
    from warp_plate.studies.localize import versions

    lines = []
    if device is not None:
        here = processor_of(find_device(device))
        if here != begun.processor:
            lines.append(
                f"{file}: began on {begun.device} ({begun.processor}) and goes on on {device} ({here}), "
                "which rounds in another way: the result may differ"
            )
    for name, now in versions().items():
        before = begun.versions.get(name, "another version")
        if before != now:
            lines.append(f"{file}: began with {name} {before}, this is {now}: the result may differ in its last digits")
    return lines


def _leaves(table: dict[str, object], head: str = "") -> Iterator[tuple[str, object]]:
    """(dotted key, value) of all that is in tables within tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{head}{key}.")
        elif isinstance(value, tuple) and value and all(isinstance(entry, dict) for entry in value):
            for index, entry in enumerate(value):
                yield from _leaves(entry, f"{head}{key}[{index}].")
        else:
            yield f"{head}{key}", value
