"""``warp-plate sweep``: its table, JSON and files, what xarray reads, and how it resumes."""

import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.commands import error_of, output_of
from support.inline_pool import InlinePool
from warp_plate import SceneError, load_sweep
from warp_plate.cluster.pool import WorkersGone
from warp_plate.result.atomic_io import check_seal
from warp_plate.result.sweep import REFUSED, save_sweep
from warp_plate.studies import sweep as sweeps
from warp_plate.studies.frequency_response import respond_to_drive
from warp_plate.studies.sweep_points import QUANTITIES, run_here

QUICK = ("--device", "cpu", "--no-pictures")
GRID = ("--vary", "plate.thickness=4e-4,5e-4,2e-3", "--vary", "drive.frequency=200:300:3")
SWEEP = ("sweep", "panel.toml", *GRID, *QUICK)
CHECKS = (*SWEEP, "--what", "check")


@pytest.fixture
def swept_panel(write_scene):
    """A small scene in a file of an empty working folder."""
    return write_scene(damping=88.5, time_step=2e-4, search={"particles": 8, "iterations": 30, "seed": 5})


def test_table_and_files(swept_panel, command):
    pytest.importorskip("matplotlib")
    out = output_of(command("sweep", "panel.toml", *GRID, "--what", "check", "--device", "cpu"))
    assert "3 of 9 points refused" in out
    refused = "at plate.thickness = 0.002, drive.frequency = 200: grid.time_step = 0.0002: above the stability"
    assert refused in " ".join(out.split())
    assert out.count("none") == 3 * 4
    files = ["panel-sweep.h5", "panel-sweep.png", "panel-sweep.svg"]
    assert all(f"wrote {name}" in out and Path(name).stat().st_size > 1000 for name in files)
    assert sorted(path.name for path in Path().iterdir()) == [*files, "panel.toml"]
    many = ("--vary", "plate.thickness=4e-4,5e-4", "--what", "modes", "--count", 7, *QUICK, "--out", "many.h5")
    words = " ".join(output_of(command("sweep", "panel.toml", *many)).split())
    assert [part in words for part in ("frequency 1, smallest", "frequency 7, largest", "no effect")] == [1, 1, 0]


def test_json_and_what_xarray_reads(write_scene, command):
    """A grid has a dimension for each key; samples have keys as coordinates. The thinnest plate buckles."""
    write_scene(search={"particles": 8, "iterations": 30}, effects={"tension": {"x": -10.0, "y": -10.0}})
    record = json.loads(output_of(command(*SWEEP, "--what", "modes", "--count", 2, "--json")))
    kept = load_sweep("panel-sweep.h5")
    assert (record["what"], record["shape"], record["sampled"]) == ("modes", [3, 3], False)
    assert record["varied"] == {"plate.thickness": [4e-4, 5e-4, 2e-3], "drive.frequency": [200.0, 250.0, 300.0]}
    np.testing.assert_array_equal(np.array(record["outputs"]["frequency"], dtype=float), kept.shaped("frequency"))
    assert record["outputs"]["frequency"][0][0] == [None, None]
    assert record["refused"][0]["at"] == {"plate.thickness": 4e-4, "drive.frequency": 200.0}
    assert record["units"] == {"frequency": "Hz"}
    assert "! drive.frequency has no effect" in command(*SWEEP, "--what", "modes", "--count", 2)[1]
    check_seal(Path("panel-sweep.h5"))
    with pytest.raises(SceneError, match="frequency has shape"):
        load_sweep(save_sweep(replace(kept, values={"frequency": np.zeros((9, 5))}), "contradicting.h5"))
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    with xarray.open_dataset("panel-sweep.h5", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"plate.thickness": 3, "drive.frequency": 3, "mode": 2}
        assert data["frequency"].dims == ("plate.thickness", "drive.frequency", "mode")
        selected = data["frequency"].sel({"plate.thickness": 5e-4, "drive.frequency": 250.0, "mode": 2})
        assert float(selected) == kept.shaped("frequency")[1, 1, 1]
        assert data["drive.frequency"].attrs == {"units": "Hz", "long_name": "drive frequency"}
        assert data["frequency"].attrs == {"units": "Hz", "long_name": "natural frequency"}
        assert "the plate buckles" in str(data["reason"].values[0, 0])
        assert str(data["reason"].values[2, 0]) == ""
        assert (data["status"] == REFUSED).sum() == 3
    write_scene(search={"particles": 8, "iterations": 30})
    ranges = ("--vary", "plate.thickness=4e-4:5e-4", "drive.frequency=200:300", "--samples", 6, "--seed", 3)
    assert command("sweep", "panel.toml", *ranges, *QUICK, "--out", "drawn.h5")[0] == 0
    kept = load_sweep("drawn.h5")
    with xarray.open_dataset("drawn.h5", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"sample": 6}
        assert set(data.coords) == {"sample", "plate.thickness", "drive.frequency"}
        np.testing.assert_array_equal(data["best"].values, kept.values["best"])
        np.testing.assert_array_equal(data["drive.frequency"].values, kept.plan.coordinates[1])


def test_words_and_files_vary_and_responses_have_an_axis(write_scene, command):
    """Each of four maps once, with other edges; xarray opens the words and the frequencies."""
    for number in range(4):
        Path(f"map{number}.csv").write_text(f"1.0,{1 + 0.1 * number}\n", encoding="utf-8")
    write_scene(effects={"variation": {"thickness": "map0.csv"}, "loss_factor": {"eta": 0.02}})
    vary = ("--vary", "effects.variation.thickness=map*.csv", "edges.left=clamped,supported", "plate.density=900:1100")
    asked = ("--what", "frf", "--frequencies", "50:200:3", "--samples", 4, "--seed", 1, "--json")
    pytest.importorskip("matplotlib")
    record = json.loads(output_of(command("sweep", "panel.toml", *vary, *asked, "--device", "cpu")))
    kept = load_sweep("panel-sweep.h5")
    assert sorted(record["varied"]["effects.variation.thickness"]) == [f"map{number}.csv" for number in range(4)]
    assert sorted(record["varied"]["edges.left"]) == ["clamped"] * 2 + ["supported"] * 2
    assert (record["evaluator"], record["axes"]) == ("modal", {"frequency": [50.0, 125.0, 200.0]})
    for point in range(4):
        scene = kept.scene.with_values(kept.plan.values(point))
        velocity, factor, bound = respond_to_drive(scene, kept.along("frequency"))
        np.testing.assert_allclose(kept.values["mean_square_velocity"][point], velocity, rtol=1e-9)
        np.testing.assert_allclose(kept.values["localization_factor"][point], factor, rtol=1e-9)
        np.testing.assert_allclose(record["outputs"]["bound"][point], bound, rtol=1e-9)
    assert Path("panel-sweep.png").stat().st_size > 1000
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    with xarray.open_dataset("panel-sweep.h5", engine="h5netcdf") as data:
        assert data["mean_square_velocity"].dims == ("sample", "frequency")
        assert data["frequency"].values.tolist() == [50.0, 125.0, 200.0]
        assert data["edges.left"].values.tolist() == record["varied"]["edges.left"]
    Path("map2.csv").write_text("1.0,0.9\n", encoding="utf-8")
    err = error_of(command("sweep", "panel.toml", *vary, *asked, "--device", "cpu"))
    assert "holds a sweep of another effects.variation.thickness" in err


@pytest.fixture
def interrupt_after(monkeypatch):
    """Interrupt the point after so many others; return a list of the points run."""
    check = QUANTITIES["check"]

    def patch(points):
        ran = []

        def compute(scene, point):
            if len(ran) == points:
                raise KeyboardInterrupt
            ran.append(point)
            return check.compute(scene, point)

        monkeypatch.setitem(QUANTITIES, "check", replace(check, compute=compute))
        return ran

    return patch


def test_an_interrupted_sweep_is_resumed(swept_panel, command, interrupt_after):
    """The same command again gives bit-identical results."""
    command(*CHECKS, "--out", "full.h5")
    file = Path("panel-sweep.checkpoint.h5")
    interrupt_after(0)
    assert (command(*CHECKS), file.exists()) == ((130, "", "warp-plate: interrupted\n"), False)
    interrupt_after(4)
    status, out, err = command(*CHECKS)
    assert (status, out) == (130, "")
    assert "after 4 of 9 points; the same command continues" in err
    before = file.read_bytes()
    for wrong, message in (
        ((*GRID, "--what", "modes"), f"{file}: holds a sweep of --what check; name another file by --out"),
        ((*GRID, "--what", "check", "--set", "effects.damping.viscous=80"), f"{file}: holds a sweep of another scene"),
        ((*GRID[:2], "--what", "check"), f"{file}: holds a sweep of other points (9 points"),
    ):
        assert message in error_of(command("sweep", "panel.toml", *wrong, *QUICK))
    assert file.read_bytes() == before
    for limit, status, ran, line in ((3, 130, 3, "after 7 of 9 points"), (9, 0, 2, "7 of 9 points done; continuing")):
        points = interrupt_after(limit)
        answer = command(*CHECKS)
        assert (answer[0], len(points), line in answer[2]) == (status, ran, True)
    assert not file.exists()
    made, full = (load_sweep(name) for name in ("panel-sweep.h5", "full.h5"))
    for name, values in full.values.items():
        np.testing.assert_array_equal(made.values[name], values)
    assert made.reasons == full.reasons


def test_only_the_same_sweep_is_replaced(swept_panel, command, interrupt_after):
    assert command(*CHECKS)[0] == 0
    Path("panel-localize.h5").write_bytes(b"another command's")
    Path("other-sweep.checkpoint.h5").write_bytes(b"another command's")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    for wrong, message in (
        ((*GRID[:2], "--what", "check"), "panel-sweep.h5: holds a sweep of other points (9 points, plate.thickness"),
        ((*GRID, "--what", "simulate"), "panel-sweep.h5: holds a sweep of --what check"),
        ((*GRID, "--out", "panel-localize.h5"), "panel-localize.h5: damaged"),
        ((*GRID, "--out", "other-sweep.h5"), "other-sweep.checkpoint.h5: damaged"),
    ):
        err = error_of(command("sweep", "panel.toml", *wrong, *QUICK))
        assert (message in err, "name another file by --out" in err) == (True, True), err
        assert {path: path.read_bytes() for path in Path().iterdir()} == before
    result = Path("panel-sweep.h5")
    interrupt_after(2)
    assert (command(*CHECKS)[0], result.read_bytes()) == (130, before[result])
    interrupt_after(9)
    status, _, err = command(*CHECKS)
    assert (status, "panel-sweep.checkpoint.h5: 2 of 9 points done; continuing" in err) == (0, True)
    assert result.read_bytes() != before[result]


def test_the_device_beside_a_cluster_is_that_of_its_workers(swept_panel, command, monkeypatch, interrupt_after):
    """In all commands with workers: this machine need not have it, and continues with what they report. Workers that
    are gone leave a file."""
    opened = []

    @contextmanager
    def open_pool(devices, cluster, device, log):
        opened.append(device)
        yield InlinePool()

    monkeypatch.setattr("warp_plate.cluster.opening.open_pool", open_pool)
    away = ("--cluster", "tcp://far:8786", "--device", "cuda:99", "--no-pictures")
    searched = ("panel.toml", *away, "--evaluator", "direct", "--json")
    status, out, err = command("localize", *searched, "--no-estimate", "--no-spectrum", "--baselines")
    assert (status, json.loads(out)["device"].endswith("on this process")) == (0, True), err
    interrupt_after(2)
    assert command("sweep", "panel.toml", *GRID, "--what", "check", *away)[0] == 130
    interrupt_after(9)
    file = "panel-sweep.checkpoint.h5"
    save_sweep(replace(load_sweep(file), processor="A GPU"), file)
    status, out, _ = command("sweep", "panel.toml", *GRID, "--what", "check", *away, "--json")
    assert (status, "(A GPU), then " in json.loads(out)["device"]) == (0, True)
    assert opened == ["cuda:99"] * 3

    def two_points(start, pending, pool):
        yield from run_here(start, pending[:2])
        raise WorkersGone("no worker is left")

    monkeypatch.setattr(sweeps, "run_on_pool", two_points)
    interrupt_after(9)
    err = error_of(command("sweep", "panel.toml", *GRID, "--what", "check", *away, "--out", "gone.h5"))
    assert "no worker is left; there is a checkpoint after 2 of 9 points; the same command continues" in err


def test_bad_input_is_one_line(swept_panel, command):
    for arguments, message in (
        (("panel.toml",), "--vary: nothing is varied; write --vary KEY=RANGE, RANGE being START:STOP:COUNT"),
        (("panel.toml", "--vary", "drive.freqency=1:2:3"), "similar keys: drive.frequency"),
        (("panel.toml", "--vary", "drive.frequency=1:2"), "COUNT is missing"),
        (("panel.toml", *GRID, "--samples", 4, "--seed", -1), "--seed -1: must be"),
        (("panel.toml", *GRID, "--what", "frf"), "--what frf: at which frequencies? write --frequencies"),
        (("panel.toml", *GRID, "--what", "frf", "--frequencies", "0:9:3"), "--frequencies 0:9:3: all must be"),
        (("panel.toml", *GRID, "--frequencies", "1:9:3"), "--frequencies 1:9:3: are those of --what frf"),
        (("panel.toml", *GRID, "--what", "check", "--evaluator", "modal"), "--what check is always direct"),
        (("panel.toml", *GRID, "--evaluator", "modal", "--path", "streaming"), "takes no steps"),
        (("panel.toml", "--vary", "edges.left=clamped,"), "edges.left=clamped,: holds text; write a list"),
        (("panel.toml", *GRID, "--count", 3), "--count 3: --what localize has no modes to count; leave it out"),
        (("panel.toml", *GRID, "--seed", 3), "--seed 3: is the seed of samples"),
        (("panel.toml", "--vary", "plate.thickness=0.1,0.2"), "all points are refused; at plate.thickness = 0.1"),
    ):
        assert message in error_of(command("sweep", *arguments, "--device", "cpu"))
    assert [str(path) for path in Path().iterdir()] == ["panel.toml"]
