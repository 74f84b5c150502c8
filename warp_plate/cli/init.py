"""``warp-plate init NAME``: a preset as a scene file to edit."""

from __future__ import annotations

from pathlib import Path

from warp_plate.scene.errors import SceneError, printable


def init(name: str, /, *, out: Path | None = None) -> None:
    """Write a preset as a TOML file to edit.

    Parameters
    ----------
    name
        The preset: paper, paper-supported, touch-panel, cantilever-display, composite-panel, large-amplitude,
        focusing-glass or four-fingers.
    out
        The file to write (default: NAME.toml in this folder). An existing file is never overwritten.
    """
    from warp_plate.scene.load import preset_text

    text = preset_text(name)
    path = out or Path(f"{name}.toml")
    try:
        file = path.open("x", encoding="utf-8")
    except FileExistsError:
        raise SceneError(f"{path}: exists already; choose another name with --out") from None
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: cannot be written: {error}") from None
    try:
        with file:
            file.write(text)
    except OSError as error:
        path.unlink()
        raise SceneError(f"{path}: cannot be written: {error}") from None
    print(printable(f"wrote {path}; run it with: warp-plate localize {path}"))
