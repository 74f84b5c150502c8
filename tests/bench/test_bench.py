"""``benchmarks/bench.py``: consistency of its figures, its files, and what it skips; no test asserts a speed."""

import json
import os
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import bench as program
import numpy as np
import pytest
from step_rates import limits
from step_rates.cases import BenchCase
from step_rates.measure import BenchRow, TimingBudget, measure_all, paper_like, prepare
from step_rates.plots import commonest_size, draw_bench, fastest_of_each_size

from warp_plate.kernels.cuda import THREAD_REGISTERS
from warp_plate.plate.scheme import discretize
from warp_plate.solve.devices import find_device
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import bytes_per_plate
from warp_plate.viz.plots.frame import save_plots

HASTE = dict.fromkeys(("cpu", "cuda"), TimingBudget(0.002, 2))
SMALL = ["--device", "cpu", "--nodes", "9", "--quick"]


@pytest.fixture(autouse=True)
def small_limits(monkeypatch):
    """Measure the limits of a device within milliseconds."""
    monkeypatch.setattr(limits, "COPY_BYTES", {"cpu": 2**20, "cuda": 2**20})
    monkeypatch.setattr(limits, "CPU_PASSES", 100)


@pytest.fixture
def bench(capsys, tmp_path, monkeypatch):
    """Run the program in an empty folder: (status, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def run(*arguments):
        status = 0
        try:
            program.main(list(arguments))
        except SystemExit as left:
            status = left.code
        return status, *capsys.readouterr()

    return run


def row(**changes):
    measured = BenchRow("cpu", "float32", 27, 20, 1250, "resident", 1e-3, 1.6e10, 0.06, 1e-3, 26464, "arithmetic", 0.5)
    return replace(measured, **changes)


def record(*rows):
    """Return the JSON object of a benchmark with these rows."""
    bounds = {name: {"copy_bytes_per_second": 2e10, "flops": {"float32": 1e11}} for name in ("cpu", "cuda:0")}
    return {"limits": bounds, "rows": [asdict(one) for one in rows]}


def test_figures_are_consistent(device, path):
    kinds = [(precision, plates) for precision in ("float32", "float64") for plates in (1, 3)]
    wanted = [BenchCase(device, precision, 9, plates, path) for precision, plates in kinds]
    report = measure_all(wanted, HASTE)
    assert not report.interrupted
    for one, case in zip(report.rows, wanted, strict=True):
        assert one.measured
        assert BenchCase(one.device, one.precision, one.nodes, one.plates, one.path) == case
        assert 32 <= one.steps <= 1250
        assert one.steps % 2 == 0
        assert one.seconds > 0
        assert one.node_steps_per_second == pytest.approx(49 * one.plates * one.steps / one.seconds)
        assert one.nanoseconds_per_node_step == pytest.approx(1e9 / one.node_steps_per_second)
        assert one.swarm_seconds == pytest.approx(one.seconds * 1250 / one.steps)
        specialized = Specialized(discretize(paper_like(9, one.precision)), find_device(device))
        assert one.bytes_per_plate == bytes_per_plate(specialized, 0)
        bound, needs = report.limits[device], 4 * np.dtype(one.precision).itemsize
        limit, most = "copy", bound.copy_bytes_per_second
        if path != "streaming":
            needs, limit = limits.operations_a_node_step(specialized), "arithmetic"
            most = bound.flops[one.precision] / 2
        assert all(0 < kernel.registers <= THREAD_REGISTERS for kernel in one.kernels)
        assert bool(one.kernels) == (device != "cpu")
        assert (one.limit, one.share) == (limit, pytest.approx(one.node_steps_per_second * needs / most))


def test_operations_are_those_of_the_equation(scene):
    """Two Laplacians of 3 additions and a multiply-add, both updates, loads, and the window's share of the sum."""
    device = find_device("cpu")
    specialized = Specialized(discretize(paper_like(27, "float32")), device)
    loaded = 4 * 2 * 2 / 25**2  # four patches, each over parts of 2 × 2 cells
    assert limits.operations_a_node_step(specialized) == pytest.approx(11 + 2 * loaded + 1 / 2)
    everywhere = scene(nodes=(9, 9), actuators=[(0.0, 0.2, 0.0, 0.2)], window=(0.0, 0.01))
    assert limits.operations_a_node_step(Specialized(discretize(everywhere), device)) == pytest.approx(11 + 2 + 1)


@pytest.mark.parametrize(
    ("kind", "operations"), [("plain", 2 * 4), ("order4", 2 * 10), ("free", 21), ("stretching", 21)]
)
def test_kinds_of_plates_stay_stable(kind, operations):
    [row] = measure_all([BenchCase("cpu", "float32", 17, 2, "auto", kind)], HASTE).rows
    assert (row.kind, row.status, row.share > 0) == (kind, "measured", True)
    ready = prepare(BenchCase("cpu", "float32", 17, 2, "auto", kind))
    ready.seconds(1250)
    assert 0 < np.abs(ready.state.u.numpy()).max() < 1e-3
    assert limits.operations_a_node_step(ready.specialized) == pytest.approx(operations + 3.5, abs=1.0)


def test_large_and_unfit_cases_are_skipped(bench):
    large = ("--device", "cpu", "--nodes", "105", "--plates", "100000", "--path", "streaming")
    status, out, err = bench(*large, "--no-pictures")
    assert (status, err) == (0, "")
    assert "100000 × 105², plain: skipped: needs" in " ".join(out.split())
    assert out.splitlines()[-1] == "wrote bench.json"
    rows = json.loads(Path("bench.json").read_text(encoding="utf-8"))["rows"]
    assert all(one["status"].startswith("skipped: needs") for one in rows)
    [unfit] = measure_all([BenchCase("cpu", "float32", 9, 2, "strips")], HASTE).rows
    assert unfit.status.startswith("skipped: path = 'strips'")
    assert unfit.seconds is unfit.share is None


def test_json_table_and_pictures(bench):
    pytest.importorskip("matplotlib", reason="Matplotlib is not installed: pip install 'warp-plate[viz]'")
    status, out, err = bench(*SMALL, "--plates", "1,3", "--json", "--out", "speed.json")
    assert (status, err) == (0, "")
    answer = json.loads(out)
    assert [list(one) for one in answer["rows"]] == [list(asdict(row()))] * 2
    assert [one["plates"] for one in answer["rows"]] == [1, 3]
    assert set(answer["machine"]) == {"system", "cores", "threads", "load", "devices"}
    assert {"python", "warp-plate", "warp-lang", "numpy"} <= set(answer["versions"])
    assert set(answer["limits"]["cpu"]) == {"copy_bytes_per_second", "flops"}
    assert answer.pop("files") == sorted(os.listdir()) == ["speed.json", "speed.png", "speed.svg"]
    assert json.loads(Path("speed.json").read_text(encoding="utf-8")) == answer
    assert Path("speed.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "words",
    ["--plates 0", "--plates 1,x", "--nodes 4", "--device tpu", "--precision half", "--path fast", "--out bench.txt",
     "--out nowhere/bench.json"],
)  # fmt: skip
def test_bad_options(bench, words):
    option, value = words.split()
    status, out, err = bench(option, value)
    assert (status, out) == (2, "")
    err = err.splitlines()[-1]  # after the usage
    assert option.removeprefix("--") in err
    assert value.partition("/")[0] in err
    assert os.listdir() == []


def test_ctrl_c_keeps_finished_rows():
    wanted = [BenchCase("cpu", "float32", 9, plates) for plates in (1, 2, 3)]

    def interrupt(done, case):
        if case.plates == 2:
            raise KeyboardInterrupt

    report = measure_all(wanted, HASTE, interrupt)
    assert report.interrupted
    assert [one.plates for one in report.rows] == [1]
    with pytest.raises(KeyboardInterrupt):
        measure_all(wanted[1:], HASTE, interrupt)


def test_plots(tmp_path):
    """Lines for measured rows only, a limit for each device, and the fastest row of each size; failures are said."""
    pytest.importorskip("matplotlib", reason="Matplotlib is not installed: pip install 'warp-plate[viz]'")
    rows = [row(device=device, plates=plates) for device in ("cpu", "cuda:0") for plates in (1, 20)]
    skipped = row(precision="float64", status="skipped: too large", nanoseconds_per_node_step=None)
    path = tmp_path / "bench.svg"
    draw_bench(record(*rows, row(nodes=53), skipped), path)
    text = path.read_text(encoding="utf-8")
    for label in ("cpu, float32", "cuda:0, float32", "cuda:0, 16 B at copy bandwidth", "plates of 27 × 27 nodes"):
        assert f"<!-- {label} -->" in text
    assert "float64" not in text
    assert save_plots(partial(draw_bench, record(skipped)), path) == ([], "no plot: nothing was measured")
    files, missing = save_plots(partial(draw_bench, record(row())), tmp_path / "absent" / "bench.json")
    assert files == []
    assert "absent" in missing
    rows = record(row(plates=1), row(plates=20), row(nodes=53), row(nodes=53, nanoseconds_per_node_step=0.01))["rows"]
    assert commonest_size(rows) == 27
    best = fastest_of_each_size(rows)
    assert {(one["nodes"], one["nanoseconds_per_node_step"]) for one in best} == {(27, 0.06), (53, 0.01)}
