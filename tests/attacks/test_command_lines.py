"""Command lines of any options, values and names: a result without NaN, or one line and status 2, in the memory of a
small machine. What hangs meets the time limit of all tests."""

import json
import re
import shutil
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.attacks import examples
from support.commands import is_printable
from warp_plate.cli.main import COMMANDS, application
from warp_plate.plate import memory

# Commands that wait for a person or measure this machine, and options that start other programs.
LEFT_OUT, PROGRAMS = ("view", "explore"), ("--devices", "--cluster")
# Memory of a small machine [bytes].
ROOM = 6 * 2**30
# Commands that take a result file; options without a word.
RESULTS = ("render", "export", "verify")
FLAGS = ("--json", "--force", "--estimate", "--spectrum", "--pictures", "--allow-unstable", "--modes")
FILES = ("run.h5", "focus.h5", "sweep.h5", "frf.h5", "modes.csv", "responses.csv", "velocities.csv")
WRONG = ("none", "", "-", ".", "text.h5", "\x1b[2J.toml", "caf\udce9.toml", "a\nb", "folder", "/dev/zero")
RIGHT = ("panel.toml", "fit.toml", "sensor.toml", "focus.toml", "piezo.toml")
PLAIN = """
    0 1 2 -1 1.5 nan inf -inf 1e400 1% 0% 1e-300 ² ٣ 1,2 cpu cuda:9 equal single 1,0,0 1@90,nan,0 1:2:3 50:300 modal
    resident no/such.h5 drive.frequency=nan grid.nodes=[1,1] best optimum a.b.c= = [[ mean
"""
# Words that options take, beside those that they must not.
LIKELY = {
    "--set": """
        search.seed=-1 plate.size=[1e-300,1] effects.damping.viscous=1e300 plate.thickness=1e-320 drive.frequency=280
        focus.highest=1e9 focus.rate=1 focus.time=1e-9 fit.free={} fit.starts=2 fit.range=[1,2] fit.pairing=nearest
        measurement[0].gain=1e-300 measurement[0].point=[0,0] actuators[0].magnitude=0 edges.left=free focus.energy=1e-9
        effects.loss_factor.eta=0.01 focus.points=[[0,0.1]] search.method=cma-es target.area=[0,0.2,0,0.2] fit={}
        focus.rest={contrast=10,radius=0.02} drive.waveform=burst search.frequency={range=[100,200]} measurement=[]
        effects.tension.x=-1e9 plate.density=1e-3 plate.young_modulus=1e300 record.points=[[0.1,0.1]]
    """,
    "--vary": "drive.frequency=280,290 plate.density=900:1000:3 edges.left=free,clamped plate.density=1:2:3:4",
    "--case": "best equal single optimum time_reversal",
    "--data": "modes.csv responses.csv velocities.csv run.h5 focus.h5",
    "--range": "50:300 1:1e9 300:50 1e-9:1",
    "--frequencies": "50:300:4 1:1e9:3 50:300:1000000000",
    "--at": "0.05,0.05 0,0 9,9",
    "--from": "0 0.05,0.05 0,0",
    "--drive": "equal 1,0,0 1@90,1,0 0,0,0 1e300,1,1 run.h5:best",
    "--waveforms": "focus.h5 run.h5",
    "--resume": "run.h5 none",
    "--out": "out.toml out.h5 out.png out.svg out.csv out.wav panel.toml run.h5 no/such.h5",
}
VALUES = [*PLAIN.split(), *WRONG, *RIGHT, *FILES, "9" * 5000]
WORDS = st.one_of(st.sampled_from(VALUES), st.sampled_from(VALUES), st.text(max_size=6))


@cache
def options_of(command):
    """The options of a command, each with the words that it takes, None where these are any."""
    return [
        (name, argument.get_choices())
        for argument in application()[command].assemble_argument_collection()
        for name in argument.names
        if name.startswith("--") and name not in PROGRAMS
    ]


@st.composite
def words(draw, option, choices):
    """A word after an option, likely one that it takes."""
    likely = choices or LIKELY.get(option, "1 2 3 0.01").split()
    return draw(st.sampled_from(likely) if draw(st.integers(0, 3)) else WORDS)


@st.composite
def command_lines(draw):
    command = draw(st.sampled_from([name for name in COMMANDS if name not in LEFT_OUT]))
    right, known = FILES[:4] if command in RESULTS else RIGHT, dict(options_of(command))
    names = st.sampled_from(right) if draw(st.integers(0, 3)) else st.sampled_from([*WRONG, *RIGHT, *FILES])
    line = [command, *draw(st.lists(names, min_size=1, max_size=draw(st.sampled_from([1, 1, 1, 2]))))]
    chosen = draw(st.lists(st.sampled_from(list(known)), max_size=2))
    needed = {"fit": "--data", "verify": "--data", "export": "--to", "sweep": "--vary", "accuracy": "--budget"}
    for option in [*filter(None, [needed.get(command)]), *chosen]:
        flag = option in FLAGS or option.startswith("--no-")
        line += [option] if flag else [option, draw(words(option, known[option]))]
    return line + ["--no-pictures"] * ("--no-pictures" in known)


@pytest.fixture
def enter(filled, tmp_path, monkeypatch):
    """A function that makes the working folder as it was."""
    for name in COMMANDS:
        options_of(name)  # imports commands, which may draw random numbers, before examples are drawn

    def make():
        shutil.rmtree(tmp_path / "at", ignore_errors=True)
        shutil.copytree(filled, tmp_path / "at")
        monkeypatch.chdir(tmp_path / "at")

    return make


def is_bad(value):
    """Return whether JSON holds NaN, which is not JSON."""
    raise AssertionError(value)


@pytest.fixture
def peak_memory(monkeypatch):
    """A function that returns the most memory that this process has taken [bytes], in a machine that has little."""
    resource = pytest.importorskip("resource", reason="Windows counts the memory of a process otherwise")
    monkeypatch.setattr(memory, "machine_memory", lambda: float(ROOM))
    unit = 1 if sys.platform == "darwin" else 1024
    return lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


@pytest.mark.slow
@pytest.mark.hour
@examples(80)
@given(line=command_lines())
def test_any_command_line(line, enter, command, peak_memory):
    enter()
    before = peak_memory()
    status, out, err = command(*line)
    assert peak_memory() - before < ROOM
    assert status in (0, 2)
    assert "Traceback" not in err
    assert is_printable(err.replace("\n", "").replace("\r", ""))
    if status:
        assert err.splitlines()[-1].startswith("warp-plate: ")
        assert not [path.name for path in Path().iterdir() if ".part" in path.name]
    elif "--help" not in line:
        assert not re.search(r"\bnan\b", out.replace("1@90,nan,0", ""), re.IGNORECASE)
        if "--json" in line:
            json.loads(out, parse_constant=is_bad)
