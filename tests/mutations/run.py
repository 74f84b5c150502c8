"""Plant faults one at a time in a copy of the project, and list those that the tests do not catch.

    python tests/mutations/run.py [--tree DIR] [--python EXE] [--full] [NAME ...]

Each fault of faults.toml replaces one piece of text, found by its content in ``kernels``, ``viz`` or ``warp_plate``.
The test files named beside it run first, until one test fails; with ``--full`` the whole default suite follows where
they pass. ``--tree`` names another checkout to test with the same faults, such as that of an earlier commit. The exit
status is 1 if a fault survives.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
PRODUCT = ("kernels", "viz", "warp_plate")


def plant(tree, fault):
    """Write the fault into the tree; return the file that it is in."""
    files = [path for folder in PRODUCT for path in sorted((tree / folder).rglob("*.py"))]
    for find, replace in zip(fault["find"], fault["replace"], strict=True):
        places = [path for path in files if find in path.read_text(encoding="utf-8")]
        if places:
            text = places[0].read_text(encoding="utf-8")
            places[0].write_text(text.replace(find, replace, 1), encoding="utf-8")
            return places[0]
    raise SystemExit(f"{fault['name']}: its text is nowhere in the project; adapt faults.toml")


def caught(tree, python, words):
    """Return the first test that fails, "" if all pass."""
    command = [python, "-m", "pytest", "-q", "-x", "-n", "0", *words]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    run = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    failed = [line.split(" - ")[0] for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return "" if run.returncode == 0 else [*failed, f"status {run.returncode}"][0]


def try_fault(tree, python, fault, full):
    """Plant a fault in a copy of the tree; return its file and what caught it."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(tree, copy, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache"))
        place = plant(copy, fault).relative_to(copy)
        names = {f"test_{name}.py" for name in fault["tests"]}
        paths = [str(path) for path in sorted((copy / "tests").rglob("test_*.py")) if path.name in names]
        return place, (caught(copy, python, paths) if paths else "") or (caught(copy, python, []) if full else "")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("names", nargs="*", help="faults to plant (default: all)")
    parser.add_argument("--tree", type=Path, default=HERE.parents[1], help="checkout to test (default: this one)")
    parser.add_argument("--python", default=sys.executable, help="interpreter (default: this one)")
    parser.add_argument("--full", action="store_true", help="run the whole suite where the named tests pass")
    options = parser.parse_args()
    faults = tomllib.loads((HERE / "faults.toml").read_text(encoding="utf-8"))["fault"]
    survived = 0
    for fault in faults:
        if options.names and fault["name"] not in options.names:
            continue
        started = time.perf_counter()
        place, test = try_fault(options.tree.resolve(), options.python, fault, options.full)
        survived += not test
        print(f"{fault['name']}: {place}: {test or 'SURVIVED'} ({time.perf_counter() - started:.0f} s)", flush=True)
    sys.exit(bool(survived))


if __name__ == "__main__":
    main()
