"""Times that a command prints: the stages while it runs, and seconds that add up."""

import io
import re
import sys

import pytest

from support.commands import output_of
from warp_plate import Scene
from warp_plate.cli import output


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
