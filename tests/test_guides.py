"""The commands, Python code and TOML tables of README and the pages of the documentation run as printed."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from warp_plate import Scene
from warp_plate.scene.load import preset_text
from warp_plate.scene.measured import MeasuredScene
from warp_plate.scene.outline import with_drawing

DOCS = Path(__file__).parents[1] / "docs"
README = (DOCS.parent / "README.md").read_text(encoding="utf-8")
PAGES = sorted(DOCS.glob("*.md"))
# Commands and code that are not run, by a pattern, and why.
NOT_RUN = {
    r"\b(SCENE|RESULT|FORMAT|FILE|HOST|NAME)\b": "a placeholder",
    r"^warp-plate (explore|view)|^ssh ": "runs until Ctrl-C",
    r"^(pip|python) ": "installs, or measures",
    r"cuda|torch|jax": "needs a GPU, Torch or JAX",
    r"--cluster (tcp|scheduler|local)|^dask|^CUDA_|SLURMCluster": "needs a cluster; see tests/cluster",
    r"--samples 12000": "takes half an hour",
    r"design-thickness": "takes minutes; see tests/scene/test_examples.py",
    r"\.checkpoint\.h5$": "needs an interrupted run; see tests/cli/test_interrupts.py",
}
FOCUS = "[focus]\npoints = [[0.06, 0.05]]\nhighest = 1000.0"
# Files that pages use without making them, and how they are made.
MADE = {
    "panel.toml": f"warp-plate init paper --out panel.toml && echo '{FOCUS}' >> panel.toml",
    "paper-localize.h5": "warp-plate localize paper --no-pictures",
    "panel-frf.h5": "warp-plate init paper --out panel.toml; warp-plate frf panel.toml --to hdf5 --no-pictures",
    "paper-sweep.h5": "warp-plate sweep paper --force --vary drive.frequency=280:300:3 effects.damping.viscous=50,88.3",
}
# Tables beside those of the preset ``paper``, for printed tables that need them.
BESIDES = {
    "edges": {"left": {"translation": 1e6, "rotation": 1.0}},
    "effects": {
        "loss_factor": {"eta": 0.02},
        "oscillators": [{"area": [0.1, 0.12, 0.1, 0.12], "mass": 1e-3, "stiffness": 100.0}],
        "layers": [
            {"area": [x, x + 0.01, 0.0, 0.2], "thickness": 1e-4, "young_modulus": 1e9, "density": 1e3}
            for x in (0.05, 0.1)
        ],
    },
    "fit": {"free": {"plate.density": [900.0, 1100.0]}},
    "focus": {"points": [[0.06, 0.05]], "highest": 1000.0},
}
FOR_DESIGNS = {
    "design": {"thickness": {"range": [4e-4, 6e-4], "length_scale": 0.02}},
    "supports": [{"point": [0.05, 0.05], "stiffness": 1e4}],
}
# The drawing that an example names.
PANEL = """<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="200mm" viewBox="0 0 200 200">
<g id="cut"><rect width="200" height="200" rx="20"/><circle cx="120" cy="90" r="5"/></g></svg>"""


def fenced(page, language):
    """Return the fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


def commands(page):
    """Return the commands of the indented blocks of a page."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    blocks = re.findall(r"(?:\A|\n)\n((?: {4}.*\n)+)", text)
    lines = [line[4:].removeprefix("$ ") for block in blocks for line in block.replace("\\\n", "").splitlines()]
    return [line for line in lines if re.match(r"(warp-plate|cp|pip|python|dask|ssh|CUDA_\w+=\d) ", line)]


def runs(code):
    return not any(re.search(pattern, code, re.M) for pattern in NOT_RUN)


def call(arguments, folder):
    paths = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    run = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, env={**os.environ, "PATH": paths})
    assert run.returncode == 0, f"{arguments[-1]}\n{run.stderr}"
    return run.stdout


def make_files_of(text, folder):
    """Make the files that commands or code use, unless commands before have."""
    for file, command in MADE.items():
        if file in text and ("--force" in command or not (folder / file).exists()):
            call(["bash", "-c", command], folder)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_code_run(page, tmp_path):
    lines, code = (list(filter(runs, each)) for each in (commands(page), fenced(page, "python")))
    if not lines + code:
        pytest.skip("nothing to run")
    for needed in ("xarray", "pyvista", "cma"):
        pytest.importorskip(needed)
    (tmp_path / "docs").symlink_to(DOCS)
    for line in lines:
        make_files_of(line, tmp_path)
        call(["bash", "-c", line], tmp_path)
    if code:
        make_files_of("\n".join(code), tmp_path)
        call([sys.executable, "-c", "\n".join(code)], tmp_path)


@pytest.mark.parametrize(
    "block", [each for page in PAGES for each in fenced(page, "toml")], ids=lambda block: block.partition("\n")[0]
)
def test_tables_are_those_of_a_scene(block, tmp_path):
    if {"measured", "trade_off"} & tomllib.loads(block).keys():
        tables = {"measured": {"file": "scan.h5"}, "target": {"area": [0.0, 0.1, 0.0, 0.1]}}
        MeasuredScene.model_validate(tables | tomllib.loads(block))
        return
    tables = tomllib.loads(preset_text("paper"))
    del tables["grid"]
    besides = {"drive": {"burst": {"duration": 0.01}}} if "[search.delay]" in block else BESIDES
    besides = {**besides, **FOR_DESIGNS} if block.startswith("[design") else besides
    for others in (besides, tomllib.loads(block)):
        for name, table in others.items():
            tables[name] = {**tables.get(name, {}), **table} if isinstance(table, dict) else table
    if "[plate.outline]" in block:
        del tables["plate"]["size"]
        tables["edges"] = tomllib.loads(block).get("edges", {})
    if "[[targets]]" in block:
        del tables["target"]
    elif "target" in tomllib.loads(block):
        tables["target"] = tomllib.loads(block)["target"]
    (tmp_path / "panel.svg").write_text(PANEL)
    scene = Scene.from_tables(with_drawing(tables, tmp_path))
    assert Scene.parse(scene.to_toml(), "scene").model_dump() == scene.model_dump()


@pytest.mark.slow
@pytest.mark.parametrize("command", re.findall(r"`(warp-plate (?:localize|focus|frf|sweep) .*?)`", README))
def test_commands_of_the_readme_run(command, tmp_path):
    (tmp_path / "docs").symlink_to(DOCS)
    call(["bash", "-c", command], tmp_path)


@pytest.mark.slow
def test_output_of_the_readme(tmp_path):
    shown = re.search(r"```\n(localization factor.*?)```", README, re.S)[1].splitlines()
    printed = call([sys.executable, "-m", "warp_plate", "localize", "paper", "--device", "cpu"], tmp_path)
    assert not [line for line in shown if line != "..." and " ".join(line.split()) not in " ".join(printed.split())]


@pytest.mark.slow
def test_the_panel_of_the_readme(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.S)
    answer = call([sys.executable, "-c", code], tmp_path)
    assert re.search(r"```\n(In the target.*?)```", README, re.S)[1] in answer
    assert (tmp_path / "panel-surfaces.png").exists()
