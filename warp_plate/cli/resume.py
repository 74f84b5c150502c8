"""What ``localize --resume`` accepts beside a checkpoint, and what it says of it."""

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
        scene = output.with_asked_accuracy(checkpoint.asked, accuracy)
    _refuse_changes(file, checkpoint, scene, source or "--accuracy", options)
    if source is not None and scene is not None:
        folder = scene.folder  # the files that it names lie beside it, not beside the checkpoint
        checkpoint = replace(
            checkpoint, asked=checkpoint.asked.in_folder(folder), scene=checkpoint.scene.in_folder(folder)
        )
    for line in [*([word] if word else []), *_differences(file, checkpoint, device)]:
        output.tell(line)
    return checkpoint


def _refuse_changes(
    file: Path,
    checkpoint: Checkpoint,
    scene: Scene | None,
    source: str,
    options: dict[str, object],
) -> None:
    """Nothing, where a scene and options given beside a checkpoint are those of its search, or None.

    Raises:
        SceneError: another result would come of it; names what is not the same.
    """
    for name, value in options.items():
        begun = getattr(checkpoint, name)
        if value is not None and value != begun:
            raise SceneError(
                f"--{name} {value}: the search in {file} began with {begun}, and goes on with nothing else; leave the "
                "option out, or begin anew without --resume"
            )
    if scene is None:
        return
    given, begun = (dict(_leaves(one.model_dump())) for one in (scene, checkpoint.asked))
    for key in {"grid.accuracy": None, **begun, **given}:
        if given.get(key) != begun.get(key):
            raise SceneError(
                f"{source}: {key} = {given.get(key)}: the search in {file} began with {begun.get(key)}, and goes on "
                "with nothing else; leave it out, or begin anew without --resume"
            )


def _differences(file: Path, checkpoint: Checkpoint, device: str | None) -> list[str]:
    """A line for each thing that is not as it was when the search began and may move the last bits of its result.

    Raises:
        SceneError: no such device.
    """
    from warp_plate.search.localize import versions
    from warp_plate.solve.devices import find_device, processor_of

    lines = []
    if device is not None:
        here = processor_of(find_device(device))
        if here != checkpoint.processor:
            lines.append(
                f"{file}: began on {checkpoint.device} ({checkpoint.processor}) and goes on on {device} ({here}), "
                "which rounds in another way: the result may differ"
            )
    for name, now in versions().items():
        begun = checkpoint.versions.get(name, "another version")
        if begun != now:
            lines.append(f"{file}: began with {name} {begun}, this is {now}: the result may differ in its last digits")
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
