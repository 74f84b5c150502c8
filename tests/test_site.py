"""The documentation site builds without a warning."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
GENERATED = {"gallery", "reference"}


@pytest.mark.slow
def test_site_builds_without_warnings(tmp_path):
    for needed in ("sphinx_gallery", "myst_nb"):
        pytest.importorskip(needed, reason="needs the extra docs")
    # In a copy: scripts and tutorials do not run here, and their pages are generated beside the sources.
    docs, site = tmp_path / "docs", tmp_path / "site"
    shutil.copytree(ROOT / "docs", docs, ignore=lambda folder, _: GENERATED if Path(folder) == ROOT / "docs" else ())
    (tmp_path / "benchmarks").symlink_to(ROOT / "benchmarks")
    options = ["-q", "-W", "--keep-going", "-D", "plot_gallery=0", "-D", "nb_execution_mode=off"]
    build = [sys.executable, "-m", "sphinx", *options, str(docs), str(site)]
    run = subprocess.run(build, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert (site / "gallery" / "index.html").is_file()
    keys, commands = ((site / "reference" / f"{name}.html").read_text() for name in ("scene-keys", "command-line"))
    assert "[effects.foundation]" in keys
    assert "Stiffness k" in keys
    assert "foam of 0.1 MPa" in keys
    assert "--range" in commands
