"""Command lines of every kind: a right answer with status 0, or one line and status 2 with nothing written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from warp_plate import load_result
from warp_plate.cli.main import main
from warp_plate.cli.output import LONGEST_ENDING
from warp_plate.plate import memory
from warp_plate.scene.dump import dump_scene

ROOT = Path(__file__).parents[2]
QUIET = ("--device", "cpu", "--no-pictures", "--no-estimate")
LONG = "y" * 300
# Of every kind of option, what no command takes for it.
NO_NUMBER = ["", " ", "a", "nan", "1e400", "9" * 5000, "0b2", "²", "a\0b", "\x1b[31m", "[red]", "\ud800", LONG]
NO_WORD = ["", "a", "0", "AUTO ", "a\0b", "\x1b[31m", "[red]", "a\nb", "\ud800", LONG]
NO_DEVICE = ["", "0", "gpu", "cuda:-1", "cuda:999", "cuda:" + "9" * 20, "cpu:0", "cpu,cpu,", "a\0b", "\x1b[31m"]
NO_FLAG = ["=maybe", "=2", "=[red]", "=\x1b[31m"]
NO_ACCURACY = ["", "0", "-1%", "nan", "inf%", "1e400", "1%%", "51%", "one", "\x1b[31m", "9" * 5000]
NO_FILE = ["", ".", "..", "/", "found.txt", "h5"]
NO_FILE += [f"{stem}{{0}}" for stem in ("no/x", "file/x", LONG, "a\0b", "\ud800", "folder")]
KINDS = {
    "device": NO_DEVICE,
    "seed": [*NO_NUMBER, "1_0", "0x10", "٣", "-1", "1.5", str(2**63)],
    "count": [*NO_NUMBER, "0", "-1", "1.5"],
    "budget": [*NO_NUMBER, "0", "-1", "inf", "-inf"],
    "plates": [*NO_NUMBER, "0", "1,,2", ",", "1;2", "99999999"],
    "nodes": [*NO_NUMBER, "4", "8194", "27x27"],
    "samples": [*NO_NUMBER, "0", "-1", "1.5", "1000001"],
    "vary": ["", "=", "a", "drive=1,2", "drive.frequency=", "drive.frequency=1:2", "drive.frequency=\x1b[31m,2", LONG],
    "what": NO_WORD,
    "path": NO_WORD,
    "evaluator": NO_WORD,
    "precision": [*NO_WORD, "float16"],
    "accuracy": NO_ACCURACY,
    "drive": ["", "a", "best", "none.h5", "folder.h5", "junk.h5", "a\0b.h5", f"{LONG}.h5", "\ud800.h5", "\x1b[31m"],
    "out": NO_FILE,
    "resume": [
        "", ".", "a", "none.checkpoint.h5", "junk.h5", "folder.h5", "a\0b.checkpoint.h5", f"{LONG}.checkpoint.h5"
    ],
    "checkpoint-every": ["", " ", "a", "nan", "-1", "-inf", "\x1b[31m", "\ud800"],  # inf: never
    "estimate": NO_FLAG,
    "pictures": NO_FLAG,
    "json": NO_FLAG,
}
SEARCH = ["device", "seed", "evaluator", "path", "accuracy", "estimate", "checkpoint-every", "resume"]
SWEEP = ["vary", "what", "samples", "count", "device", "path", "checkpoint-every", "resume"]
COMMANDS = {
    "localize": (".h5", [*SEARCH, "out", "pictures", "json"]),
    "simulate": (".h5", ["drive", "device", "path", "accuracy", "estimate", "out", "pictures", "json"]),
    "sweep": (".h5", [*SWEEP, "out", "pictures", "json"]),
    "modes": (".png", ["count", "accuracy", "out", "pictures", "json"]),
    "effects": ("", ["device", "accuracy", "json"]),
    "accuracy": (".json", ["device", "budget", "path", "out", "pictures", "json"]),
    "bench": (".json", ["plates", "nodes", "precision", "device", "path", "out", "pictures", "quick"]),
}


@pytest.fixture
def folder(tmp_path, monkeypatch, scene):
    """The working folder, with a scene that is quickly run, one that is refused, and things that are no files."""
    monkeypatch.chdir(tmp_path)
    made = scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    Path("wrong.toml").write_text("x = 1", encoding="utf-8")
    Path("file").touch()
    Path("junk.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(300))
    for ending in (".h5", ".json", ".png"):
        Path(f"folder{ending}").mkdir()
    return made


@pytest.fixture
def command(capsys):
    """Run a command in this process: (status, standard output, standard error)."""

    def run(*arguments):
        try:
            main(list(arguments))
            status = 0
        except SystemExit as left:
            status = left.code or 0
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


def files():
    return sorted(str(path) for path in Path().rglob("*"))


def refused(answer):
    """Status 2, nothing on standard output, one line on standard error that a terminal shows as it is."""
    status, out, err = answer
    assert (status, out) == (2, "")
    assert err.startswith("warp-plate: ")
    assert err.endswith("\n")
    assert err[:-1].isprintable()
    return err


@pytest.mark.parametrize(("name", "option"), [(name, one) for name, (_, known) in COMMANDS.items() for one in known])
def test_every_option_with_what_it_does_not_take(name, option, folder, command):
    before = files()
    scene = [] if name == "bench" else ["panel.toml"]
    if name == "sweep" and option not in ("vary", "resume"):
        scene += ["--vary", "drive.frequency=200,300", *(["--what", "check"] if option != "what" else [])]
    for odd in KINDS.get(option, NO_FLAG):
        value = odd.replace("{0}", COMMANDS[name][0])
        given = [f"--{option}{value}"] if odd in NO_FLAG else [f"--{option}", value]
        refused(command(name, *scene, *given))
        assert files() == before


@pytest.mark.parametrize("name", ["localize", "sweep", "simulate", "modes", "effects", "accuracy"])
def test_every_command_with_what_is_no_scene(name, folder, command):
    for odd in ("", ".", "file", "wrong.toml", "junk.h5", "folder.h5", "a\0b", "[red]", "\x1b[31m", "\ud800", LONG):
        refused(command(name, odd))
    refused(command(name, "panel.toml", "panel.toml"))


@pytest.mark.parametrize("out", ["", ".", "file", "folder.h5", "no/x.toml", "file/x", "a\0b", "\ud800", LONG, "/"])
def test_init_into_what_is_no_new_file(out, folder, command):
    before = files()
    refused(command("init", "paper", "--out", out))
    assert files() == before


def test_a_name_that_leaves_no_room_is_refused_before_any_work(folder, command):
    """A checkpoint's unfinished file has the longest name; the longest one that leaves it room is taken."""
    most = os.pathconf(".", "PC_NAME_MAX") - len(LONGEST_ENDING) - 1
    status, _, _ = command("simulate", "panel.toml", "--out", "y" * most + ".h5", "--no-pictures", "--no-estimate")
    assert status == 0
    before = files()
    for out in ("y" * (most + 1) + ".h5", "ä" * (most // 2 + 1) + ".h5"):
        for name in ("simulate", "localize"):
            line = refused(command(name, "panel.toml", "--out", out))
            assert f"beside it take {len(LONGEST_ENDING) - 2} bytes more" in line
    for name, ending in (("render", ".png"), ("export", ".pvd")):
        to = ["--to", "pvd"] if name == "export" else []
        line = refused(command(name, "y" * most + ".h5", *to, "--out", "y" * (most + 1) + ending))
        assert "no name" in line or "bytes more" in line
    assert files() == before


def test_a_search_at_the_longest_name_keeps_its_checkpoints(folder, command):
    out = "y" * (os.pathconf(".", "PC_NAME_MAX") - len(LONGEST_ENDING) - 1) + ".h5"
    options = ["--checkpoint-every", "0", "--no-pictures", "--no-estimate", "--device", "cpu"]
    status, _, err = command("localize", "panel.toml", "--out", out, *options)
    assert (status, err) == (0, "")
    assert out in files()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("words", [["render", "pipe"], ["view", "pipe"], ["localize", "--resume", "pipe"]])
def test_a_pipe_is_no_result(words, folder, command):
    """Reading from one that nobody writes to would not end."""
    os.mkfifo("pipe")
    assert "pipe: is no file" in refused(command(*words))
    Path("pipe").unlink()
    Path("pipe").mkdir()
    assert "pipe: is no file" in refused(command(*words))


WORDS = [*COMMANDS, "init", "wrong.toml", "none", "--", "-", "=", "1", "cpu", "auto", "--no-pictures", "--quick"]
WORDS += [f"--{option}" for option in KINDS]


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(words=st.lists(st.sampled_from(WORDS) | st.text(max_size=4), max_size=6))
def test_any_words_make_one_line(words, folder, command):
    """No scene among them can be run; help and the version may be asked for."""
    words = [word for word in words if word not in ("bench", "init")]  # these need none
    before = files()
    status, out, err = command(*words)
    if status == 0:
        assert not err
        assert "warp-plate" in out or not words or out[0].isdigit()
    else:
        refused((status, out, err))
    assert files() == before


@pytest.mark.parametrize("name", ["my panel.toml", "Größe ü.toml", "[red].toml", "-x.toml", "a\nb.toml", "x.y.toml"])
def test_scenes_of_any_name(name, folder, command):
    """The result bears the scene's name, and the same answer is printed."""
    text = Path("panel.toml").read_text(encoding="utf-8")
    Path(name).write_text(text, encoding="utf-8")
    # As a command line would have it: what begins with a dash is a file with ./ before it.
    status, out, err = command("simulate", f"./{name}", *QUIET)
    assert (status, err) == (0, "")
    made = f"{Path(name).stem}-simulate.h5"
    assert load_result(made).source == f"./{name}"
    assert out.replace("\\n", "\n").count(f"wrote {made}") == 1


def test_more_than_memory_holds_is_one_line(folder, command, monkeypatch):
    monkeypatch.setattr(memory, "machine_memory", lambda: 2.0**10)
    for name in ("localize", "simulate"):
        assert "GiB of memory" in refused(command(name, "panel.toml", "--no-pictures"))


def test_a_swarm_larger_than_memory_is_one_line(folder, command, scene, monkeypatch):
    Path("panel.toml").write_text(dump_scene(scene(search={"particles": 10_000_000})), encoding="utf-8")
    monkeypatch.setattr(memory, "machine_memory", lambda: 2.0**28)
    assert "search.particles = 10000000" in refused(command("localize", "panel.toml", "--no-pictures"))


def test_memory_that_gives_out_is_one_line(folder, command, monkeypatch):
    def none_left(*arguments, **options):
        raise MemoryError("Unable to allocate 4 TiB")

    monkeypatch.setattr("warp_plate.solve.solver.np.empty", none_left)
    assert "out of memory: Unable to allocate 4 TiB" in refused(command("simulate", "panel.toml", "--no-pictures"))


def process(*arguments, **options):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"}
    return subprocess.run(
        [sys.executable, "-m", "warp_plate", *arguments], env=environment, stderr=subprocess.PIPE, text=True, **options
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a device that is always full")
def test_a_full_standard_output_is_one_line(folder):
    with open("/dev/full", "w") as full:
        answer = process("simulate", "panel.toml", "--json", *QUIET, stdout=full)
    assert answer.returncode == 2
    assert answer.stderr == "warp-plate: No space left on device\n"


def test_a_terminal_without_greek_letters_is_no_fault(folder):
    answer = process("modes", "panel.toml", "--no-pictures", stdout=subprocess.PIPE)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert "13 \\xd7 13 nodes" in answer.stdout
