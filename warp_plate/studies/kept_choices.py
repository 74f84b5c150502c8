"""Choices of an engine and a grid, kept in the folder of Warp's kernels for the next command on the same scene."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate._version import __version__
from warp_plate.plate.files import digests
from warp_plate.result.atomic_io import SEAL_BYTES, is_intact, make_seal, write_atomically
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device, kernel_folder, processor_of

# Tables that do not affect a choice: the highest searched frequency is already that of an actuator.
UNREAD = {"title", "grid", "search", "record", "targets"}


def kept(scene: Scene, device: str, phasors: np.ndarray | None, engine: str, choose: Callable[[], Any]) -> Any:
    """Return plain data that ``choose`` returned for the same question, by the same program on the same processor.

    A file that is damaged or cannot be written is passed over.
    """
    processor = processor_of(find_device(device))
    drives = None if phasors is None else np.asarray(phasors, dtype=complex).tobytes().hex()
    question = [scene.model_dump_json(exclude=UNREAD), digests(scene), scene.grid.accuracy, processor, drives, engine]
    key = hashlib.sha256(json.dumps([*question, _program()]).encode()).hexdigest()
    file = kernel_folder() / "warp-plate" / f"{key}.json"
    if is_intact(file):
        return json.loads(file.read_bytes()[:-SEAL_BYTES])
    choice = choose()
    with suppress(OSError, SceneError):
        file.parent.mkdir(parents=True, exist_ok=True)
        content = json.dumps(choice).encode()
        write_atomically(content + make_seal(content), file)
    return choice


def _program() -> str:
    """Return the version and a digest of the program's own files, which change between versions too."""
    whole = hashlib.sha256(__version__.encode())
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        whole.update(file.read_bytes())
    return whole.hexdigest()
