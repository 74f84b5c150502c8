"""``warp-plate bench``: what its figures say of each other, its files, and what it leaves out; never how fast it is."""

import json
import os
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from warp_plate.bench import cases, limits, machine, measure
from warp_plate.bench.cases import BenchCase, filling_plates, make_cases
from warp_plate.bench.measure import FULL, QUICK, BenchRow, TimingBudget, measure_all, paper_like, prepare
from warp_plate.cli.main import main
from warp_plate.kernels.limits import make_multiply_adds
from warp_plate.plate.discretization import discretize
from warp_plate.plate.scheme import make_scheme
from warp_plate.solve.cpu import compiler_flags
from warp_plate.solve.devices import cpu_threads, find_device
from warp_plate.solve.specialize import specialize
from warp_plate.solve.state import bytes_per_plate
from warp_plate.viz.plots.bench import commonest_size, draw_bench, fastest_of_each_size
from warp_plate.viz.plots.frame import save_plots

HASTE = {"cpu": TimingBudget(0.002, 2), "cuda": TimingBudget(0.002, 2)}
KEYS = ["machine", "versions", "limits", "rows", "interrupted"]
ROW_KEYS = ["device", "precision", "nodes", "plates", "steps", "path", "seconds", "node_steps_per_second"]
ROW_KEYS += ["nanoseconds_per_node_step", "swarm_seconds", "bytes_per_plate", "limit", "share", "status"]
SMALL = ["--device", "cpu", "--nodes", "9", "--quick"]


@pytest.fixture(autouse=True)
def small_limits(monkeypatch):
    """The limits of a device from a few milliseconds of work, and files in a folder of their own."""
    monkeypatch.setattr(limits, "COPY_BYTES", {"cpu": 2**20, "cuda": 2**20})
    monkeypatch.setattr(limits, "CPU_PASSES", 100)


@pytest.fixture
def command(capsys, tmp_path, monkeypatch):
    """Run ``bench`` in an empty folder: (status, standard output, standard error without the line on load)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        try:
            main(["bench", *(str(argument) for argument in arguments)])
            status = 0
        except SystemExit as left:
            status = left.code or 0
        captured = capsys.readouterr()
        lines = [line for line in captured.err.splitlines() if not line.startswith("warp-plate: this machine is busy")]
        return status, captured.out, "\n".join(lines)

    return run


def row(**changes):
    """A measured row, with changes."""
    usual = BenchRow(
        "cpu", "float32", 27, 20, 1250, "resident", 1e-3, 1.6e10, 0.06, 1e-3, 26464, "arithmetic", 0.5, "measured"
    )
    return replace(usual, **changes)


def record(*rows):
    """The JSON object of a benchmark with these rows."""
    bounds = {name: {"copy_bytes_per_second": 2e10, "flops": {"float32": 1e11}} for name in ("cpu", "cuda:0")}
    return {"limits": bounds, "rows": [asdict(one) for one in rows]}


def test_figures_agree(device, path):
    """Every figure of a row follows from its seconds and the sizes."""
    kinds = [(precision, plates) for precision in ("float32", "float64") for plates in (1, 3)]
    wanted = [BenchCase(device, precision, 9, plates, path) for precision, plates in kinds]
    report = measure_all(wanted, HASTE)
    assert not report.interrupted
    assert [(one.device, one.precision, one.nodes, one.plates, one.path) for one in report.rows] == [
        (case.device, case.precision, case.nodes, case.plates, case.path) for case in wanted
    ]
    for one in report.rows:
        assert one.status == "measured"
        assert 32 <= one.steps <= 1250
        assert one.steps % 2 == 0
        assert one.seconds > 0
        assert one.node_steps_per_second == pytest.approx(49 * one.plates * one.steps / one.seconds)
        assert one.nanoseconds_per_node_step == pytest.approx(1e9 / one.node_steps_per_second)
        assert one.swarm_seconds == pytest.approx(one.seconds * 1250 / one.steps)
        specialized = specialize(discretize(paper_like(9, one.precision)), find_device(device))
        assert one.bytes_per_plate == bytes_per_plate(specialized, 0)
        bound = report.limits[device]
        if path == "streaming":
            size = {"float32": 4, "float64": 8}[one.precision]
            share = one.node_steps_per_second * 4 * size / bound.copy_bytes_per_second
            assert one.limit == "copy"
        else:
            operations = limits.operations_a_node_step(specialized)
            share = one.node_steps_per_second * operations / (bound.flops[one.precision] / 2)
            assert one.limit == "arithmetic"
        assert one.share == pytest.approx(share)


def test_limits_are_positive(pairs):
    for device in {device for device, _ in pairs}:
        found = limits.measure_limits(find_device(device), ["float32", "float64"])
        assert found.copy_bytes_per_second > 0
        assert set(found.flops) == {"float32", "float64"}
        assert all(value > 0 for value in found.flops.values())


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_the_arithmetic_limit_does_what_it_counts(real):
    """x + 1, so often as is said, each number by itself."""
    block, depth, rounds, passes = 40, 16, 3, 5
    kernel = make_multiply_adds(real, block, depth, rounds, compiler_flags())
    start = np.arange(2 * block).reshape(2, block)
    numbers = wp.array(start, dtype=real, device="cpu")
    wp.launch(kernel, dim=2, inputs=[1.0, 1.0, passes], outputs=[numbers], device="cpu")
    np.testing.assert_array_equal(numbers.numpy(), start + depth * rounds * passes)


def test_operations_are_those_of_the_equation(scene):
    """Two Laplacians of 3 additions and a multiply-add, rate⁺ and u⁺; a load where there is one; the window's share."""
    device = find_device("cpu")
    specialized = specialize(discretize(paper_like(27, "float32")), device)
    loaded = 4 * 2 * 2 / 25**2  # four patches, each over parts of 2 × 2 cells
    assert limits.operations_a_node_step(specialized) == pytest.approx(11 + 2 * loaded + 1 / 2)
    everywhere = scene(nodes=(9, 9), actuators=[(0.0, 0.2, 0.0, 0.2)], window=(0.0, 0.01))
    assert limits.operations_a_node_step(specialize(discretize(everywhere), device)) == pytest.approx(11 + 2 + 1)


@pytest.mark.parametrize("nodes", [5, 17, 27, 161, 1025, 8193])
def test_the_scene_is_the_papers_on_another_grid(nodes):
    made = make_scheme(paper_like(nodes, "float64"))
    assert (made.nodes, made.steps, made.window) == ((nodes, nodes), 1250, (625, 1250))
    assert made.time_step < 0.9 * made.limit
    assert made.angular_frequency * made.time_step == pytest.approx(2 * np.pi * 290 * 8e-5)


def test_plates_start_from_noise_inside_the_plate(device, path):
    """No node at rest, none outside moved, and all stay numbers."""
    ready = prepare(BenchCase(device, "float32", 9, 3, path))
    for field in (ready.state.u.numpy(), ready.state.rate.numpy()):
        assert (field[:, 2:9, 1:8] != 0).all()
        field[:, 2:9, 1:8] = 0
        assert not field.any()
    assert ready.state.in_phase.numpy().any()
    ready.run(1250)
    assert np.isfinite(ready.state.u.numpy()).all()
    assert ready.state.squares.numpy()[:, 2:9, 1:8].all()


def test_what_is_too_slow_is_skipped(monkeypatch):
    monkeypatch.setattr(measure, "LONGEST_SECONDS", 0.0)
    report = measure_all([BenchCase("cpu", "float32", 9, 2)], HASTE)
    assert report.rows[0].status.startswith("skipped: 4 steps take")
    assert [getattr(report.rows[0], key) for key in ROW_KEYS[4:-1]] == [None] * 9


def test_what_is_too_large_is_skipped(command, monkeypatch):
    """Said in the table and in the file; what fits is measured all the same."""
    monkeypatch.setattr(measure, "memory_for_plates", lambda device: 1e5)
    status, out, err = command(*SMALL, "--plates", "2,100000", "--no-pictures")
    assert (status, err) == (0, "")
    assert "100000 × 9²: skipped: needs" in " ".join(out.split())
    rows = json.loads(Path("bench.json").read_text(encoding="utf-8"))["rows"]
    assert [one["status"].partition(":")[0] for one in rows] == ["measured", "skipped"]


def test_an_unfit_path_is_skipped(monkeypatch):
    """As a plate that does not fit on a chip is, under --path resident."""

    def no_engine(specialized, path):
        raise measure.SceneError("does not fit")

    monkeypatch.setattr(measure, "make_engine", no_engine)
    report = measure_all([BenchCase("cpu", "float32", 9, 2, "resident")], HASTE)
    assert [one.status for one in report.rows] == ["skipped: does not fit"]


def test_json(command):
    status, out, err = command(*SMALL, "--plates", "1,3", "--json", "--no-pictures")
    assert (status, err) == (0, "")
    answer = json.loads(out)
    assert list(answer) == [*KEYS, "files"]
    assert [list(one) for one in answer["rows"]] == [ROW_KEYS] * 2
    assert [one["plates"] for one in answer["rows"]] == [1, 3]
    assert set(answer["machine"]) == {"system", "cores", "threads", "load", "devices"}
    assert {"python", "warp-plate", "warp-lang", "numpy"} <= set(answer["versions"])
    assert set(answer["limits"]) == set(answer["machine"]["devices"]) == {"cpu"}
    assert set(answer["limits"]["cpu"]) == {"copy_bytes_per_second", "flops"}
    assert answer.pop("files") == ["bench.json"]
    assert json.loads(Path("bench.json").read_text(encoding="utf-8")) == answer
    assert os.listdir() == ["bench.json"]


def test_table_and_pictures(command):
    pytest.importorskip("matplotlib", reason="Matplotlib is not installed: pip install 'warp-plate[viz]'")
    status, out, err = command(*SMALL, "--plates", "3", "--path", "streaming", "--out", "speed.json")
    assert (status, err) == (0, "")
    assert "10⁹/s" in out
    assert "streaming" in out
    assert out.splitlines()[-3:] == [f"wrote speed.{ending}" for ending in ("json", "png", "svg")]
    assert sorted(os.listdir()) == ["speed.json", "speed.png", "speed.svg"]
    assert Path("speed.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in Path("speed.svg").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--plates", "0"], "--plates"),
        (["--plates", "1,x"], "--plates"),
        (["--nodes", "4"], "--nodes"),
        (["--nodes", ""], "--nodes"),
        (["--device", "tpu"], "tpu"),
        (["--precision", "half"], "precision"),
        (["--path", "fast"], "path"),
        (["--out", "bench.txt"], ".json"),
        (["--out", "nowhere/bench.json"], "nowhere"),
    ],
    ids=lambda part: "-".join(part) if isinstance(part, list) else "",
)
def test_bad_options(command, arguments, named):
    """One line that names the option, status 2, nothing written."""
    status, out, err = command(*arguments)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert named in err
    assert os.listdir() == []


def test_default_cases_cover_the_table():
    """Each once: 1 ... 65536 plates of the paper's size, 17 ... 1025 nodes, both precisions."""
    made = make_cases(["cpu"], ["float32", "float64"])
    assert len(set(made)) == len(made)
    for precision in ("float32", "float64"):
        some = [case for case in made if case.precision == precision]
        assert {case.plates for case in some if case.nodes == 27} >= {1, 20, 256, 1024, 8192, 65536}
        assert {case.nodes for case in some} == {17, 27, 53, 105, 161, 257, 513, 1025}
    assert len(make_cases(["cpu"], ["float32"], quick=True)) < len(made) / 4
    both = make_cases(["cpu"], ["float32"], [1, 2], [9, 11], "streaming")
    assert [(case.nodes, case.plates, case.path) for case in both] == [
        (nodes, plates, "streaming") for nodes in (9, 11) for plates in (1, 2)
    ]


def test_filling_plates_give_every_thread_as_much(monkeypatch):
    monkeypatch.setenv("WARP_PLATE_THREADS", "3")
    counts = [filling_plates("cpu", nodes) for nodes in cases.NODES]
    assert all(count % 3 == 0 and count > 0 for count in counts)
    assert counts == sorted(counts, reverse=True)


def test_ctrl_c_keeps_what_is_measured():
    def stop(done, case):
        if done == 1:
            raise KeyboardInterrupt

    wanted = [BenchCase("cpu", "float32", 9, plates) for plates in (1, 2, 3)]
    report = measure_all(wanted, HASTE, stop)
    assert report.interrupted
    assert [one.plates for one in report.rows] == [1]


def test_ctrl_c_before_anything_is_measured():
    def stop(done, case):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure_all([BenchCase("cpu", "float32", 9, 1)], HASTE, stop)


def test_a_busy_machine_is_told_of(monkeypatch):
    monkeypatch.setattr(machine, "_load_average", lambda: 100.0)
    assert "load average 100" in machine.busy()
    monkeypatch.setattr(machine, "_load_average", lambda: 0.0)
    assert machine.busy() is None
    monkeypatch.setattr(machine, "_load_average", lambda: None)
    assert machine.busy() is None


def test_runs_are_as_many_as_asked_for():
    """Short ones more often, and one before them to warm up."""
    for pace in (*HASTE.values(), *FULL.values(), *QUICK.values()):
        calls = []
        taken = measure.time_runs(lambda calls=calls: calls.append(1), find_device("cpu"), pace)
        assert len(calls) == len(taken) + 1
        assert pace.runs <= len(taken) <= max(pace.runs, measure.MOST_RUNS)


def test_threads_are_those_of_the_simulation(monkeypatch):
    monkeypatch.setenv("WARP_PLATE_THREADS", "1")
    assert cpu_threads() == 1
    assert machine.describe_machine(["cpu"]).threads == 1


def test_plot_of_two_devices(tmp_path):
    """Lines for what was measured only, and a limit for each device."""
    pytest.importorskip("matplotlib", reason="Matplotlib is not installed: pip install 'warp-plate[viz]'")
    rows = [row(device=device, plates=plates) for device in ("cpu", "cuda:0") for plates in (1, 20)]
    skipped = row(precision="float64", status="skipped: too large", nanoseconds_per_node_step=None)
    path = draw_bench(record(*rows, row(nodes=53), skipped), tmp_path / "bench.svg")
    text = path.read_text(encoding="utf-8")
    for label in ("cpu, float32", "cuda:0, float32", "cuda:0, 16 B at copy bandwidth", "plates of 27 × 27 nodes"):
        assert f"<!-- {label} -->" in text
    assert "float64" not in text


def test_a_plot_that_cannot_be_is_told_of(tmp_path):
    """The figures are kept; nothing is raised."""
    pytest.importorskip("matplotlib", reason="Matplotlib is not installed: pip install 'warp-plate[viz]'")
    nothing = record(row(status="skipped: too large"))
    assert save_plots(draw_bench, nothing, tmp_path / "bench.json") == ([], "no plot: nothing was measured")
    files, missing = save_plots(draw_bench, record(row()), tmp_path / "absent" / "bench.json")
    assert files == []
    assert "absent" in missing


def test_what_is_plotted():
    rows = record(row(plates=1), row(plates=20), row(nodes=53), row(nodes=53, nanoseconds_per_node_step=0.01))["rows"]
    assert commonest_size(rows) == 27
    best = fastest_of_each_size(rows)
    assert {(one["nodes"], one["nanoseconds_per_node_step"]) for one in best} == {(27, 0.06), (53, 0.01)}
