"""A command reaches no file but those that its command line names.

Files that a scene names outside its folder are refused in ``plate/test_sampled.py``; what code of the product may call
at all is in ``test_architecture.py``.
"""

import os
import subprocess
import sys
from pathlib import Path

import warp as wp

# Runs a command and prints what Python reports about files, processes and connections, one event a line.
WATCHED = """
import os, sys, tempfile
tempfile.gettempdir()  # tries to write a file of its own as soon as Warp compiles
seen = set()
def hook(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        path, mode, flags = arguments
        writes = flags & (os.O_WRONLY | os.O_RDWR) or (isinstance(mode, str) and set(mode) & set("wax+"))
        seen.add(("write" if writes else "read", os.path.abspath(os.fsdecode(path))))
    elif event in ("os.rename", "os.remove", "os.mkdir", "os.link", "os.symlink", "shutil.rmtree"):
        seen.add(("write", os.path.abspath(os.fsdecode(arguments[0]))))
    elif event.split(".")[0] in ("socket", "ftplib", "urllib", "http") or event in ("os.system", "os.exec"):
        seen.add(("call", event))
    elif event == "subprocess.Popen":
        seen.add(("start", str(arguments[0])))
sys.addaudithook(hook)
from warp_plate.cli.main import main
try:
    main(sys.argv[1:])
finally:
    print("watched", *(f"{what} {name}" for what, name in sorted(seen)), sep="\\n", file=sys.__stderr__)
"""


def test_a_command_writes_its_own_files_and_no_others(tmp_path, scene):
    """The result in this folder and Warp's own cache; no connection, no other process."""
    made = scene(damping=88.5, precision="float32", search={"particles": 3, "iterations": 2})
    (tmp_path / "panel.toml").write_text(made.to_toml(), encoding="utf-8")
    (tmp_path / "private.toml").write_text("secret", encoding="utf-8")
    wp.init()
    cache = Path(wp.config.kernel_cache_dir).resolve()
    arguments = [sys.executable, "-c", WATCHED, "localize", "panel.toml", "--device", "cpu", "--no-pictures", "--json"]
    arguments += ["--no-estimate", "--no-spectrum"]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    answer = subprocess.run(arguments, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    events = [line.split(" ", 1) for line in answer.stderr.partition("watched\n")[2].splitlines()]
    assert ["read", str(tmp_path / "panel.toml")] in events
    for what, name in events:
        assert what in ("read", "write") or [what, name] == ["start", "uname"], (what, name)  # by the module platform
        path = Path(name)
        of_warp = cache == path.resolve() or cache in path.resolve().parents or path.name.startswith("wp_")
        if what == "write" and not of_warp and path != Path(os.devnull):
            assert path.parent == tmp_path, (what, name)
        assert path.name != "private.toml"
    names = ["panel-localize.best.toml", "panel-localize.h5", "panel.toml", "private.toml"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
