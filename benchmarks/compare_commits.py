"""Run the same commands with two checkouts and compare every number in the files that they write, bit for bit.

    python benchmarks/compare_commits.py OLD NEW [--keep DIR]

OLD and NEW are checkouts of two commits; both run with this interpreter, on the CPU. The commands simulate every preset
and every example under docs/, search eight scenes, and sweep one. Datasets are matched by name. Those
that depend on the time of day or the machine's speed are left out. The exit status is 1 if any number differs or a
dataset is missing.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

SECONDS = re.compile(r"seconds|estimate|versions|uncertainty")
SEARCHED = ("bursts", "frequency", "places", "robust-touch-panel", "strong-and-quiet", "three-targets")
# Searches of examples are cut short to this.
FEW = {"particles": "8", "iterations": "6"}


def scenes(checkout, folder):
    """Copy presets and examples into a folder, their searches cut short; return their paths."""
    presets = sorted((checkout / "warp_plate" / "scene" / "presets").glob("*.toml"))
    examples = sorted(path for path in (checkout / "docs" / "examples").iterdir() if path.is_file())
    for path in [*presets, *examples]:
        text = path.read_text(encoding="utf-8")
        for key, value in FEW.items():
            text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        (folder / path.name).write_text(text, encoding="utf-8")
    return sorted(folder / path.name for path in [*presets, *examples] if path.suffix == ".toml")


def commands(folder, paths):
    """Yield the words of each command and the HDF5 file that it writes."""
    common = ("--device", "cpu", "--no-pictures", "--json")
    for path in paths:
        out = folder / f"simulate-{path.stem}.h5"
        yield ("simulate", str(path), "--no-estimate", *common, "--out", str(out)), out
    for path in (path for path in paths if path.stem in SEARCHED):
        out = folder / f"localize-{path.stem}.h5"
        yield ("localize", str(path), "--no-estimate", *common, "--out", str(out)), out
    for scene, seed in (("paper", 1), ("paper-supported", 2)):
        out = folder / f"localize-{scene}.h5"
        yield ("localize", scene, "--seed", str(seed), "--no-estimate", *common, "--out", str(out)), out
    out = folder / "sweep.h5"
    vary = ("drive.frequency=200:400:5", "effects.damping.viscous=log:10:300:3")
    yield ("sweep", "paper", "--vary", *vary, *common, "--out", str(out)), out


def run(checkout, folder, words):
    command = [sys.executable, "-m", "warp_plate", *words]
    environment = {**os.environ, "PYTHONPATH": str(checkout), "WARP_PLATE_THREADS": "2"}
    made = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if made.returncode:
        print(f"{' '.join(words)}: status {made.returncode}: {made.stderr.strip()[-400:]}")


def datasets(path):
    """Return every dataset and number-valued attribute of a file by its name."""
    found = {}

    def visit(name, item):
        name = name.replace("history ", "history/")  # as results of formats 3 and 4 name the same
        if isinstance(item, h5py.Dataset):
            found[name] = item[()]
        numbers = {key: value for key, value in item.attrs.items() if np.asarray(value).dtype.kind in "biufc"}
        found.update({f"{name}@{key}": value for key, value in numbers.items()})

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def same(first, second):
    first, second = np.asarray(first), np.asarray(second)
    if first.shape != second.shape or first.dtype != second.dtype:
        return False
    return bool(np.all(first == second)) if first.dtype.kind == "O" else first.tobytes() == second.tobytes()


def differences(old, new):
    """Return a line for each dataset of the old file that is missing or different in the new one."""
    if not old.exists() or not new.exists():
        return [f"{old.name}: not written by {'both' if not old.exists() and not new.exists() else 'one'}"]
    before, after = datasets(old), datasets(new)
    lines = [f"{old.name}: {name} is missing" for name in sorted(before.keys() - after.keys())]
    for name in sorted(before.keys() & after.keys()):
        if not SECONDS.search(name) and not same(before[name], after[name]):
            lines.append(f"{old.name}: {name} differs")
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--keep", type=Path, help="folder for the files; results of OLD found there are used again")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        root = (options.keep or Path(temporary)).resolve()
        lines = []
        for side in ("old", "new"):
            folder = root / side
            folder.mkdir(parents=True, exist_ok=True)
            paths = scenes(options.old.resolve(), folder)
            for words, out in commands(folder, paths):
                if side == "new" or not out.exists():
                    out.unlink(missing_ok=True)
                    run(getattr(options, side).resolve(), folder, words)
        for old in sorted((root / "old").glob("*.h5")):
            lines += differences(old, root / "new" / old.name)
    print("\n".join(lines) or "all numbers are the same")
    sys.exit(bool(lines))


if __name__ == "__main__":
    main()
