"""The commands as a user or a program calls them: exit status, standard output, standard error, files."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import warp_plate
from warp_plate import Scene, load_result
from warp_plate.cli.main import main
from warp_plate.scene import preset_names, preset_text
from warp_plate.scene.dump import dump_scene

ROOT = Path(__file__).parents[2]
QUIET = ["--device", "cpu", "--no-pictures"]
# For what has nothing to do with the estimate of the error.
QUICK = (*QUIET, "--no-estimate")
SMALL = {"search": {"particles": 6, "iterations": 5}, "record": {"points": ((0.1, 0.1),)}}

LOCALIZE_KEYS = ["scene", "device", "path", "seed", "localization_factor", "drive", "evaluations", "node_steps"]
LOCALIZE_KEYS += ["seconds", "effects", "history"]
SIMULATE_KEYS = ["localization_factor", "energy", "peak_displacement", "node_steps", "seconds", "effects"]


@pytest.fixture
def panel(tmp_path, monkeypatch, scene):
    """A small scene in a file of the working folder, which starts out with nothing else."""
    monkeypatch.chdir(tmp_path)
    made = scene(damping=88.5, precision="float32", **SMALL)
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    return made


def files():
    """All files of the working folder, hidden ones too."""
    return sorted(str(path) for path in Path().rglob("*") if path.is_file())


def test_localize_json(command, panel):
    status, out, err = command("localize", "panel.toml", "--seed", 4, "--json", *QUIET)
    assert (status, err) == (0, "")
    answer = json.loads(out)
    assert set(LOCALIZE_KEYS) <= set(answer)
    assert answer["scene"] == "panel.toml"
    assert answer["device"].startswith("cpu")
    assert answer["seed"] == 4
    factors = answer["localization_factor"]
    assert list(factors) == ["equal", "single", "best", "bound"]
    assert max(factors.values()) == factors["bound"]
    assert [set(entry) for entry in answer["drive"]] == [{"actuator", "magnitude", "phase"}] * 3
    assert [entry["actuator"] for entry in answer["drive"]] == ["0", "1", "2"]
    assert answer["drive"][0] == {"actuator": "0", "magnitude": 1, "phase": 0}
    assert answer["evaluations"] == 30
    assert set(answer["seconds"]) == {"compile", "solve", "estimate"}
    assert answer["effects"] == ["viscous damping (centred)"]
    assert [set(entry) for entry in answer["history"]] == [{"evaluations", "best", "mean"}] * 5
    assert [entry["evaluations"] for entry in answer["history"]] == [6, 12, 18, 24, 30]
    assert answer["history"][-1]["best"] == pytest.approx(factors["best"], abs=2e-6)
    assert answer["node_steps"] % (11 * 11) == 0
    assert files() == ["panel-localize.best.toml", "panel-localize.h5", "panel.toml"]


def test_localize_result_file_holds_what_was_printed(command, panel):
    _, out, _ = command("localize", "panel.toml", "--out", "found.h5", "--json", *QUIET)
    answer, result = json.loads(out), load_result("found.h5")
    assert answer["files"] == ["found.h5", "found.best.toml"]
    assert result.scene == panel
    assert {name: case.localization_factor for name, case in result.cases.items()} | {
        "bound": result.bound
    } == (answer["localization_factor"])
    drive = [entry["magnitude"] * np.exp(-1j * entry["phase"]) for entry in answer["drive"]]
    np.testing.assert_allclose(result.cases["best"].phasors, drive, rtol=1e-12)


def test_simulate_json(command, panel):
    status, out, err = command("simulate", "panel.toml", "--json", *QUIET)
    assert (status, err) == (0, "")
    answer = json.loads(out)
    assert [key for key in answer if key in SIMULATE_KEYS] == SIMULATE_KEYS
    assert set(answer["energy"]) == {"plate", "target"}
    assert answer["localization_factor"] == pytest.approx(
        answer["energy"]["target"] / answer["energy"]["plate"]
    )
    assert answer["peak_displacement"] > 0
    assert set(answer["seconds"]) == {"compile", "solve", "estimate"}
    assert files() == ["panel-simulate.h5", "panel.toml"]


def test_simulate_a_drive_that_was_found(command, panel):
    """--drive FILE.h5 takes the best drive of a search, or the only one of a simulation."""
    _, found, _ = command("localize", "panel.toml", "--json", *QUICK)
    best = json.loads(found)["localization_factor"]["best"]
    for drive in ("panel-localize.h5", "again.h5"):
        _, out, _ = command("simulate", "panel.toml", "--drive", drive, "--out", "again.h5", "--json", *QUICK)
        assert json.loads(out)["localization_factor"] == pytest.approx(best, rel=1e-9)


def test_a_drive_of_another_unit_is_refused(command, panel):
    """Volts of an electrostatic scene are not pressures; the files say which they hold."""
    volts = panel.with_tables(drive={"frequency": 290.0, "electrostatic": {"bias": 1.0, "gain": 1.0}})
    Path("volts.toml").write_text(dump_scene(volts), encoding="utf-8")
    for name, unit in (("volts", "V"), ("panel", "N/m^2")):
        command("simulate", f"{name}.toml", *QUICK, "--json")
        with h5py.File(f"{name}-simulate.h5") as file:
            assert file["cases/drive/magnitude"].attrs["units"] == unit
    status, _, err = command("simulate", "panel.toml", "--drive", "volts-simulate.h5", *QUICK)
    assert status == 2
    assert "--drive volts-simulate.h5: holds magnitudes in V, those of the scene are in N/m²" in err
    assert len(err.splitlines()) == 1


def test_help_lists_the_presets(command):
    status, out, _ = command("init", "--help")
    assert status == 0
    assert all(name in out for name in preset_names())


@pytest.mark.parametrize("drive", ["equal", "single"])
def test_simulate_reference_drives(drive, command, panel):
    _, found, _ = command("localize", "panel.toml", "--json", *QUICK)
    _, out, _ = command("simulate", "panel.toml", "--drive", drive, "--json", *QUICK)
    assert json.loads(out)["localization_factor"] == json.loads(found)["localization_factor"][drive]


def test_same_seed_same_answer(command, panel):
    def answer(seed):
        found = json.loads(command("localize", "panel.toml", "--seed", seed, "--json", *QUICK)[1])
        return {key: found[key] for key in ("localization_factor", "drive", "history")}

    assert answer(1) == answer(1)
    assert answer(1) != answer(2)


def test_paper_table(command, tmp_path, monkeypatch):
    """For people: our figures, the published ones beside them, and what cannot be reproduced."""
    monkeypatch.chdir(tmp_path)
    status, out, _ = command("localize", "paper", *QUIET)
    assert status == 0
    rows = {line.split("  ")[0].strip(): line.split()[-2:] for line in out.splitlines() if line.strip()}
    assert rows["all actuators alike"] == ["0.2500", "0.2500"]
    single, published = map(float, rows["best single actuator"])
    assert single == pytest.approx(0.6367, abs=0.0005)
    assert published == 0.6367
    assert rows["found by the search"][1] == "0.7200"
    assert re.search(r"can't be\s+reproduced", out)
    for text in (
        "lower left",
        "upper right",
        "magnitude (N/m²)",
        "viscous damping (backward)",
        "paper-localize.h5",
    ):
        assert text in " ".join(out.split())


def test_another_scene_has_no_published_figures(command, panel):
    status, out, _ = command("localize", "panel.toml", *QUICK)
    assert status == 0
    assert "published" not in out
    status, out, _ = command("simulate", "panel.toml", *QUICK)
    assert status == 0
    assert "localization factor" in out


def test_result_files_are_plain_hdf5(command, panel):
    """Readable without this program: numbers with units and long names."""
    command("localize", "panel.toml", *QUICK, "--json")
    with h5py.File("panel-localize.h5") as file:
        shape = file["cases/best/displacement"].shape
        assert shape == (2, 13, 13)
        assert file["cases/best/displacement"].attrs["units"] == "m"
        assert "long_name" in file["history/best"].attrs


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["localize"], "SCENE"),
        (["frobnicate"], "frobnicate"),
        (["localize", "papers"], "papers: no such preset or file"),
        (["localize", "panel.toml", "--device", "gpu"], "device = 'gpu'"),
        (["localize", "panel.toml", "--path", "fast"], "path"),
        (["localize", "panel.toml", "--evaluator", "guess"], "evaluator"),
        (["localize", "panel.toml", "--seed", "x"], "seed"),
        (["localize", "panel.toml", "--seed", "-1"], "seed"),
        (["localize", "panel.toml", "--speed", "9"], "--speed"),
        (["localize", "panel.toml", "--out", "found.txt"], "--out found.txt: must end in .h5"),
        (["localize", "panel.toml", "--out", "no/found.h5"], "--out no/found.h5: no such folder"),
        (["localize", "panel.toml", "--out", "folder.h5"], "folder.h5"),
        (["localize", "wrong.toml"], "wrong.toml: plate.densty: unknown key; did you mean 'density'?"),
        (["localize", "fast.toml"], "grid.time_step = 1"),
        (["simulate", "panel.toml", "--drive", "best"], "--drive best"),
        (["simulate", "panel.toml", "--drive", "none.h5"], "none.h5: no such file"),
        (["simulate", "panel.toml", "--drive", "text.h5"], "text.h5"),
        (["simulate", "panel.toml", "--drive", "two.h5"], "--drive two.h5: holds 2 actuators"),
        (["simulate", "panel.toml", "--out", "folder.h5"], "folder.h5"),
        (["init", "papers"], "'papers' is no preset; there are: cantilever-display, composite-panel, "),
        (["init", "paper", "--out", "no/paper.toml"], "no/paper.toml: cannot be written"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else "",
)
def test_errors_are_one_line_and_status_2(arguments, named, command, panel, scene):
    text = dump_scene(panel)
    Path("wrong.toml").write_text(text.replace("density", "densty"), encoding="utf-8")
    fast = panel.model_copy(update={"grid": panel.grid.model_copy(update={"time_step": 1.0})})
    Path("fast.toml").write_text(dump_scene(fast), encoding="utf-8")
    Path("text.h5").write_text("no HDF5 at all", encoding="utf-8")
    Path("folder.h5").mkdir()
    if "two.h5" in arguments:
        Path("two.toml").write_text(
            dump_scene(scene(actuators=[a.area for a in panel.actuators[:2]])), encoding="utf-8"
        )
        command("simulate", "two.toml", "--out", "two.h5", *QUIET)
    before = files()
    status, out, err = command(
        *arguments, *([] if arguments[0] in ("init", "frobnicate") else ["--no-pictures"])
    )
    assert status == 2
    assert out == ""
    assert err.startswith("warp-plate: ")
    assert err.endswith("\n")
    assert len(err.splitlines()) == 1
    assert named in err
    assert files() == before


def test_errors_with_json_print_no_json(command, panel):
    status, out, err = command("localize", "papers", "--json")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1


def test_init_writes_a_preset_and_never_overwrites(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = command("init", "paper")
    assert (status, err) == (0, "")
    assert "paper.toml" in out
    assert Path("paper.toml").read_text(encoding="utf-8") == preset_text("paper")
    assert Scene.load("paper.toml") == Scene.load("paper")
    Path("paper.toml").write_text("mine", encoding="utf-8")
    status, out, err = command("init", "paper")
    assert (status, out) == (2, "")
    assert "paper.toml: exists already" in err
    assert Path("paper.toml").read_text(encoding="utf-8") == "mine"
    assert command("init", "paper-supported", "--out", "other.toml")[0] == 0
    assert Scene.load("other.toml") == Scene.load("paper-supported")


def test_a_result_is_replaced_whole(command, panel):
    """A second run writes over the first one's result, through a temporary file that is gone at the end."""
    command("simulate", "panel.toml", "--drive", "equal", *QUICK, "--json")
    first = Path("panel-simulate.h5").read_bytes()
    command("simulate", "panel.toml", "--drive", "single", *QUICK, "--json")
    assert Path("panel-simulate.h5").read_bytes() != first
    assert files() == ["panel-simulate.h5", "panel.toml"]


def test_pictures_or_a_word_on_what_is_missing(command, panel):
    """With the extra and a graphics library there are pictures; without, the run ends well and says what to
    install."""
    status, out, _ = command("simulate", "panel.toml", "--device", "cpu")
    assert status == 0
    pictures = [name for name in files() if name.endswith(".png")]
    assert pictures or "install" in out
    assert all(name in " ".join(out.split()) for name in pictures)


def process(*arguments, **options):
    """``python -m warp_plate`` with these arguments, in the working folder."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"}
    return subprocess.run(
        [sys.executable, "-m", "warp_plate", *arguments],
        capture_output=True,
        text=True,
        env=environment,
        **options,
    )


def test_as_a_process(panel):
    """The same through the interpreter: streams are clean of what Warp, CUDA and VTK say for themselves."""
    answer = process("localize", "panel.toml", "--json", *QUIET)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert set(LOCALIZE_KEYS) <= set(json.loads(answer.stdout))
    answer = process("localize", "papers")
    assert (answer.returncode, answer.stdout) == (2, "")
    assert len(answer.stderr.splitlines()) == 1
    assert process("--version").stdout.strip() == warp_plate.__version__
    answer = process("--help")
    assert answer.returncode == 0
    assert all(name in answer.stdout for name in ("localize", "simulate", "init"))


def test_a_reader_that_leaves_is_no_error(panel):
    """``warp-plate ... | head``: the pipe is closed, the command ends quietly."""
    read, write = os.pipe()
    os.close(read)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    arguments = [sys.executable, "-m", "warp_plate", "simulate", "panel.toml", "--json", *QUICK]
    answer = subprocess.run(
        arguments, stdout=write, stderr=subprocess.PIPE, text=True, env=environment, check=False
    )
    os.close(write)
    assert answer.stderr == ""
    assert Path("panel-simulate.h5").exists()


def test_what_a_scene_calls_itself_is_printed_as_it_stands(scene, tmp_path, monkeypatch, capsys):
    """No markup, no emoji, no command to the terminal, in tables, lines and errors."""
    monkeypatch.chdir(tmp_path)
    made = scene((9, 9), damping=88.5, search={"particles": 4, "iterations": 3})
    names = (f"[/b]{index} \x1b[31m :smile:" for index in range(3))
    named = tuple(one.model_copy(update={"name": name}) for one, name in zip(made.actuators, names, strict=True))
    made = made.model_copy(update={"title": "[bold][/x] \x1b]0;owned\x07", "actuators": named})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    main(["localize", "panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate"])
    out = capsys.readouterr().out
    assert "[bold][/x] \\x1b]0;owned\\x07" in out
    assert "[/b]1 \\x1b[31m :smile:" in out
    assert "\x1b" not in out
    assert "\x07" not in out
    wrong = dump_scene(made).replace("magnitude = 1.0", "magnitude = nan")
    Path("panel.toml").write_text(wrong, encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["localize", "panel.toml", "--device", "cpu", "--no-pictures"])
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert err.rstrip("\n").isprintable()
