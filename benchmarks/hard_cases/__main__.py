"""Measures the catalogue of hard cases on a device: a table, a JSON file, and a picture of each case.

    python benchmarks/hard_cases                                  # here, with as many steps as the catalogue asks for
    python benchmarks/hard_cases --short --only limit             # fewer steps, and cases with this in their names
    python benchmarks/hard_cases --device cuda --out h200.json --picture hard-cases.png
    python benchmarks/hard_cases --only decay lossless --into benchmarks/results/hard-cases-cpu.json  # these rows anew
    python benchmarks/hard_cases --page docs/hard-cases.md CPU=a.json H200=b.json   # figures into the page's table

Numbers need warp-plate alone, the picture Matplotlib. The resident path takes all steps; the streaming path, which
launches kernels for every step, a short form of each case.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from hard_cases.case import Case, Measured, Where
from hard_cases.catalogue import CASES
from warp_plate.solve.devices import find_device
from warp_plate.studies.provenance import device_name, versions

PRECISIONS = ("float32", "float64")
# Of the picture: panels in a row, how curves of both precisions look, and the colours of plates.
COLUMNS, COLOURS = 5, "RdBu_r"
STYLES = ({"linewidth": 2.4, "color": "#9ecae1"}, {"linewidth": 0.8, "color": "#1a1a1a"})
BEGIN, END = "<!-- table of hard cases -->", "<!-- end of the table -->"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--only", nargs="+", default=[""], help="cases with one of these in their names or groups")
    parser.add_argument("--short", action="store_true", help="fewer steps, as in the tests")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--into", type=Path, help="JSON file of this device whose rows of these cases are replaced")
    parser.add_argument("--picture", type=Path, help="PNG file to draw")
    parser.add_argument("--page", type=Path, help="page whose table is written anew from the files")
    parser.add_argument("files", nargs="*", help="for --page: COLUMN=FILE.json ...")
    asked = parser.parse_args()
    if asked.page:
        write_table(asked.page, dict(pair.split("=", 1) for pair in asked.files))
        return
    device = find_device(asked.device)
    wanted = [word.lower() for word in asked.only]
    chosen = [case for case in CASES if any(word in f"{case.group} {case.name}".lower() for word in wanted)]
    rows, pictures = [], []
    try:
        for case in chosen:
            row, shown = measured(case, device.alias, not asked.short)
            rows.append(row)
            pictures.append((case, shown))
            print(line(row), flush=True)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    found = {"device": device_name(device), "versions": versions(), "long": not asked.short, "cases": rows}
    for path in (asked.out, asked.into):
        if path:
            whole = merged(found, json.loads(path.read_text(encoding="utf-8"))) if path is asked.into else found
            path.write_text(json.dumps(whole, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if asked.picture:
        draw(pictures, asked.picture)
    failed = [row["name"] for row in rows if not row["kept"]]
    print(f"{len(rows) - len(failed)} of {len(rows)} cases as asked" + "".join(f"\nnot: {name}" for name in failed))
    sys.exit(bool(failed))


def merged(found: dict[str, object], before: dict[str, object]) -> dict[str, object]:
    """What was found, with the rows of the catalogue that it lacks from before."""
    if (found["device"], found["long"]) != (before["device"], before["long"]):
        sys.exit(f"--into: that file is of {before['device']}, long: {before['long']}")
    rows = {row["name"]: row for row in [*before["cases"], *found["cases"]]}  # type: ignore[misc]
    return {**found, "cases": [rows[case.name] for case in CASES if case.name in rows]}


def measured(case: Case, device: str, long: bool) -> tuple[dict[str, object], dict[str, Measured]]:
    """A row of the table, and what the picture shows, by precision."""
    values: dict[str, dict[str, float | None]] = {}
    slowdowns: dict[str, float] = {}
    shown = {}
    kept, started = True, time.perf_counter()
    for precision in PRECISIONS:
        values[precision] = {}
        for path in ("resident", "streaming"):
            found = case.measure(Where(device, path, precision, long and path == "resident"))
            shown.setdefault(precision, found)
            values[precision][path] = float(found.value) if math.isfinite(found.value) else None
            kept = kept and bool(found.value <= case.allowed[precision])
            if found.slowdown is not None:
                slowdowns[precision] = round(found.slowdown, 3)
    row = {
        "group": case.group,
        "name": case.name,
        "asked": case.asked,
        "quantity": case.quantity,
        "allowed": dict(case.allowed),
        "measured": values,
        **({"slowdown": slowdowns} if slowdowns else {}),
        "kept": kept,
        "seconds": round(time.perf_counter() - started, 2),
    }
    return row, shown


def largest(row: dict[str, object], precision: str) -> str:
    """The larger value of the two paths, for people; and where runs were timed, the longest over the usual one."""
    values = row["measured"][precision].values()  # type: ignore[index]
    slowdown = row.get("slowdown", {}).get(precision)  # type: ignore[attr-defined]
    timed = "" if slowdown is None else f" ({slowdown:.2f})"
    return "fails" if None in values else f"{max(values):.2g}{timed}"


def line(row: dict[str, object]) -> str:
    """A row for people."""
    told = "as asked" if row["kept"] else "NOT AS ASKED"
    both = ", ".join(f"{precision} {largest(row, precision)}" for precision in PRECISIONS)
    return f"{row['name']}: {row['quantity']}: {both}: {told} ({row['seconds']} s)"


def write_table(page: Path, files: dict[str, str]) -> None:
    """Rewrite the lines of a page between BEGIN and END."""
    columns = {name: json.loads(Path(file).read_text(encoding="utf-8")) for name, file in files.items()}
    heads = [f"{name} {precision}" for name in columns for precision in PRECISIONS]
    lines = ["| case | what is asked | what is measured | allowed f32, f64 | " + " | ".join(heads) + " |"]
    lines.append("| --- " * (4 + len(heads)) + "|")
    cells = {name: {row["name"]: row for row in found["cases"]} for name, found in columns.items()}
    for row in next(iter(columns.values()))["cases"]:
        allowed = ", ".join(f"{row['allowed'][precision]:g}" for precision in PRECISIONS)
        values = [
            largest(cells[name][row["name"]], precision) if row["name"] in cells[name] else ""
            for name in columns
            for precision in PRECISIONS
        ]
        words = [row["name"], row["asked"], row["quantity"].replace("|", "\\|"), allowed, *values]
        lines.append("| " + " | ".join(words) + " |")
    text = page.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    page.write_text(before + BEGIN + "\n" + "\n".join(lines) + "\n" + END + after, encoding="utf-8")


def draw(pictures: list[tuple[Case, dict[str, Measured]]], path: Path) -> None:
    """A panel for each case: its curve in both precisions, or the plate as shares of its largest value."""
    import textwrap

    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    rows = max(1, math.ceil(len(pictures) / COLUMNS))
    figure = Figure(figsize=(3.1 * COLUMNS, 2.5 * rows), layout="constrained")
    panels, lines = [], []
    for index, (case, shown) in enumerate(pictures):
        axes = figure.add_subplot(rows, COLUMNS, index + 1)
        panels.append(axes)
        axes.set_title(textwrap.fill(case.name, 34), fontsize=9)
        axes.tick_params(labelsize=8)
        last = shown["float64"]
        if last.curve is None and last.shape is not None:
            shape = shown["float32"].shape if case.name.startswith("rounding") else last.shape
            end = abs(shape[shape == shape]).max(initial=0.0)
            axes.imshow(shape / (end or 1.0), origin="lower", aspect="auto", cmap=COLOURS, vmin=-1, vmax=1)
            axes.set(xticks=[], yticks=[])
            axes.set_xlabel(f"largest {end:.2g}" if end else "at rest", fontsize=8)
            continue
        for precision, style in zip(PRECISIONS, STYLES, strict=True):
            if shown[precision].curve is not None:
                x, y, name_x, name_y = shown[precision].curve
                lines = [*lines, *axes.plot(x, y, label=precision, **style)]
                axes.set_xlabel(name_x, fontsize=8)
                axes.set_ylabel(name_y, fontsize=8)
    bar = figure.colorbar(
        ScalarMappable(Normalize(-1, 1), colormaps[COLOURS]),
        ax=panels,
        location="top",
        shrink=0.3,
        aspect=40,
        pad=0.006,
    )
    bar.set_label("plates: share of the largest value in the panel")
    figure.legend(handles=lines[:2], loc="upper left", title="curves", frameon=False)
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
