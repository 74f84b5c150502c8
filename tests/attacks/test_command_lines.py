"""Command lines of any options, values and names: a result without NaN, or one line and status 2."""

import re
from pathlib import Path

import pytest
from conftest import examples
from hypothesis import given
from hypothesis import strategies as st

COMMON = "--device --json --set --accuracy --path --out --force --help"
OPTIONS = {
    "simulate": "--allow-unstable --drive --no-estimate",
    "localize": "--baselines --checkpoint-every --evaluator --no-estimate --no-spectrum --resume --seed --devices",
    "modes": "--count --no-grid --grid",
    "frf": "--at --from --quantity --range --to",
    "focus": "--waveforms",
    "check": "--allow-unstable",
    "sweep": "--count --evaluator --frequencies --resume --samples --seed --vary --what",
    "compare": "--evaluations --evaluator --methods --seeds",
    "accuracy": "--budget",
    "effects": "",
    "init": "",
    "render": "--case --end --field --frames --heights --modes --plan --rate --start --time --width",
    "export": "--case --duration --encoding --end --frames --full-scale --rate --start --to",
}
DRAW = {"simulate", "localize", "modes", "frf", "focus", "sweep", "compare", "accuracy"}
NAMES = [*["panel.toml"] * 3, "none", "", "-", ".", "text.h5", "\x1b[2J.toml", "caf\udce9.toml", "a\nb"]
PLAIN = """
    0 1 2 -1 1.5 nan inf -inf 1e400 1% 0% 1e-300 ² ٣ 1,2 cpu cuda:9 equal single 1,0,0 1@90,nan,0 1:2:3 modal
    resident result.h5 no/such.h5 drive.frequency=280,290 drive.frequency=nan drive.frequency=280 grid.nodes=[1,1]
    search.seed=-1 plate.size=[1e-300,1] effects.damping.viscous=1e300 plate.thickness=1e-320 a.b.c= = [[ mean
"""
VALUES = [*PLAIN.split(), *NAMES, "9" * 5000]
WORDS = st.one_of(st.sampled_from(VALUES), st.sampled_from(VALUES), st.text(max_size=6))


@st.composite
def command_lines(draw):
    command = draw(st.sampled_from(sorted(OPTIONS)))
    line = [command, *draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=2 if draw(st.booleans()) else 1))]
    options = st.sampled_from((OPTIONS[command] + " " + COMMON).split())
    for option, value in draw(st.lists(st.tuples(options, st.none() | WORDS), max_size=3)):
        line += [option] if value is None else [option, value]
    return line + ["--no-pictures"] * (command in DRAW)


@pytest.mark.slow
@pytest.mark.hour
@examples(80)
@given(line=command_lines())
def test_any_command_line(line, write_scene, command):
    tables = {"damping": 88.5, "window": (0.001, 0.004), "search": {"particles": 3, "iterations": 2}}
    write_scene(nodes=(9, 9), **tables)
    Path("text.h5").write_text("no HDF5", encoding="utf-8")
    status, out, err = command(*line)
    assert status in (0, 2)
    assert "Traceback" not in err
    assert err.replace("\n", "").replace("\r", "").isprintable()
    if status:
        assert err.splitlines()[-1].startswith("warp-plate: ")
    elif "--help" not in line:
        assert not re.search(r"\bnan\b", out.replace("1@90,nan,0", ""), re.IGNORECASE)
