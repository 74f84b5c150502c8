"""``warp-plate sweep``: its table, JSON and files, what xarray makes of them, and what goes on."""

import json
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from inline_pool import InlinePool

from warp_plate import Scene, SceneError, load_sweep
from warp_plate.cli import output
from warp_plate.cluster.pool import WorkersGone
from warp_plate.result.atomic_io import check_seal
from warp_plate.result.sweep import REFUSED, save_sweep
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.vary import make_plan, parse_vary
from warp_plate.studies import sweep as sweeps
from warp_plate.studies import sweep_point as module
from warp_plate.studies.sweep import begin_sweep
from warp_plate.studies.sweep_point import run_here

NEEDS_PLOTS = "Matplotlib is not installed: pip install 'warp-plate[viz]'"
NEEDS_XARRAY = "xarray or h5netcdf is not installed: pip install 'warp-plate[data]'"
ALONE = ("--device", "cpu", "--no-pictures")
TWO = ("--vary", "plate.thickness=4e-4,5e-4,2e-3", "--vary", "drive.frequency=200:300:3")


@pytest.fixture
def panel(scene, tmp_path, monkeypatch):
    """A small scene in a file of an empty working folder."""
    monkeypatch.chdir(tmp_path)
    made = scene(damping=88.5, time_step=2e-4, search={"particles": 8, "iterations": 30, "seed": 5})
    Path("panel.toml").write_text(dump_scene(made), encoding="utf-8")
    return made


@pytest.fixture
def command(command):
    """Run ``sweep``: (status, standard output, standard error)."""

    return partial(command, "sweep")


def test_the_table_and_the_files(panel, command):
    pytest.importorskip("matplotlib", reason=NEEDS_PLOTS)
    status, out, err = command("panel.toml", *TWO, "--what", "check", "--device", "cpu")
    assert (status, err) == (0, "")
    assert "3 of 9 points refused" in out
    refused = "at plate.thickness = 0.002, drive.frequency = 200: grid.time_step = 0.0002: above the stability"
    assert refused in " ".join(out.split())
    assert out.count("none") == 3 * 4
    for name in ("panel-sweep.h5", "panel-sweep.png", "panel-sweep.svg"):
        assert f"wrote {name}" in out
        assert Path(name).stat().st_size > 1000
    assert sorted(path.name for path in Path().iterdir()) == [
        "panel-sweep.h5", "panel-sweep.png", "panel-sweep.svg", "panel.toml",
    ]  # fmt: skip


def test_json_is_one_object(panel, command):
    status, out, _ = command("panel.toml", *TWO, "--what", "modes", "--count", 2, "--json", *ALONE)
    assert status == 0
    said = json.loads(out)
    assert (said["what"], said["shape"], said["sampled"]) == ("modes", [3, 3], False)
    assert said["varied"] == {"plate.thickness": [4e-4, 5e-4, 2e-3], "drive.frequency": [200.0, 250.0, 300.0]}
    assert np.array(said["outputs"]["frequency"], dtype=float).shape == (3, 3, 2)
    assert said["outputs"]["frequency"][2][0] == [None, None]
    assert said["refused"][0]["at"] == {"plate.thickness": 2e-3, "drive.frequency": 200.0}
    assert said["units"] == {"frequency": "Hz"}
    assert "! drive.frequency changes no figure" in command("--resume", "panel-sweep.h5", "--no-pictures")[1]


def test_many_points_are_told_by_their_extremes_and_counted_as_they_are_done(panel, command, monkeypatch):
    notes = []
    monkeypatch.setattr(output, "progress_bar", lambda *_: nullcontext(lambda *shown: notes.append(shown)))
    status, out, _ = command("panel.toml", "--vary", "plate.thickness=4e-4:5e-4:41", "--what", "modes", *ALONE)
    assert status == 0
    words = " ".join(out.split())
    assert "frequency 1, smallest" in words
    assert notes[0] == (0, 41, "0 of 41 points")
    assert notes[-1] == (41, 41, "41 of 41: plate thickness 0.0005")
    assert "changes no figure" not in words
    assert "frequency 6, largest" in words


def test_xarray_opens_a_grid_by_name(panel, command):
    xarray = pytest.importorskip("xarray", reason=NEEDS_XARRAY)
    pytest.importorskip("h5netcdf", reason=NEEDS_XARRAY)
    command("panel.toml", *TWO, "--what", "modes", "--count", 2, *ALONE)
    kept = load_sweep("panel-sweep.h5")
    with xarray.open_dataset("panel-sweep.h5", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"plate.thickness": 3, "drive.frequency": 3, "mode": 2}
        assert data["frequency"].dims == ("plate.thickness", "drive.frequency", "mode")
        np.testing.assert_array_equal(data["frequency"].values, kept.shaped("frequency"))
        one = data["frequency"].sel({"plate.thickness": 5e-4, "drive.frequency": 250.0, "mode": 2})
        assert float(one) == kept.shaped("frequency")[1, 1, 1]
        assert data["drive.frequency"].attrs == {"units": "Hz", "long_name": "drive frequency"}
        assert data["frequency"].attrs == {"units": "Hz", "long_name": "natural frequency"}
        assert "above the stability limit" in str(data["reason"].values[2, 0])
        assert str(data["reason"].values[0, 0]) == ""
        assert (data["status"] == REFUSED).sum() == 3
        assert Scene.load("panel.toml") == panel
    check_seal(Path("panel-sweep.h5"))


def test_xarray_opens_samples_with_keys_as_coordinates(panel, command):
    xarray = pytest.importorskip("xarray", reason=NEEDS_XARRAY)
    pytest.importorskip("h5netcdf", reason=NEEDS_XARRAY)
    arguments = ("--vary", "plate.thickness=4e-4:5e-4", "drive.frequency=200:300", "--samples", 6, "--seed", 3)
    status, _, _ = command("panel.toml", *arguments, *ALONE, "--out", "drawn.h5")
    assert status == 0
    kept = load_sweep("drawn.h5")
    with xarray.open_dataset("drawn.h5", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"sample": 6}
        assert set(data.coords) == {"sample", "plate.thickness", "drive.frequency"}
        np.testing.assert_array_equal(data["best"].values, kept.values["best"])
        np.testing.assert_array_equal(data["drive.frequency"].values, kept.plan.coordinates[1])


def interrupted_after(monkeypatch, points):
    """Ctrl-C in the point after so many."""
    real, ran = module.run_point, []

    def run(*arguments):
        if len(ran) == points:
            raise KeyboardInterrupt
        ran.append(arguments)
        return real(*arguments)

    monkeypatch.setattr(module, "run_point", run)
    return ran


def test_ctrl_c_leaves_a_file_and_says_how_to_go_on(panel, command, monkeypatch):
    arguments = ("panel.toml", *TWO, *ALONE)
    command(*arguments, "--out", "whole.h5")
    with monkeypatch.context() as patch:
        interrupted_after(patch, 4)
        status, out, err = command(*arguments)
    assert (status, out) == (130, "")
    assert "interrupted after 4 of 9 points; go on with: warp-plate sweep --resume panel-sweep.checkpoint.h5" in err
    with monkeypatch.context() as patch:
        ran = interrupted_after(patch, 3)
        status, _, err = command("--resume", "panel-sweep.h5", "--no-pictures")
        assert status == 130
        assert "after 7 of 9 points" in err
        assert len(ran) == 3
    # The same command once more goes on too.
    with monkeypatch.context() as patch:
        ran = interrupted_after(patch, 9)
        status, _, err = command(*arguments)
        assert status == 0
        assert "7 of 9 points done; going on" in err
        assert len(ran) == 2
    assert not Path("panel-sweep.checkpoint.h5").exists()
    made, whole = (load_sweep(name) for name in ("panel-sweep.h5", "whole.h5"))
    for name, values in whole.values.items():
        np.testing.assert_array_equal(made.values[name], values)
    assert made.reasons == whole.reasons
    # Nothing is left of a sweep that is done; the same command begins it anew, and its file stays until that is done.
    with monkeypatch.context() as patch:
        interrupted_after(patch, 0)
        status, _, err = command("--resume", "whole.h5", "--no-pictures")
        assert status == 0
        assert "9 of 9 points done; nothing is left" in err
    done = Path("panel-sweep.h5").read_bytes()
    with monkeypatch.context() as patch:
        interrupted_after(patch, 2)
        status, _, err = command(*arguments)
        assert (status, "after 2 of 9 points" in err) == (130, True)
        assert Path("panel-sweep.h5").read_bytes() == done
    # --resume finds what is unfinished by the result's name too.
    status, _, err = command("--resume", "panel-sweep.h5", "--no-pictures")
    assert (status, "panel-sweep.checkpoint.h5: 2 of 9 points done; going on" in err) == (0, True)
    assert Path("panel-sweep.h5").read_bytes() != done


def test_nothing_else_is_replaced(panel, command, monkeypatch):
    """A finished sweep of other points, scene or figures, and another command's file."""
    assert command("panel.toml", *TWO, *ALONE)[0] == 0
    Path("panel-localize.h5").write_bytes(b"another command's")
    Path("other-sweep.checkpoint.h5").write_bytes(b"another command's")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    for wrong, message in (
        (TWO[:2], "panel-sweep.h5: holds a sweep of other points (9 points, plate.thickness from"),
        ((*TWO, "--what", "check"), "panel-sweep.h5: holds a sweep of --what localize"),
        ((*TWO, "--out", "panel-localize.h5"), "panel-localize.h5: damaged"),
        ((*TWO, "--out", "other-sweep.h5"), "other-sweep.checkpoint.h5: damaged"),
    ):
        status, out, err = command("panel.toml", *wrong, *ALONE)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert message in err
        assert "name another file by --out" in err
        assert {path: path.read_bytes() for path in Path().iterdir()} == before
    # Where another command has made one while the sweep ran, both are there.
    with monkeypatch.context() as patch:
        real = module.run_point

        def meanwhile(payload):
            Path("late.h5").write_bytes(b"another command's")
            return real(payload)

        patch.setattr(module, "run_point", meanwhile)
        status, out, err = command("panel.toml", *TWO, *ALONE, "--out", "late.h5")
    assert (status, "late.h5 is of another command by now; this sweep is written to late-2.h5" in err) == (0, True)
    assert "wrote late-2.h5" in out
    assert Path("late.h5").read_bytes() == b"another command's"


def test_the_last_line_after_ctrl_c_is_true(panel, command, monkeypatch):
    def impatient(*_):
        raise KeyboardInterrupt

    from warp_plate.viz.plots import sweep as sweep_plot

    monkeypatch.setattr(sweep_plot, "draw_sweep", impatient)
    status, _, err = command("panel.toml", *TWO, "--what", "check", "--device", "cpu")
    assert (status, err) == (130, "warp-plate: interrupted\n")
    assert Path("panel-sweep.h5").exists()


def test_workers_that_are_gone_leave_a_file_too(panel, command, monkeypatch):
    def two_points(begun, left, pool):
        yield from run_here(begun, left[:2])
        raise WorkersGone("no worker is left")

    with monkeypatch.context() as patch:
        patch.setattr(sweeps, "run_there", two_points)
        status, out, err = command("panel.toml", *TWO, "--what", "check", "--devices", "cpu", "--no-pictures")
    assert (status, out) == (2, "")
    assert "no worker is left after 2 of 9 points; go on with: " in err
    status, out, _ = command("--resume", "panel-sweep.h5", "--devices", "cpu", "--no-pictures", "--json")
    assert status == 0
    assert np.isfinite(np.array(json.loads(out)["outputs"]["limit"][:2], dtype=float)).all()


def test_beside_a_cluster_the_device_is_its_workers(panel, command, monkeypatch):
    """Of all commands that have workers: this machine need not have it, and goes on with what they are."""
    opened = []

    @contextmanager
    def open_pool(devices, cluster, device, tell):
        pool = InlinePool()
        opened.append(device)
        yield pool

    monkeypatch.setattr("warp_plate.cluster.pool.open_pool", open_pool)
    away = ("--cluster", "tcp://far:8786", "--device", "cuda:99", "--no-pictures")
    searched = ("panel.toml", *away, "--evaluator", "direct", "--json")
    status, out, err = command.func("localize", *searched, "--no-estimate", "--no-spectrum", "--baselines")
    assert (status, json.loads(out)["device"].endswith("on this process")) == (0, True), err
    assert command.func("compare", *searched, "--methods", "pso", "--seeds", 1)[0] == 0
    with monkeypatch.context() as patch:
        interrupted_after(patch, 2)
        assert command("panel.toml", *TWO, "--what", "check", *away)[0] == 130
    save_sweep(replace(load_sweep("panel-sweep.checkpoint.h5"), processor="A GPU"), "panel-sweep.checkpoint.h5")
    status, out, err = command("--resume", "panel-sweep.checkpoint.h5", "--cluster", "tcp://far:8786")
    assert (status, out) == (2, "")
    assert "(A GPU) and goes on on" in err.splitlines()[-1]
    status, out, err = command("--resume", "panel-sweep.checkpoint.h5", *away, "--json")
    assert (status, "the result may differ" in err) == (0, True)
    assert "(A GPU), then " in json.loads(out)["device"]
    assert opened == ["cuda:99"] * 3 + [None, "cuda:99"]


def test_what_is_given_beside_an_unfinished_file_must_be_the_same(panel, command, monkeypatch, scene):
    Path("other.toml").write_text(dump_scene(scene(damping=80, time_step=2e-4)), encoding="utf-8")
    arguments = ("panel.toml", *TWO, *ALONE)
    with monkeypatch.context() as patch:
        interrupted_after(patch, 2)
        command(*arguments)
    before, on = Path("panel-sweep.checkpoint.h5").read_bytes(), ("--resume", "panel-sweep.h5")
    for wrong, message in (
        ((*on, "--what", "check"), "--what check: the sweep in panel-sweep.checkpoint.h5 began with localize"),
        (("other.toml", *on), "effects.damping.viscous = 80.0: the sweep in panel-sweep.checkpoint.h5 began"),
        ((*on, "--vary", "drive.frequency=1,2"), "--vary: the sweep in panel-sweep.checkpoint.h5 began"),
        ((*on, "--samples", 5), "--samples 5: draws from the ranges of --vary"),
        ((*on, "--seed", 5), "--seed 5: draws samples; write --samples N beside it"),
        (("panel.toml", *TWO[:2]), "else; name another file by --out, or delete panel-sweep.checkpoint.h5"),
        (("panel.toml", *TWO, "--what", "check"), "name another file by --out, or delete panel-sweep.checkpoint.h5"),
        (("--resume", "nothing.h5"), "nothing.h5: no such file"),
    ):
        status, out, err = command(*wrong)
        assert (status, out) == (2, "")
        assert message in err
        assert err.count("\n") == 1
    assert Path("panel-sweep.checkpoint.h5").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "sweep needs a SCENE"),
        (("panel.toml",), "--vary: nothing is varied; write --vary KEY=RANGE, RANGE being START:STOP:COUNT"),
        (("panel.toml", "--vary", "drive.freqency=1:2:3"), "similar keys: drive.frequency"),
        (("panel.toml", "--vary", "drive.frequency=1:2"), "COUNT is missing"),
        (("panel.toml", *TWO, "--samples", 0), "--samples 0: must be from 1"),
        (("panel.toml", *TWO, "--samples", 4, "--seed", -1), "--seed -1: must be a whole number from 0"),
        (("panel.toml", *TWO, "--what", "colours"), "what"),
        (("panel.toml", *TWO, "--what", "modes", "--count", 0), "--count 0: must be from 1"),
        (("panel.toml", *TWO, "--count", 3), "--count 3: --what localize has no modes to count; leave it out"),
        (("panel.toml", *TWO, "--seed", 3), "--seed 3: draws samples; write --samples N beside it, or leave it out"),
        (("panel.toml", *TWO, "--checkpoint-every", -1), "checkpoint-every = -1"),
        (("panel.toml", *TWO, "--out", "a.nc"), "--out a.nc: must end in .h5"),
        (("panel.toml", "--vary", "plate.thickness=0.1,0.2"), "all points are refused; at plate.thickness = 0.1"),
    ],
)
def test_bad_input_is_one_line(panel, command, arguments, message):
    status, out, err = command(*arguments, "--device", "cpu")
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not Path("panel-sweep.h5").exists()


def test_a_damaged_or_hostile_file_is_refused(panel, tmp_path):
    """Whatever byte is changed, one line; and a file whose parts do not fit each other too."""
    plan = make_plan([parse_vary(panel, "drive.frequency=200,300")])
    begun = begin_sweep(panel, plan, "modes", "cpu")
    file = save_sweep(begun, tmp_path / "a.h5")
    content = file.read_bytes()
    for place in range(0, len(content), 997):
        file.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(SceneError, match="damaged"):
            load_sweep(file)
    wrong_status = replace(begun, status=np.full(2, 7, dtype="i1"))
    with pytest.raises(SceneError, match="status holds other numbers"):
        load_sweep(save_sweep(wrong_status, file))
    with pytest.raises(SceneError, match="frequency has shape"):
        load_sweep(save_sweep(replace(begun, values={"frequency": np.zeros((2, 5))}), file))
