"""Files that a scene names: found beside the scene file, bounded, and read as bytes or as a table of numbers."""

from __future__ import annotations

from pathlib import Path

from warp_plate.scene.errors import SceneError

MOST_BYTES = 2**27


def read_beside(key: str, name: str, folder: Path | None) -> bytes:
    """The content of the file ``name`` in the scene's folder, which ``key`` of the scene names.

    Raises:
        SceneError: no folder, no such file in it, or a large one; one line with key and file.
    """
    head = f"{key} = {name!r}"
    if folder is None:
        raise SceneError(f"{head}: this scene was not read from a file, so no folder is known; say which")
    try:
        path = (folder / name).resolve()
        if path.parent != folder.resolve():
            raise SceneError(f"{head}: leads out of the scene's folder; put a copy of the file there")
        if not path.is_file():
            raise SceneError(f"{head}: no such file beside the scene file")
        if path.stat().st_size > MOST_BYTES:
            raise SceneError(f"{head}: {path.stat().st_size} bytes; at most {MOST_BYTES} are read")
        return path.read_bytes()
    except (OSError, RuntimeError) as error:
        raise SceneError(f"{head}: cannot be read: {type(error).__name__}") from None


def number_rows(data: bytes) -> list[tuple[int, list[float]]]:
    """The lines of a text table with their numbers in the file, counted from 1.

    Columns are parted by commas, semicolons or tabs; a first line without a number in it, empty lines and # lines are
    passed over.

    Raises:
        ValueError: not UTF-8, a cell is no number, or lines differ in length.
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("not UTF-8 text") from None
    lines = [(number, line) for number, line in enumerate(text.split("\n"), 1) if line.strip()]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    rows: list[tuple[int, list[float]]] = []
    for place, (number, line) in enumerate(lines):
        cells = line.replace(";", ",").replace("\t", ",").split(",")
        row = [value for cell in cells if (value := _number(cell)) is not None]
        if place == 0 and not row:
            continue
        if len(row) < len(cells):
            raise ValueError(f"line {number} is not made of numbers")
        if rows and len(row) != len(rows[0][1]):
            raise ValueError(f"line {number} has {len(row)} columns instead of {len(rows[0][1])} as above it")
        rows.append((number, row))
    return rows


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
