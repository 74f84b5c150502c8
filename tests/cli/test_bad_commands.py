"""Command lines of every kind: a right answer with status 0, or one line and status 2 with nothing written."""

import os
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from support.commands import error_of as refused
from support.commands import start_program
from warp_plate.cli.design import MAP, UNFINISHED
from warp_plate.cli.output import LONGEST_ENDING
from warp_plate.plate import memory
from warp_plate.result.checkpoint import ENDING

with suppress(ImportError):  # Windows
    import resource

QUICK = ("--device", "cpu", "--no-pictures", "--no-estimate")
LONG = "y" * 300
# Values that no option of a kind takes.
NO_NUMBER = ["", " ", "a", "nan", "1e400", "9" * 5000, "0b2", "²", "a\0b", "\x1b[31m", "[red]", "\ud800", LONG]
NO_WORD = ["", "a", "0", "AUTO ", "a\0b", "\x1b[31m", "[red]", "a\nb", "\ud800", LONG]
NO_DEVICE = ["", "0", "gpu", "cuda:-1", "cuda:999", "cuda:" + "9" * 20, "cpu:0", "cpu,cpu,", "a\0b", "\x1b[31m"]
NO_FLAG = ["=maybe", "=2", "=[red]", "=\x1b[31m"]
NO_ACCURACY = ["", "0", "1_0%", "٣%", "-1%", "nan", "inf%", "1e400", "1%%", "51%", "one", "\x1b[31m", "9" * 5000]
NO_RESULT = ["", ".", "a", "none", "junk.h5", "folder.h5", "a\0b.checkpoint.h5", f"{LONG}.checkpoint.h5"]
NO_FILE = ["", ".", "..", "/", "found.txt", "h5"]
NO_FILE += [f"{stem}{{0}}" for stem in ("no/x", "file/x", LONG, "a\0b", "\ud800", "folder")]
VALUES = {
    "device": NO_DEVICE,
    "seed": [*NO_NUMBER, "1_0", "0x10", "٣", "-1", "1.5", str(2**63)],
    "count": [*NO_NUMBER, "0", "-1", "1.5"],
    "budget": [*NO_NUMBER, "0", "-1", "inf", "-inf"],
    "samples": [*NO_NUMBER, "0", "-1", "1.5", "1000001"],
    "vary": ["", "=", "a", "drive=1,2", "drive.frequency=", "drive.frequency=1:2", "drive.frequency=\x1b[31m,2", LONG],
    "what": NO_WORD,
    "methods": NO_WORD,
    "seeds": [*NO_NUMBER, "0", "-1", "1.5"],
    "evaluations": [*NO_NUMBER, "0", "-1", "1.5", "2"],
    "path": NO_WORD,
    "evaluator": NO_WORD,
    "accuracy": NO_ACCURACY,
    "drive": ["best", *(f"{name}.h5" for name in NO_RESULT)],
    "out": NO_FILE,
    "resume": NO_RESULT,
    "checkpoint-every": ["", " ", "a", "nan", "-1", "-inf", "\x1b[31m", "\ud800"],  # inf means never
}
# Options of each command that no other command before has with the same converter and check.
COMMANDS = {
    "localize": (".h5", ["device", "seed", "evaluator", "path", "accuracy", "estimate", "checkpoint-every"]),
    "simulate": (".h5", ["drive", "device", "out", "pictures", "json"]),
    "sweep": (".h5", ["vary", "what", "samples", "count", "device", "checkpoint-every"]),
    "modes": (".png", ["count", "out"]),
    "frf": (".png", ["out"]),
    "focus": (".h5", ["out"]),
    "effects": ("", ["device"]),
    "accuracy": (".json", ["device", "budget", "out"]),
}


@pytest.fixture
def folder_of_files(write_scene):
    """The working folder, with a valid scene, invalid ones, and folders in place of files."""
    write_scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    Path("wrong.toml").write_text("x = 1", encoding="utf-8")
    Path("file").touch()
    Path("junk.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(300))
    for ending in (".h5", ".json", ".png"):
        Path(f"folder{ending}").mkdir()


def files():
    return sorted(str(path) for path in Path().rglob("*"))


@pytest.mark.parametrize(("name", "option"), [(name, one) for name, (_, known) in COMMANDS.items() for one in known])
def test_every_option_with_values_that_it_does_not_take(name, option, folder_of_files, command):
    before = files()
    scene = ["panel.toml"]
    if name == "sweep" and option != "vary":
        scene += ["--vary", "drive.frequency=200,300", *(["--what", "check"] if option != "what" else [])]
    for value in VALUES.get(option, NO_FLAG):
        value = value.replace("{0}", COMMANDS[name][0])
        refused(command(name, *scene, *([f"--{option}", value] if option in VALUES else [f"--{option}{value}"])))
        assert files() == before


@pytest.mark.parametrize(
    "line",
    ["explore paper --port", "export a.h5 --to drive-wav --rate", *(f"render a.h5 --{n}" for n in ("frames", "modes"))],
)
def test_numbers_that_are_not_whole_are_not_rounded(line, command):
    assert "'2.5' is not an integer" in refused(command(*line.split(), "2.5"))


@pytest.mark.parametrize("name", ["localize", "sweep", "simulate", "modes", "effects", "accuracy"])
def test_every_command_with_what_is_no_scene(name, folder_of_files, command):
    for odd in ("", ".", "file", "wrong.toml", "junk.h5", "folder.h5", "a\0b", "[red]", "\x1b[31m", "\ud800", LONG):
        refused(command(name, odd))
    refused(command(name, "panel.toml", "panel.toml"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_pipes_and_folders_are_no_files(folder_of_files, command):
    """Reading a pipe that nobody writes to would never end."""
    os.mkfifo("pipe")
    for words in (["render", "pipe"], ["view", "pipe"], ["localize", "--resume", "pipe"]):
        assert "pipe: " in refused(command(*words))
    for name, beside in (("specify", "panel-specify.best.toml"), ("design", "panel.designed.unfinished.json")):
        os.mkfifo(beside)
        assert f"{beside}: is a pipe or a device" in refused(command(name, "panel.toml"))
    before = files()
    for out in ("", ".", "file", "folder.h5", "no/x.toml", "file/x", "a\0b", "\ud800", LONG, "/"):
        assert "Errno" not in refused(command("init", "paper", "--out", out))
        assert files() == before


def test_the_longest_file_names(folder_of_files, command):
    """Names that leave no room for the temporary files beside a result are refused before any work."""
    for beside in (UNFINISHED, MAP, ENDING, ".best.64.toml", "-time_reversal-64.wav", "-inverse_filter-64.wav"):
        assert len(f"{beside}.123456789abc.part{Path(f'x{beside}').suffix}") <= len(LONGEST_ENDING)
    most = os.pathconf(".", "PC_NAME_MAX") - len(LONGEST_ENDING) - 1
    longest = "y" * most + ".h5"
    assert command("localize", "panel.toml", "--out", longest, "--checkpoint-every", "0", *QUICK)[::2] == (0, "")
    before = files()
    assert longest in before
    for out in ("y" * (most + 1) + ".h5", "ä" * (most // 2 + 1) + ".h5"):
        for name in ("simulate", "localize"):
            assert "42 bytes longer" in refused(command(name, "panel.toml", "--out", out))
    for words in (["render", longest, "--out", "y" * (most + 1) + ".png"],
                  ["export", longest, "--to", "vtkhdf", "--out", "y" * (most + 1) + ".vtkhdf"]):  # fmt: skip
        assert "bytes longer" in refused(command(*words))
    assert files() == before


@pytest.mark.parametrize(
    ("room", "tables", "line"),
    [
        (2.0**29, {"search": {"iterations": 10**9}}, "search.iterations = 1000000000 in this search: takes"),
        (2.0**29, {"search": {"robust": {"scenarios": 99_999, "gain": 0.1}}}, "search.robust.scenarios = 99999 in"),
        (2.0**26, {"actuators": 200 * [(0.1, 0.15, 0.1, 0.15)]}, "actuators = 200 in this search: takes about"),
        (
            2.0**30,
            {"size": (0.8, 0.8), "modal_density": 1.0, "search": {"position": {}}},
            "plate.size = [0.8, 0.8] in this search: takes",
        ),
    ],
)
def test_searches_beyond_the_memory_name_the_key_to_lower(write_scene, command, monkeypatch, room, tables, line):
    write_scene(**tables | {"search": {"method": "pso", **tables.get("search", {})}})
    monkeypatch.setattr(memory, "machine_memory", lambda: room)
    assert line in refused(command("localize", "panel.toml", *QUICK))
    assert "lower" in command("check", "panel.toml", "--device", "cpu")[1]


@pytest.mark.skipif(sys.platform != "linux", reason="counts the address space in use by /proc")
def test_a_limit_of_address_space_counts(write_scene):
    write_scene(search={"method": "pso", "particles": 10_000_000})
    words = ("-m", "warp_plate", "localize", "panel.toml", *QUICK)
    room = 2**32  # of 10^7 particles with 4 numbers each
    program = start_program(*words, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (room, room)))
    out, err = program.communicate()
    assert "search.particles = 10000000" in refused((program.returncode, out, err))


def test_more_than_fits_into_memory(folder_of_files, write_scene, command, monkeypatch):
    with monkeypatch.context() as patch:
        write_scene(name="swarm", search={"particles": 10_000_000})
        patch.setattr(memory, "machine_memory", lambda: 2.0**28)
        assert "search.particles = 10000000" in refused(command("localize", "swarm.toml", "--no-pictures"))

    def none_left(*arguments, **options):
        raise MemoryError("Unable to allocate 4 TiB")

    monkeypatch.setattr("warp_plate.solve.solver.np.empty", none_left)
    assert "out of memory: Unable to allocate 4 TiB" in refused(command("simulate", "panel.toml", "--no-pictures"))
