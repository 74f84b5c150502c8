"""Commands import what they need and no more: imports are most of the time of a short command."""

import subprocess
import sys

import pytest

# Heavy libraries, those whose parts are heavy by part.
HEAVY = "dask h5py IPython matplotlib PIL pydantic pyvista rich.progress scipy vtkmodules warp"
PARTS = "scipy.interpolate scipy.optimize scipy.signal scipy.spatial scipy.stats"
STEPS = {"pydantic", "warp", "scipy"}
RUN = """
import contextlib, io, sys
from warp_plate.cli.main import main
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
    main(sys.argv[1:])
print(len(sys.modules), *sys.modules)
"""


@pytest.mark.parametrize(
    ("arguments", "allowed", "most"),
    [
        (["localize", "--help"], set(), 600),
        pytest.param(["export", "--help"], set(), 600, marks=pytest.mark.slow),
        (["check", "paper"], STEPS, 950),
        pytest.param(["modes", "paper", "--no-pictures"], STEPS - {"warp"}, 850, marks=pytest.mark.slow),
        (["frf", "paper", "--no-pictures"], STEPS - {"warp"} | {"h5py"}, 880),
        pytest.param(
            ["localize", "paper", "--device", "cpu", "--no-pictures"],
            STEPS | {"h5py", "rich.progress"},
            1150,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_import_budget(arguments, allowed, most, tmp_path):
    answer = subprocess.check_output([sys.executable, "-c", RUN, *arguments], cwd=tmp_path, text=True)
    count, *modules = answer.split()
    assert {*HEAVY.split(), *PARTS.split()} & set(modules) <= allowed
    assert int(count) <= most
