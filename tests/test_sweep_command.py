"""``warp-plate sweep``: its table, JSON and files, what xarray makes of them, pictures, and what goes on."""

import json
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from warp_plate import Scene, SceneError, load_sweep
from warp_plate.cluster import pool as pools
from warp_plate.cluster.pool import Here, WorkersGone
from warp_plate.result.sweep import REFUSED, save_sweep
from warp_plate.result.whole import check_seal
from warp_plate.scene.load import dump_scene
from warp_plate.scene.vary import make_plan, parse_vary
from warp_plate.search import sweep as sweeps
from warp_plate.search import sweep_point as module
from warp_plate.search.figures import FIGURES
from warp_plate.search.sweep import begin_sweep
from warp_plate.search.sweep_point import run_here
from warp_plate.viz.sweep_plot import draw_sweep, edges_of

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
    assert "3 of 9 points are refused" in out
    assert "plate.thickness = 0.002, drive.frequency = 200: grid.time_step = 0.0002: above the stability" in " ".join(
        out.split()
    )
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


def test_many_points_are_told_by_their_extremes(panel, command):
    status, out, _ = command("panel.toml", "--vary", "plate.thickness=4e-4:5e-4:41", "--what", "modes", *ALONE)
    assert status == 0
    words = " ".join(out.split())
    assert "frequency 1, smallest" in words
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
    assert "interrupted after 4 of 9 points; go on with: warp-plate sweep --resume panel-sweep.h5" in err
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
        assert "7 of 9 points are done; going on" in err
        assert len(ran) == 2
    made, whole = (load_sweep(name) for name in ("panel-sweep.h5", "whole.h5"))
    for name, values in whole.values.items():
        np.testing.assert_array_equal(made.values[name], values)
    assert made.reasons == whole.reasons
    # A sweep that is done begins anew; --resume of it has nothing to run.
    with monkeypatch.context() as patch:
        interrupted_after(patch, 0)
        status, _, err = command("--resume", "whole.h5", "--no-pictures")
        assert status == 0
        assert "9 of 9 points are done; nothing is left" in err
        assert command(*arguments)[0] == 130
    assert load_sweep("panel-sweep.h5").finished  # a Ctrl-C before the first point leaves what was there


def test_workers_that_are_gone_leave_a_file_too(panel, command, monkeypatch):
    def two_points(begun, left, pool):
        yield from run_here(begun, left[:2])
        raise WorkersGone("no worker is left")

    with monkeypatch.context() as patch:
        patch.setattr(sweeps, "run_there", two_points)
        status, out, err = command("panel.toml", *TWO, "--what", "check", "--devices", "cpu", "--no-pictures")
    assert (status, out) == (2, "")
    assert "no worker is left; 2 of 9 points are done; go on with: warp-plate sweep --resume panel-sweep.h5" in err
    status, out, _ = command("--resume", "panel-sweep.h5", "--devices", "cpu", "--no-pictures", "--json")
    assert status == 0
    assert np.isfinite(np.array(json.loads(out)["outputs"]["limit"][:2], dtype=float)).all()


def test_beside_a_cluster_the_device_is_its_workers(panel, command, monkeypatch):
    """Of all commands that have workers: this machine need not have it, and goes on with what they are."""
    opened = []

    @contextmanager
    def open_pool(devices, cluster, device, tell):
        pool = Here()
        opened.append(device)
        yield pool

    monkeypatch.setattr(pools, "open_pool", open_pool)
    away = ("--cluster", "tcp://far:8786", "--device", "cuda:99", "--no-pictures")
    searched = ("panel.toml", *away, "--evaluator", "direct", "--json")
    status, out, err = command.func("localize", *searched, "--no-estimate", "--no-spectrum", "--baselines")
    assert (status, json.loads(out)["device"].endswith("on this process")) == (0, True), err
    assert command.func("compare", *searched, "--methods", "pso", "--seeds", 1)[0] == 0
    with monkeypatch.context() as patch:
        interrupted_after(patch, 2)
        assert command("panel.toml", *TWO, "--what", "check", *away)[0] == 130
    save_sweep(replace(load_sweep("panel-sweep.h5"), processor="A GPU"), "panel-sweep.h5")
    status, out, err = command("--resume", "panel-sweep.h5", "--cluster", "tcp://far:8786")
    assert (status, out) == (2, "")
    assert "(A GPU) and goes on on" in err.splitlines()[-1]
    status, out, err = command("--resume", "panel-sweep.h5", *away, "--json")
    assert (status, "the result may differ" in err) == (0, True)
    assert "(A GPU), then " in json.loads(out)["device"]
    assert opened == ["cuda:99"] * 3 + [None, "cuda:99"]


def test_what_is_given_beside_an_unfinished_file_must_be_the_same(panel, command, monkeypatch, scene):
    Path("other.toml").write_text(dump_scene(scene(damping=80, time_step=2e-4)), encoding="utf-8")
    arguments = ("panel.toml", *TWO, *ALONE)
    with monkeypatch.context() as patch:
        interrupted_after(patch, 2)
        command(*arguments)
    before = Path("panel-sweep.h5").read_bytes()
    for wrong, message in (
        (("--resume", "panel-sweep.h5", "--what", "check"), "--what check: the sweep in panel-sweep.h5 began with"),
        (("other.toml", "--resume", "panel-sweep.h5"), "effects.damping.viscous = 80.0: the sweep in panel-sweep.h5"),
        (("--resume", "panel-sweep.h5", "--vary", "drive.frequency=1,2"), "--vary: the sweep in panel-sweep.h5 began"),
        (("panel.toml", *TWO[:2]), "name another file by --out, or delete panel-sweep.h5"),
        (("panel.toml", *TWO, "--what", "check"), "name another file by --out, or delete panel-sweep.h5"),
        (("--resume", "nothing.h5"), "nothing.h5: no such file"),
    ):
        status, out, err = command(*wrong)
        assert (status, out) == (2, "")
        assert message in err
        assert err.count("\n") == 1
    assert Path("panel-sweep.h5").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "sweep needs a SCENE"),
        (("panel.toml",), "--vary: nothing is varied"),
        (("panel.toml", "--vary", "drive.freqency=1:2:3"), "near it: drive.frequency"),
        (("panel.toml", "--vary", "drive.frequency=1:2"), "COUNT is missing"),
        (("panel.toml", *TWO, "--samples", 0), "--samples 0: must be from 1"),
        (("panel.toml", *TWO, "--samples", 4, "--seed", -1), "--seed -1: must be a whole number from 0"),
        (("panel.toml", *TWO, "--what", "colours"), "what"),
        (("panel.toml", *TWO, "--count", 0), "--count 0: must be from 1"),
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


def made_up(panel, vary, what="localize", samples=None):
    """A sweep with made-up figures, some of its points refused and one figure not finite."""
    plan = make_plan([parse_vary(panel, one) for one in vary], samples)
    begun = begin_sweep(panel, plan, what, "cpu", count=3)
    values = {name: np.random.default_rng(1).random(one.shape) for name, one in begun.values.items()}
    status = np.ones(len(plan), dtype="i1")
    status[::5] = REFUSED
    for one in values.values():
        one[::5] = np.nan
    next(iter(values.values())).flat[-1] = np.inf
    return replace(begun, values=values, status=status, reasons=dict.fromkeys(range(0, len(plan), 5), "no"))


LINE, PAIR = ["drive.frequency=log:200:300:12"], ["drive.frequency=300:200:4", "effects.damping.viscous=log:1:100:3"]
FOUR = [f"{key}=1:2:3" for key in ("drive.frequency", "plate.thickness", "window.end", "plate.density")]


@pytest.mark.parametrize(
    ("what", "vary", "samples"),
    [
        *((what, LINE, None) for what in FIGURES),
        ("localize", ["drive.frequency=290"], None),
        ("localize", PAIR, None),
        ("modes", PAIR, None),
        ("check", ["drive.frequency=290", "effects.damping.viscous=0,1,5"], None),
        ("modes", ["drive.frequency=1,2", "effects.damping.viscous=1,2", "plate.thickness=log:1e-4:2e-4:3"], None),
        ("localize", FOUR, None),
        ("simulate", ["drive.frequency=200:300", "effects.damping.viscous=log:1:100"], 20),
    ],
)
def test_pictures_of_all_shapes(panel, tmp_path, what, vary, samples):
    pytest.importorskip("matplotlib", reason=NEEDS_PLOTS)
    picture = draw_sweep(made_up(panel, vary, what, samples), tmp_path / "a.png")
    from matplotlib.image import imread

    drawn = imread(picture)
    assert min(drawn.shape[:2]) > 300
    assert drawn[..., :3].std() > 0.02


def test_cells_lie_half_way_between_values():
    np.testing.assert_allclose(edges_of(np.array([1.0, 2.0, 4.0]), False), [0.5, 1.5, 3.0, 5.0])
    np.testing.assert_allclose(edges_of(np.array([1.0, 100.0]), True), [0.1, 10.0, 1000.0])
    low, high = edges_of(np.array([0.0]), False)
    assert low < 0 < high
