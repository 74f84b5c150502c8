"""Nothing in a scene or a result runs code, or reaches outside the files that the command line names."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp

from warp_plate.scene.dump import dump_scene

ROOT = Path(__file__).parents[2]
# What makes code of data, or listens and calls: none of it is in the package.
FORBIDDEN_NAMES = {"eval", "exec", "compile", "__import__", "globals", "breakpoint"}
FORBIDDEN_MODULES = {
    "pickle", "marshal", "shelve", "dill", "joblib", "yaml", "code", "codeop", "runpy", "socket", "ssl",
    "http", "urllib", "ftplib", "smtplib", "xmlrpc", "socketserver", "requests", "webbrowser", "asyncio",
}  # fmt: skip
FORBIDDEN_ATTRIBUTES = {"popen", "execv", "spawnv", "fromstring"}
# Starts itself once more to try out a drawing library or as a worker, asks the machine for its name, or writes a movie:
# fixed words, no shell.
STARTS_PROCESSES = {
    "viz/availability.py", "viz/pictures.py", "warp_plate/bench/machine.py",
}  # fmt: skip
# Serves a page on 127.0.0.1, and opens it.
SERVES = {"viz/explorer_page.py": {"asyncio", "socket"}, "warp_plate/cli/explore.py": {"webbrowser"}}


def sources():
    return [path for folder in ("warp_plate", "kernels", "viz") for path in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(ROOT)))
def test_no_file_makes_code_of_data(path):
    name = path.relative_to(ROOT).as_posix()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            called = node.func
            told = {keyword.arg for keyword in node.keywords if getattr(keyword.value, "value", None)}
            bad = isinstance(called, ast.Name) and called.id in FORBIDDEN_NAMES
            bad |= isinstance(called, ast.Attribute) and called.attr in FORBIDDEN_ATTRIBUTES
            bad |= isinstance(called, ast.Attribute) and ast.unparse(called) == "os.system"
            assert not bad | bool(told & {"shell", "allow_pickle"}), f"{name}:{node.lineno}"
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        heads = {module.split(".")[0] for module in modules}
        assert not heads & FORBIDDEN_MODULES - SERVES.get(name, set()), f"{name}:{node.lineno}: {heads}"
        assert "subprocess" not in heads or name in STARTS_PROCESSES, f"{name}:{node.lineno}"


# Runs a command and prints which files it opens to write, and what else it does that Python reports: one a line.
WATCHED = """
import os, sys, tempfile
tempfile.gettempdir()  # Python tries by a file of its own whether it can write there, as soon as Warp compiles
seen = set()
def hook(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        path, mode, flags = arguments
        if flags & (os.O_WRONLY | os.O_RDWR) or (isinstance(mode, str) and set(mode) & set("wax+")):
            seen.add(("write", os.path.abspath(os.fsdecode(path))))
        else:
            seen.add(("read", os.path.abspath(os.fsdecode(path))))
    elif event in ("os.rename", "os.remove", "os.mkdir", "os.link", "os.symlink", "shutil.rmtree"):
        seen.add(("change", os.path.abspath(os.fsdecode(arguments[0]))))
    elif event.split(".")[0] in ("socket", "ftplib", "urllib", "http") or event in ("os.system", "os.exec"):
        seen.add(("call", event))
    elif event == "subprocess.Popen":
        seen.add(("start", str(arguments[0])))
sys.addaudithook(hook)
from warp_plate.cli.main import main
try:
    main(sys.argv[1:])
finally:
    hook = None
    print("watched", *(f"{what} {name}" for what, name in sorted(seen)), sep="\\n", file=sys.__stderr__)
"""


def watched(folder, *arguments):
    """Kind and name of everything that a command does to files and to the world outside."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    answer = subprocess.run(
        [sys.executable, "-c", WATCHED, *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr
    lines = answer.stderr.partition("watched\n")[2].splitlines()
    return [tuple(line.split(" ", 1)) for line in lines]


@pytest.mark.parametrize("command", ["localize", "simulate"])
def test_a_command_writes_its_own_files_and_no_others(command, tmp_path, scene):
    """As Python sees it: the result in this folder, Warp's own cache, and nothing else; nobody is called."""
    made = scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    mine, other = tmp_path / "mine", tmp_path / "other"
    mine.mkdir()
    other.mkdir()
    (mine / "panel.toml").write_text(dump_scene(made), encoding="utf-8")
    (mine / "private.toml").write_text("secret", encoding="utf-8")
    (other / "private.csv").write_text("0,1\n1,2\n", encoding="utf-8")
    wp.init()
    cache = Path(wp.config.kernel_cache_dir).resolve()
    done = watched(mine, command, "panel.toml", "--device", "cpu", "--no-pictures", "--json")
    assert ("read", str(mine / "panel.toml")) in done
    for what, name in done:
        # (Python itself asks uname for the processor's name.)
        assert what in ("read", "write", "change") or (what, name) == ("start", "uname"), (what, name)
        path = Path(name)
        warp_s = cache == path.resolve() or cache in path.resolve().parents or path.name.startswith("wp_")
        if what in ("write", "change") and not warp_s and path != Path(os.devnull):
            assert path.parent == mine, (what, name)
        assert path.name not in ("private.toml", "private.csv"), (what, name)
    found = ["panel-localize.best.toml"] if command == "localize" else []
    written = [*found, f"panel-{command}.h5", "panel.toml", "private.toml"]
    assert sorted(path.name for path in mine.iterdir()) == written


@pytest.mark.parametrize(
    "file",
    [
        "../other/private.csv", "/etc/hosts.csv", "..\\\\other\\\\private.csv", "C:private.csv", "~/private.csv",
        "file:///private.csv", "linked.csv", "private.csv\\u0000.wav", "*.csv", "$HOME.csv",
    ],
)  # fmt: skip
def test_a_scene_names_no_file_outside_its_folder(file, tmp_path, scene, capsys, monkeypatch):
    from warp_plate.cli.main import main

    mine, other = tmp_path / "mine", tmp_path / "other"
    mine.mkdir()
    other.mkdir()
    (other / "private.csv").write_text("0,7\n0.5,7\n", encoding="utf-8")
    (mine / "linked.csv").symlink_to(other / "private.csv")
    text = dump_scene(scene(window=(0.001, 0.002)))
    (mine / "panel.toml").write_text(text + f'\n[drive.signal]\nfile = "{file}"\n', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(["simulate", "mine/panel.toml", "--device", "cpu", "--no-pictures"])
    assert left.value.code == 2
    assert "drive.signal" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "other"]
