"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from warp_plate.scene.errors import SceneError


@contextmanager
def written_whole(*paths: Path) -> Iterator[list[Path]]:
    """Names to write to instead of ``paths``; they take the paths' places, in this order, once the block ended well.

    Where it has not, for an error or Ctrl-C, nothing is left behind and older files stay as they were.

    Raises:
        SceneError: a folder is missing or cannot be written to, or the disk is full; names the last path.
    """
    temporaries: list[Path] = []
    try:
        for path in paths:
            handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
            os.close(handle)
            temporaries.append(Path(name))
        yield temporaries
        # mkstemp makes files private; these are to be as readable as any file that the user writes.
        mask = os.umask(0)
        os.umask(mask)
        for temporary, path in zip(temporaries, paths, strict=True):
            os.chmod(temporary, 0o666 & ~mask)
            os.replace(temporary, path)
    except OSError as error:
        raise SceneError(f"{paths[-1]}: cannot be written: {error}") from None
    finally:
        for temporary in temporaries:
            temporary.unlink(missing_ok=True)
