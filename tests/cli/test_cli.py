"""The command line whole: what localize, simulate and init print and write, errors, and the process."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

import warp_plate
from support.commands import error_of, output_of, start_program
from warp_plate import Scene, load_result
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
    command("simulate", "two.toml", "--out", "two.h5", *QUICK)
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
    assert "paper.toml" in output_of(command("init", "paper"))
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
    assert all(name in output_of(command("--help")) for name in ("localize", "simulate", "init"))


def test_standard_output_that_is_closed_or_full(recorded):
    """``warp-plate ... | head`` closes the pipe, and the command ends quietly."""
    read, write = os.pipe()
    os.close(read)
    assert process("simulate", "panel.toml", "--json", *QUICK, stdout=write)[2] == ""
    os.close(write)
    assert Path("panel-simulate.h5").exists()
    if Path("/dev/full").exists():  # on Linux
        with open("/dev/full", "w") as full:
            answer = process("init", "paper", stdout=full)
        assert answer == (2, None, "warp-plate: No space left on device\n")
