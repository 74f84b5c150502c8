"""Closed streams, readers that leave early, terminals of no width, and names of files that are not UTF-8."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from support.commands import error_of, output_of
from support.scenes import scene_of
from warp_plate import Scene, load_result

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="shells of Unix")
QUICK = ("--device", "cpu", "--no-pictures", "--no-estimate")


def in_shell(line, **environment):
    """Run a line of the shell, in which COMMAND stands for warp-plate; return status, output and error."""
    words = line.replace("COMMAND", f"{shlex.quote(sys.executable)} -m warp_plate")
    run = subprocess.run(["sh", "-c", words], capture_output=True, text=True, env={**os.environ, **environment})
    return run.returncode, run.stdout, run.stderr


def test_a_search_whose_streams_are_closed_keeps_its_result(write_scene):
    write_scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    assert in_shell(f"COMMAND localize panel.toml {' '.join(QUICK)} <&- >&- 2>&-") == (0, "", "")
    assert load_result("panel-localize.h5").source == "panel.toml"


def test_a_closed_standard_error_changes_no_status():
    assert in_shell("COMMAND init none 2>&-")[:2] == (2, "")


def test_a_reader_that_leaves_early_is_no_error():
    status, _, err = in_shell("(COMMAND keys all; echo status $? >&2) | true")
    assert (status, err) == (0, "status 0\n")


def test_a_terminal_of_no_width_is_one_of_80_columns(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    expected = output_of(command("check", "paper"))
    monkeypatch.setenv("COLUMNS", "0")
    assert output_of(command("check", "paper")) == expected != ""


def test_names_that_are_not_utf8(write_scene, command):
    write_scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    name = os.fsdecode(b"caf\xe9")
    try:
        os.rename("panel.toml", f"{name}.toml")
    except OSError:
        pytest.skip("this file system takes only UTF-8")
    for study, options in (("localize", ""), ("sweep", "--what check --vary drive.frequency=280,290")):
        output_of(command(study, f"{name}.toml", "--device", "cpu", *options.split()))
        assert list(Path().glob(f"{name}-{study}.*"))
    assert load_result(f"{name}-localize.h5").source == r"caf\udce9.toml"
    error_of(command("simulate", f"{name}x.toml"))


def test_names_of_any_letters_are_drawn_exported_and_printed(write_scene, command):
    """They are neither formulas, markup, emoji nor commands of a terminal, and XML cannot hold them as they are."""
    name = "ü $\\frac{1}{$ [b] :smile: \x1b[2J"
    targets = [{"name": key, "area": (0.0, 0.1, 0.0, end)} for key, end in (("a", 0.1), (name, 0.2))]
    actuators = [{"name": key, "area": (x, x + 0.05, 0.1, 0.15)} for key, x in (("b", 0.02), (name, 0.1))]
    tables = {"record": {"times": (0.01,)}, "search": {"particles": 3, "iterations": 2}}
    made = scene_of(title=name, damping=88.5, **tables).model_dump(exclude={"target", "targets", "actuators"})
    write_scene(Scene.model_validate({**made, "targets": targets, "actuators": actuators}))
    lines = ["localize panel.toml --device cpu --no-estimate", "render panel-localize.h5 --out a.svg --device cpu"]
    case = ("--case", f"best {name}")
    for line in (*lines, *(f"export panel-localize.h5 --to {kind}" for kind in ("vtkhdf", "drive-wav"))):
        out = output_of(command(*line.split(), *case * (not line.startswith("localize"))))
        assert out.replace("\n", "").isprintable()
        assert not line.startswith("localize") or out.startswith("ü $\\frac{1}{$ [b] :smile: \\x1b[2J\n")
