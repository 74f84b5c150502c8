"""The documentation site builds without a warning."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.slow
def test_site_builds_without_warnings(tmp_path):
    for needed in ("sphinx_gallery", "myst_nb"):
        pytest.importorskip(needed, reason="needs the extra docs")
    # Scripts of the gallery run in their own tests, tutorials where the whole site is built.
    options = ["-q", "-W", "--keep-going", "-D", "plot_gallery=0", "-D", "nb_execution_mode=off"]
    build = [sys.executable, "-m", "sphinx", *options, "docs", str(tmp_path)]
    run = subprocess.run(build, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "index.html").is_file()
    keys, commands = ((tmp_path / "reference" / f"{name}.html").read_text() for name in ("scene-keys", "command-line"))
    assert "[effects.foundation]" in keys
    assert "Stiffness k" in keys
    assert "foam of 0.1 MPa" in keys
    assert "--range" in commands
