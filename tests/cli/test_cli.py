"""The command line whole: what localize, simulate and init print and write, errors, and the process."""

import io
import json
import math
import os
import re
import sys
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

import warp_plate
from support.commands import error_of, output_of, start_program
from warp_plate import Scene, load_result
from warp_plate.cli import output
from warp_plate.cli.main import COMMANDS, application
from warp_plate.scene.load import preset_names, preset_text

QUICK = ("--device", "cpu", "--no-pictures", "--no-estimate")


@pytest.fixture
def recorded(write_scene):
    """A small scene in a file of an otherwise empty working folder."""
    search = {"method": "pso", "particles": 6, "iterations": 5}
    return write_scene(damping=88.5, precision="float32", search=search, record={"points": ((0.1, 0.1),)})


def files():
    """All files of the working folder, hidden ones too."""
    return sorted(str(path) for path in Path().rglob("*") if path.is_file())


def test_localize_and_simulate_with_every_kind_of_drive(command, recorded):
    words = ("localize", "panel.toml", "--seed", 4, "--json", "--device", "cpu", "--no-pictures")
    record = json.loads(output_of(command(*words)))
    assert (record["scene"], record["seed"]) == ("panel.toml", 4)
    assert record["device"].startswith("cpu")
    factors = record["localization_factor"]
    assert list(factors) == ["equal", "single", "best", "bound"]
    assert max(factors.values()) == factors["bound"]
    assert [entry["actuator"] for entry in record["drive"]] == ["0", "1", "2"]
    assert record["drive"][0] == {"actuator": "0", "magnitude": 1, "phase": 0}
    assert record["evaluations"] == 30
    assert set(record["seconds"]) == {"compile", "solve", "estimate"}
    assert record["effects"] == ["viscous damping (centred)"]
    assert [entry["evaluations"] for entry in record["history"]] == [6, 12, 18, 24, 30]
    assert set(record["history"][0]) == {"evaluations", "best", "mean"}
    assert record["history"][-1]["best"] == pytest.approx(factors["best"], abs=2e-6)
    assert record["files"] == ["panel-localize.h5", "panel-localize.best.toml"]
    assert files() == ["panel-localize.best.toml", "panel-localize.h5", "panel.toml"]
    result = load_result("panel-localize.h5")
    assert result.scene == recorded
    assert {name: case.localization_factor for name, case in result.cases.items()} | {"bound": result.bound} == factors
    phasors = [entry["magnitude"] * np.exp(-1j * entry["phase"]) for entry in record["drive"]]
    np.testing.assert_allclose(result.cases["best"].phasors, phasors, rtol=1e-12)
    again, other = (json.loads(command("localize", "panel.toml", "--seed", s, "--json", *QUICK)[1]) for s in (4, 5))
    assert again["history"] == record["history"]
    assert other["history"] != record["history"]
    # A result file stands for its best drive, or the only one; a second run replaces the first one's result.
    factors = other["localization_factor"]
    for drive, name in (("equal", "equal"), ("single", "single"), ("panel-localize.h5", "best"), ("again.h5", "best")):
        _, out, _ = command("simulate", "panel.toml", "--drive", drive, "--out", "again.h5", "--json", *QUICK)
        record = json.loads(out)
        assert record["localization_factor"] == pytest.approx(factors[name], rel=1e-9)
        assert record["localization_factor"] == pytest.approx(record["energy"]["target"] / record["energy"]["plate"])
        assert record["peak_displacement"] > 0
    assert files() == ["again.h5", "panel-localize.best.toml", "panel-localize.h5", "panel.toml"]


def test_the_table_of_the_paper(command, tmp_path, monkeypatch):
    """Our localization factors beside the published ones, and what cannot be reproduced."""
    monkeypatch.chdir(tmp_path)
    out = output_of(command("localize", "paper", *QUICK))
    rows = {line.split("  ")[0].strip(): line.split()[-2:] for line in out.splitlines() if line.strip()}
    assert rows["all actuators alike"] == ["0.2500", "0.2500"]
    single, published = map(float, rows["best single actuator, lower left"])
    assert single == pytest.approx(0.6367, abs=0.0005)
    assert published == 0.6367
    assert rows["found by the search"][1] == "0.7200"
    assert re.search(r"can't be\s+reproduced", out)
    for text in ("lower left", "magnitude (N/m²)", "viscous damping (backward)", "paper-localize.h5"):
        assert text in " ".join(out.split())


def test_a_search_that_misses_the_bound_names_the_method_that_reaches_it(command, recorded, write_scene):
    remark = 'The bound can be reached: method = "exact" in [search] finds that drive.'
    assert remark in output_of(command("localize", "panel.toml", *QUICK))
    # In so early a window a phase that all actuators have in common counts.
    write_scene(recorded.with_tables(search={"method": "exact"}))
    out = output_of(command("localize", "panel.toml", *QUICK, "--json"))
    factors = json.loads(out)["localization_factor"]
    assert factors["best"] == pytest.approx(factors["bound"], abs=1e-6)
    assert remark not in output_of(command("localize", "panel.toml", *QUICK))


def test_errors_are_one_line_and_status_2(command, recorded, write_scene):
    Path("wrong.toml").write_text(recorded.to_toml().replace("density", "densty"), encoding="utf-8")
    write_scene(recorded.with_tables(grid={"nodes": (13, 13), "time_step": 1.0}), "fast")
    write_scene(name="two", actuators=[actuator.area for actuator in recorded.actuators[:2]])
    command("simulate", "two.toml", "--out", "two.h5", "--path", "modal", *QUICK)
    write_scene(recorded.with_tables(drive={"frequency": 290.0, "electrostatic": {"bias": 1.0, "gain": 1.0}}), "volts")
    command("simulate", "volts.toml", "--out", "volts.h5", *QUICK)
    before = files()
    for words, named in (
        ("localize", "SCENE"),
        ("frobnicate", "frobnicate"),
        ("localize papers --json", "papers: no such preset or file"),
        ("localize panel.toml --speed 9", "--speed"),
        ("localize wrong.toml", "wrong.toml: plate.densty: unknown key; did you mean 'density'?"),
        *((f"{name} fast.toml", "fast.toml: grid.time_step = 1") for name in ("localize", "simulate", "effects")),
        ("simulate panel.toml --drive none.h5", "none.h5: no such file"),
        ("simulate panel.toml --drive two.h5", "--drive two.h5: holds 2 actuators"),
        ("simulate panel.toml --drive volts.h5", "holds magnitudes in V, those of the scene are in N/m²"),
        ("init papers", "cantilever-display, composite-panel, "),
        ("init paper --out no/paper.toml", "no/paper.toml: cannot be written"),
    ):
        assert named in error_of(command(*words.split()))
        assert files() == before


def test_init_writes_a_preset_and_never_overwrites(command, recorded):
    assert "run it with: warp-plate localize paper.toml" in output_of(command("init", "paper"))
    assert "run it with: warp-plate specify console.toml" in output_of(command("init", "console"))
    assert "run it with: warp-plate focus four-fingers.toml" in output_of(command("init", "four-fingers"))
    assert Path("paper.toml").read_text(encoding="utf-8") == preset_text("paper")
    assert command("init", "paper-supported", "--out", "other.toml")[0] == 0
    assert Scene.load("other.toml") == Scene.load("paper-supported")
    assert all(name in command("init", "--help")[1] for name in preset_names())
    before = Path("panel.toml").read_bytes()
    assert "panel.toml: exists already" in error_of(command("init", "paper", "--out", "panel.toml"))
    assert Path("panel.toml").read_bytes() == before


def process(*arguments, **options):
    """Run ``python -m warp_plate``; return status, standard output (None unless it is a pipe), standard error."""
    environment = {**os.environ, "COLUMNS": "120", "PYTHONIOENCODING": options.pop("encoding", "utf-8")}
    started = start_program("-m", "warp_plate", *arguments, env=environment, encoding="utf-8", **options)
    out, err = started.communicate()
    return started.returncode, out, err


def test_as_a_process(command, recorded):
    """Streams are free of messages of Warp, CUDA and VTK, also in a terminal without other letters."""
    out = output_of(process("check", "panel.toml", "--device", "cpu", encoding="ascii"))
    assert out.startswith("panel.toml")
    assert "200 \\xd7 200" in out
    assert output_of(command("--version")).strip() == warp_plate.__version__
    assert all(name in output_of(command("--help")) for name in ("localize", "simulate", "init", "130"))
    output_of(command("--install-completion", "--shell", "bash", "--output", "completion.bash"))
    assert {"localize", "--checkpoint-every"} <= set(Path("completion.bash").read_text("utf-8").split())


def test_standard_output_that_is_closed_or_full(recorded):
    """``warp-plate ... | head`` closes the pipe, and the command ends quietly."""
    read, write = os.pipe()
    os.close(read)
    assert process("simulate", "panel.toml", "--json", *QUICK, stdout=write)[2] == ""
    assert process("--help", stdout=write) == (0, None, "")
    os.close(write)
    assert Path("panel-simulate.h5").exists()
    if Path("/dev/full").exists():  # on Linux
        with open("/dev/full", "w") as full:
            answer = process("init", "paper", stdout=full)
        assert answer == (2, None, "warp-plate: No space left on device\n")


# Drives and seconds --------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["auto", "modal"])
def test_numbers_follow_from_energies(command, tmp_path, path):
    file = tmp_path / "a.h5"
    words = ("simulate", "paper", "--drive", "single", "--path", path, *QUICK, "--out", file)
    found = json.loads(output_of(command(*words, "--json")))
    scene, motion = Scene.load("paper"), found["motion"]
    mass = scene.plate.density * scene.plate.thickness * math.prod(scene.plate.size)
    target, plate = found["energy"]["target"], found["energy"]["plate"]
    for region, energy, share in (("target", target, 1 / 4), ("outside", plate - target, 3 / 4)):
        velocity = motion["velocity_rms"][region]
        assert velocity == pytest.approx(math.sqrt(2 * energy / (share * mass)), rel=1e-6)
        assert motion["acceleration_rms"][region] == pytest.approx(2 * math.pi * 290 * velocity)
    assert motion["contrast_db"] == pytest.approx(10 * math.log10(3 * target / (plate - target)))
    peaks = motion["displacement_peak"]
    assert max(peaks.values()) == load_result(file).peak_displacement
    assert peaks["outside"] < peaks["target"]
    assert "only actuator driven lower left" in " ".join(command(*words)[1].split())
    assert load_result(file).main_case.motion is None


def test_a_plate_that_is_not_linear_has_no_acceleration(command, tmp_path):
    words = ("simulate", "large-amplitude", *QUICK, "--out", tmp_path / "a.h5")
    motion = json.loads(output_of(command(*words, "--json")))["motion"]
    assert set(motion) == {"contrast_db", "velocity_rms", "displacement_peak"}
    assert "acceleration" not in command(*words)[1]


def test_cases_of_a_search_are_compared(command, tmp_path):
    words = ("localize", "paper", *QUICK, "--baselines", "--set", "search.iterations=3", "--out", tmp_path / "a.h5")
    found = json.loads(output_of(command(*words, "--json")))
    assert found["scene"] == "paper --set search.iterations=3"
    assert set(found["motion"]) == set(found["localization_factor"]) - {"bound"}
    equal, single, best = (found["motion"][name] for name in ("equal", "single", "best"))
    assert equal["contrast_db"] == pytest.approx(0, abs=1e-6)
    assert equal["displacement_peak"]["target"] == pytest.approx(equal["displacement_peak"]["outside"], rel=1e-3)
    assert best["contrast_db"] > 0
    assert single["contrast_db"] == pytest.approx(7.208, abs=0.01)
    assert found["single_actuator"] in {actuator.name for actuator in Scene.load("paper").actuators}
    text = " ".join(command(*words)[1].split())
    assert f"best single actuator, {found['single_actuator']}" in text
    assert "Motion in the target / outside" in text


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


@pytest.mark.parametrize("name", ["localize", "simulate"])
def test_seconds_add_up(command, tmp_path, name):
    words = (name, "paper", "--device", "cpu", "--no-pictures", "--out", tmp_path / "a.h5")
    searched = ("--set", "search.iterations=3") if name == "localize" else ()
    text = " ".join(output_of(command(*words, *searched)).split())
    total, stages = re.search(r"([\d.]+) s in all: (.*? loading, files and pictures)", text).groups()
    seconds = [float(value) for value in re.findall(r"([\d.]+) s ", stages)]
    assert len(seconds) == 4
    assert min(seconds) >= 0
    assert sum(seconds) == pytest.approx(float(total), abs=0.005 * (len(seconds) + 1))


@pytest.mark.parametrize(("accuracy", "first"), [(None, "compiling or loading kernels"), (0.01, "choosing a grid")])
def test_progress_says_what_is_done(monkeypatch, accuracy, first):
    scene, stream = Scene.load("paper"), Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    seen = []
    scene = scene if accuracy is None else scene.with_accuracy(accuracy)
    for updates in ((), ((1, 2),), ((2, 2),)):
        with output.progress_bar("searching", True, scene, "running the drives found") as show:
            for update in updates:
                show(*update)
        seen.append(stream.getvalue())
        stream.truncate(0)
    assert first in seen[0]
    assert "searching" not in seen[0]
    assert "searching" in seen[1]
    assert "running the drives found" in seen[2]


def test_check_says_what_it_does(monkeypatch, command):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    command("check", "paper", "--device", "cpu")
    assert "choosing the engine and checking" in stream.getvalue()


# --set ---------------------------------------------------------------------------------------------


def test_every_command_of_a_scene_sets_its_keys():
    apps = {name: application()[name] for name in COMMANDS}
    options = {name: [option.name for option in app.assemble_argument_collection()] for name, app in apps.items()}
    scenes = [name for name, app in apps.items() if "scene" in signature(app.default_command).parameters]
    assert len(scenes) > 8
    assert [name for name in scenes if "--set" not in options[name]] == []
