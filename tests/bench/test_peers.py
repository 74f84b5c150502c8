"""``benchmarks/peers.py``: the other tools do the same work, at both orders."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "peers.py"


@pytest.mark.slow
@pytest.mark.parametrize("order", ["2", "4"])
def test_peers_agree(order, tmp_path):
    """The program ends with status 1 if the energies of a peer differ from those of the plain reference."""
    options = ["--cases", "3x27,1x41", "--rounds", "1", "--seconds", "0.01", "--threads", "1", "--order", order]
    figures = tmp_path / "peers.json"
    subprocess.run([sys.executable, PROGRAM, *options, "--json", figures], check=True, timeout=200)
    for case in json.loads(figures.read_text(encoding="utf-8"))["cases"]:
        peers = {result["peer"] for result in case["results"]}
        assert peers >= ({"warp-plate", "numpy", "scipy"} if order == "2" else {"warp-plate"})
