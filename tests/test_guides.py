"""The commands that begin the how-to guides, those of the README, and the code of some pages run as printed."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
GUIDES = [DOCS / f"{name}.md" for name in re.findall(r"^([a-z-]+)$", (DOCS / "guides.md").read_text(), re.M)]


def first_commands(page):
    """Return the commands of the first block of a page, if it has no code before."""
    block = re.search(r"\n\n((?: {4}.*\n)+)", page.read_text(encoding="utf-8").partition("\n## ")[0])
    return re.findall(r"^    warp-plate (.*)$", block[1], re.M) if block else []


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in GUIDES if first_commands(page)], ids=lambda page: page.stem)
def test_first_commands_run(page, tmp_path):
    if page.stem == "exploring":
        pytest.skip("its command serves a page until Ctrl-C")
    for command in first_commands(page):
        line = f"{sys.executable} -m warp_plate {command}"
        run = subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, text=True)
        assert run.returncode == 0, f"{command}\n{run.stderr}"


README = (DOCS.parent / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("command", re.findall(r"`warp-plate ((?:localize|focus|frf|sweep) .*?)`", README))
def test_commands_of_the_readme_run(command, tmp_path):
    (tmp_path / "docs").symlink_to(DOCS)
    run = subprocess.run(
        [sys.executable, "-m", "warp_plate", *command.split()], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr


@pytest.mark.slow
def test_the_panel_of_the_readme(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.S)
    answer = subprocess.check_output([sys.executable, "-c", code], cwd=tmp_path, text=True)
    assert answer.strip() == re.search(r"# (<Result .*>)", code)[1]
    assert (tmp_path / "panel-surfaces.png").exists()


COMING_FROM = (DOCS / "coming-from.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("code", re.findall(r"```python\n(.*?)```", COMING_FROM, re.S))
def test_code_for_those_who_come_from_other_programs(code, tmp_path):
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip()
