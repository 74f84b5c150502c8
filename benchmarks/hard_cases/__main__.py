"""Measures the catalogue of hard cases on a device: a table, a JSON file, and a picture of the figures.

    python benchmarks/hard_cases                                  # here, with as many steps as the catalogue asks for
    python benchmarks/hard_cases --short --only limit             # fewer steps, and cases with this in their names
    python benchmarks/hard_cases --device cuda --out h200.json
    python benchmarks/hard_cases --only decay lossless --into benchmarks/results/hard-cases-cpu.json  # these rows anew
    python benchmarks/hard_cases --page docs/hard-cases.md CPU=a.json H200=b.json   # figures into the page's table
    python benchmarks/hard_cases --picture docs/images/hard-cases.png CPU=a.json H200=b.json   # and into a picture

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
sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from hard_cases.case import Case, Where
from hard_cases.catalogue import CASES
from warp_plate.solve.devices import find_device
from warp_plate.studies.unfinished import device_name, versions

PRECISIONS = ("float32", "float64")
# Of the picture: colours of the precisions, markers of the files, least share of the allowed value that is drawn.
COLOURS, MARKERS, LEAST = {"float32": "#d95f02", "float64": "#08519c"}, "oD^sv", 1e-7
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
    parser.add_argument("files", nargs="*", help="for --page and --picture: COLUMN=FILE.json ...")
    asked = parser.parse_args()
    columns = {pair.split("=", 1)[0]: json.loads(Path(pair.split("=", 1)[1]).read_text()) for pair in asked.files}
    for target, use in ((asked.page, write_table), (asked.picture, draw)):
        if target:
            use(target, columns)
    if columns:
        return
    device = find_device(asked.device)
    wanted = [word.lower() for word in asked.only]
    chosen = [case for case in CASES if any(word in f"{case.group} {case.name}".lower() for word in wanted)]
    rows = []
    try:
        for case in chosen:
            rows.append(measured(case, device.alias, not asked.short))
            print(line(rows[-1]), flush=True)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    found = {"device": device_name(device), "versions": versions(), "long": not asked.short, "cases": rows}
    for path in (asked.out, asked.into):
        if path:
            whole = merged(found, json.loads(path.read_text(encoding="utf-8"))) if path is asked.into else found
            path.write_text(json.dumps(whole, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    failed = [row["name"] for row in rows if not row["kept"]]
    print(f"{len(rows) - len(failed)} of {len(rows)} cases as asked" + "".join(f"\nnot: {name}" for name in failed))
    sys.exit(bool(failed))


def merged(found: dict[str, object], before: dict[str, object]) -> dict[str, object]:
    """Return the new results, completed by earlier rows of the catalogue."""
    if (found["device"], found["long"]) != (before["device"], before["long"]):
        sys.exit(f"--into: that file is of {before['device']}, long: {before['long']}")
    rows = {row["name"]: row for row in [*before["cases"], *found["cases"]]}  # type: ignore[misc]
    return {**found, "cases": [rows[case.name] for case in CASES if case.name in rows]}


def measured(case: Case, device: str, long: bool) -> dict[str, object]:
    """A row of the table."""
    values: dict[str, dict[str, float | None]] = {}
    slowdowns: dict[str, float] = {}
    kept, started = True, time.perf_counter()
    for precision in PRECISIONS:
        values[precision] = {}
        for path in ("resident", "streaming"):
            found = case.measure(Where(device, path, precision, long and path == "resident"))
            values[precision][path] = float(found.value) if math.isfinite(found.value) else None
            kept = kept and bool(found.value <= case.allowed[precision])
            if found.slowdown is not None:
                slowdowns[precision] = round(found.slowdown, 3)
    return {
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


def write_table(page: Path, columns: dict[str, dict[str, list[dict[str, object]]]]) -> None:
    """Rewrite the lines of a page between BEGIN and END."""
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


def draw(path: Path, columns: dict[str, dict[str, list[dict[str, object]]]]) -> None:
    """A row for each case, by groups: the measured share of what is allowed, for every file and precision."""
    from matplotlib.figure import Figure

    rows = next(iter(columns.values()))["cases"]
    groups = list(dict.fromkeys(row["group"] for row in rows))
    heights = [sum(row["group"] == group for row in rows) + 1 for group in groups]
    figure = Figure(figsize=(7.4, 0.155 * sum(heights) + 1.0), layout="constrained")
    panels = figure.subplots(len(groups), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    for axes, group in zip(panels, groups, strict=True):
        names = [row["name"] for row in rows if row["group"] == group]
        for marker, (column, found) in zip(MARKERS, columns.items(), strict=False):
            for precision, colour in COLOURS.items():
                shares = {row["name"]: share_of_allowed(row, precision) for row in found["cases"]}
                look = {"marker": marker, "color": colour, "markersize": 4, "alpha": 0.75, "clip_on": False}
                look["markerfacecolor"] = colour if marker == MARKERS[0] else "none"
                look |= {"linestyle": "", "label": f"{column}, {precision}"}
                axes.plot([shares.get(name, math.nan) for name in names], range(len(names)), **look)
        axes.axvspan(1, 1e2, color="#b2182b", alpha=0.12, linewidth=0)
        axes.set(xscale="log", xlim=(LEAST, 10), ylim=(len(names) - 0.4, -0.6))
        axes.set_yticks(range(len(names)), names, fontsize=7)
        axes.set_title(group, fontsize=8.5, loc="left", fontweight="bold")
        axes.tick_params(axis="y", length=0)
        axes.grid(True, axis="both", linewidth=0.3, color="#cccccc")
        axes.spines[["top", "right", "left"]].set_visible(False)
    decades = range(round(math.log10(LEAST)) + 1, 1)
    ends = [f"≤ 10$^{{{decades[0] - 1}}}$", *(f"10$^{{{power}}}$" if power else "1" for power in decades)]
    panels[-1].set_xticks([LEAST, *(10.0**power for power in decades)], ends, fontsize=8)
    panels[-1].minorticks_off()
    panels[-1].set_xlabel("measured over allowed; in the red band a case fails", fontsize=8.5)
    handles = panels[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=len(handles[0]), fontsize=8, frameon=False)
    figure.savefig(path, dpi=125)


def share_of_allowed(row: dict[str, object], precision: str) -> float:
    """The larger value of the two paths over the allowed one, within what is drawn; 10 for one that fails."""
    values, allowed = row["measured"][precision].values(), row["allowed"][precision]  # type: ignore[index]
    if None in values:
        return 10.0
    share = max(values) / allowed if allowed else (10.0 if max(values) else 0.0)
    return min(max(share, LEAST), 10.0)


if __name__ == "__main__":
    main()
